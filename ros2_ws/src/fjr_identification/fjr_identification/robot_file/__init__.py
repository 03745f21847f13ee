# SPDX-License-Identifier: Apache-2.0
"""The robot file of an identified robot."""
