# SPDX-License-Identifier: Apache-2.0
"""Before the arm moves: linear stability, gains, laws to compare with, studies by simulation, exported code."""
