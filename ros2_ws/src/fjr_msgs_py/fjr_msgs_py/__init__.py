# SPDX-License-Identifier: Apache-2.0
"""The shared ROS vocabulary: names, QoS, parameters; numpy to and from messages. Nodes build no message elsewhere."""
