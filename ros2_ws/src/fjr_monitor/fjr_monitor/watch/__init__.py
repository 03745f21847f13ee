# SPDX-License-Identifier: Apache-2.0
"""The live display of `fjr watch`."""
