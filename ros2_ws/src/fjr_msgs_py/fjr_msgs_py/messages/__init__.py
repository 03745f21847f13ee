# SPDX-License-Identifier: Apache-2.0
"""ROS messages to and from NumPy arrays."""
