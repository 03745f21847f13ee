# SPDX-License-Identifier: Apache-2.0
"""Baseline laws that v-dPBC is compared with (docs/compare.md), as published; some also with common extensions."""
