# SPDX-License-Identifier: Apache-2.0
"""Stability of the sampled loop for many plants and wrong models, and contraction of the virtual system."""
