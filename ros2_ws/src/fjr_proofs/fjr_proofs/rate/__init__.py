# SPDX-License-Identifier: Apache-2.0
"""Prove a convergence rate, and write its certificate."""
