# SPDX-License-Identifier: Apache-2.0
"""Loops in C between rclpy's subscriptions and publishers: serialised messages, thread, queue of records."""
