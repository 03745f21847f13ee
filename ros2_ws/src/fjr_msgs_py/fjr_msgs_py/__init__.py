# SPDX-License-Identifier: Apache-2.0
"""Shared ROS vocabulary: topics, joint naming, QoS, parameters; numpy to and from messages."""
