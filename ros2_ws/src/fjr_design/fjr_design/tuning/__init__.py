# SPDX-License-Identifier: Apache-2.0
"""Gains: synthesised for v-dPBC, and tuned to equal bandwidth for all laws."""
