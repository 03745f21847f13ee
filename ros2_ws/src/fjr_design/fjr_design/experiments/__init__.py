# SPDX-License-Identifier: Apache-2.0
"""Studies made of many simulated runs: comparison of laws and Monte-Carlo sweeps."""
