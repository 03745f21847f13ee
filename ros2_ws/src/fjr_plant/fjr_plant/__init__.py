# SPDX-License-Identifier: Apache-2.0
"""Simulated flexible-joint robot as a ROS 2 node."""
