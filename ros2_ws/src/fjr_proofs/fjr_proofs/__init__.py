# SPDX-License-Identifier: Apache-2.0
"""Proofs with verified numerics: the rate, the bound of the tracking error, contraction of the sampled loop."""
