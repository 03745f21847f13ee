# SPDX-License-Identifier: Apache-2.0
"""Prove that the sampled closed loop of v-dPBC contracts on a tube about its reference."""
