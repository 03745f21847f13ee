# SPDX-License-Identifier: Apache-2.0
"""Simulation of the closed loop and of non-ideal plants."""
