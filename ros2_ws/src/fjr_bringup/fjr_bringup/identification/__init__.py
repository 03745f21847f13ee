# SPDX-License-Identifier: Apache-2.0
"""Identify a robot from recorded motion: read records, write the robot file and the page."""
