# SPDX-License-Identifier: Apache-2.0
"""Simulation of the closed loop, of non-ideal plants and of batches of runs."""
