# SPDX-License-Identifier: Apache-2.0
"""Runs in lock-step without ROS: labelled ones for the diagnosis, with its confusion tables, and those of sensors."""
