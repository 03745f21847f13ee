# SPDX-License-Identifier: Apache-2.0
"""`fjr contraction`: distances between solutions of the virtual system along a simulated or recorded run."""
