# SPDX-License-Identifier: Apache-2.0
"""`fjr contraction`: distances between virtual solutions, recorded and simulated."""
