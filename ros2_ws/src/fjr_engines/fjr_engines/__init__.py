# SPDX-License-Identifier: Apache-2.0
"""Simulators of others behind the topics of the plant, and robots in their formats."""
