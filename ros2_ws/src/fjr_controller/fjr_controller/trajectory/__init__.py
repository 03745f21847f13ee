# SPDX-License-Identifier: Apache-2.0
"""Requested motions: topic, services, action and their planner."""
