# SPDX-License-Identifier: Apache-2.0
"""What nodes and commands share: names, QoS, messages, parameters, process, console, scenarios.

Only here are messages built.
"""
