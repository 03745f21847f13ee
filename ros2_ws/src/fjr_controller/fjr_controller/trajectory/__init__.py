# SPDX-License-Identifier: Apache-2.0
"""Motions that the controller is asked for: topic, services, action and their planner."""
