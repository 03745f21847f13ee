# SPDX-License-Identifier: Apache-2.0
"""Records of motion: read from a table or a bag by a mapping file, and checked against themselves and the robot."""
