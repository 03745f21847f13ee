# SPDX-License-Identifier: Apache-2.0
"""Make the model of a robot from recorded motion.

Which motion to record: `excitation`, by the Fisher information of `elastic_motion`. Records: `read_record` reads a bag
or a table by a mapping file (`record_map`), and refuses what `record_checks` finds with `motion_checks` and
`missing_sensors`. The estimate: `estimation.identify`. What it becomes: `robot_file`, `page`. The commands: `cli`.
"""
