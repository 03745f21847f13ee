# SPDX-License-Identifier: Apache-2.0
"""Verified numerics: Taylor models, interval matrices, bounds of the link inertia; all hold in spite of rounding."""
