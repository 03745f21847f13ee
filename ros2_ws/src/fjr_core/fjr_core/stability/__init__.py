# SPDX-License-Identifier: Apache-2.0
"""Stability of the closed loop: linearisation and the sampled loop."""
