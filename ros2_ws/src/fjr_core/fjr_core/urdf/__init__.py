# SPDX-License-Identifier: Apache-2.0
"""Read, survey and write URDFs."""
