# SPDX-License-Identifier: Apache-2.0
"""Bound of the tracking errors along a reference for bounded model errors, hold and delay."""

from .search import ErrorBound, bound_errors

__all__ = ["ErrorBound", "bound_errors"]
