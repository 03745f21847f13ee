# SPDX-License-Identifier: Apache-2.0
"""Verified numerics: bounds of the link inertia on boxes of joint positions that hold in spite of rounding."""
