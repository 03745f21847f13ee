# SPDX-License-Identifier: Apache-2.0
"""Stability of the sampled loop for many plants and wrong models, and modes that are too fast for it."""
