# SPDX-License-Identifier: Apache-2.0
"""Numerical tools without robotics: checks, CasADi functions, integrators and compiled code."""
