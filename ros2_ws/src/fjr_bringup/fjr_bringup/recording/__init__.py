# SPDX-License-Identifier: Apache-2.0
"""Recording and reading bags."""
