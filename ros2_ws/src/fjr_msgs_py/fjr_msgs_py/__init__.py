# SPDX-License-Identifier: Apache-2.0
"""Shared ROS interface of the nodes: names, QoS, messages, parameters and process. Only here are messages built."""
