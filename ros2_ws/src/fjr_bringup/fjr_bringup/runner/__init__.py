# SPDX-License-Identifier: Apache-2.0
"""Run a scenario with both nodes as processes."""
