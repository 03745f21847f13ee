# SPDX-License-Identifier: Apache-2.0
"""The simulated robot and its time bases in C: one text for the native loop and for rclpy's executors."""
