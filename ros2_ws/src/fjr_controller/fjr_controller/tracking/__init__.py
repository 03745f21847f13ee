# SPDX-License-Identifier: Apache-2.0
"""The tracking controller without ROS: supervisor, limits, stop policy and law evaluation."""
