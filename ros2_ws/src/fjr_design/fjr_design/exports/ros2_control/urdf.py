# SPDX-License-Identifier: Apache-2.0
"""Add the <ros2_control> tag of the simulated arm to a URDF."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.etree import ElementTree

from fjr_core.numerics.checks import MOTOR
from fjr_core.urdf.tree import parse_xml

TAG = "ros2_control"


def with_hardware(urdf: str, package: str, joints: Sequence[str], clock: str, parameters: Mapping[str, object]) -> str:
    """Return the URDF with the simulated arm as its only hardware.

    A joint of the tag must be one of the URDF, so that motors are components of the kind <gpio>, which need none.
    """
    robot = parse_xml(urdf)
    for other in robot.findall(TAG):
        robot.remove(other)
    system = ElementTree.SubElement(robot, TAG, name=package, type="system")
    hardware = ElementTree.SubElement(system, "hardware")
    ElementTree.SubElement(hardware, "plugin").text = f"{package}/ElasticArm"
    for name, value in {"time": "clock", "wait_for_command": "true", **parameters}.items():
        ElementTree.SubElement(hardware, "param", name=name).text = text_of(value)
    for joint in joints:
        _component(system, "joint", joint, command=False)
        _component(system, "gpio", f"{joint}{MOTOR}", command=True)
    ElementTree.SubElement(ElementTree.SubElement(system, "sensor", name=clock), "state_interface", name="stamp")
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def text_of(value: object) -> str:
    """Format a parameter of the hardware: numbers are separated by spaces."""
    return " ".join(map(repr, value)) if isinstance(value, (tuple, list)) else str(value)


def _component(system: ElementTree.Element, kind: str, name: str, command: bool) -> None:
    component = ElementTree.SubElement(system, kind, name=name)
    if command:
        ElementTree.SubElement(component, "command_interface", name="effort")
    for interface in ("position", "velocity", "effort"):
        ElementTree.SubElement(component, "state_interface", name=interface)
