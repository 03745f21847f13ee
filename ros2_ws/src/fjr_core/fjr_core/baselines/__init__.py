# SPDX-License-Identifier: Apache-2.0
"""The laws that v-dPBC is compared with, each from its paper (docs/baselines.md); by name in laws.LAWS."""
