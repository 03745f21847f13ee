# SPDX-License-Identifier: Apache-2.0
"""Monte-Carlo sweeps of a scenario: distributions, runs and sensitivities."""
