# SPDX-License-Identifier: Apache-2.0
"""Make the model of a robot from recorded motion.

`excitation` designs the motion to record. `records` reads a bag or a table by a mapping file, and refuses what
contradicts itself or the robot. `estimation` fits the arm to records, `robot_file` writes the robot, `page` the report.
"""
