# SPDX-License-Identifier: Apache-2.0
"""Baseline laws that v-dPBC is compared with (docs/baselines.md), as published; some also with common extensions."""
