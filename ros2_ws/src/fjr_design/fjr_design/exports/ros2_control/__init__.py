# SPDX-License-Identifier: Apache-2.0
"""Export of a scenario as an ament_cmake package for ros2_control: a chainable controller and an elastic arm."""
