# SPDX-License-Identifier: Apache-2.0
"""Tubes about a reference that the sampled loop does not leave: bounds of its tracking errors, and contraction."""

from .contraction import SampledContraction, sampled_contraction
from .search import ErrorBound, bound_errors

__all__ = ["ErrorBound", "SampledContraction", "bound_errors", "sampled_contraction"]
