# SPDX-License-Identifier: Apache-2.0
"""Proofs with verified numerics: the rate, the bound of the tracking error, contraction of the sampled loop.

From a robot to its rate: `rate.proof_of_rate` asks `verification.inertia_bounds` for the largest inertia on a domain,
and `fjr_core.law.rate` for the rate that follows. `kept_rate` keeps it, `fjr check` prints it.
"""
