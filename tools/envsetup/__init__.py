# SPDX-License-Identifier: Apache-2.0
"""Set up interpreter, ROS 2, pinned packages and colcon build with the standard library only."""
