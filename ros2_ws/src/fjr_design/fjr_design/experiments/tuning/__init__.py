# SPDX-License-Identifier: Apache-2.0
"""Gains chosen for stated uncertainties: coordinates, goal, candidates by simulation, and the search."""
