# SPDX-License-Identifier: Apache-2.0
"""Export of a scenario as an ament_cmake package for ros2_control: a chainable controller and an elastic arm."""

from .arm import Arm, arm_of, not_exported
from .package import export_package, package_name_of

__all__ = ["Arm", "arm_of", "export_package", "not_exported", "package_name_of"]
