# SPDX-License-Identifier: Apache-2.0
"""Interpreter, ROS 2, pinned packages and colcon build from nothing, with the standard library only."""
