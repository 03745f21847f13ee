# SPDX-License-Identifier: Apache-2.0
"""The simulated arm of a scenario as hardware of ros2_control: its functions, its parameters and its tag in a URDF."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.etree import ElementTree

import casadi as ca

from fjr_core.config.parameter import Parameter
from fjr_core.config.plant import PERIOD_JITTER, imperfection_parameters, sensor_errors
from fjr_core.config.plant import imperfections as build_imperfections
from fjr_core.config.scenario import Scenario
from fjr_core.model.port_hamiltonian import Plant
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import MOTOR
from fjr_core.numerics.parameter_field import declared
from fjr_core.simulation.imperfections import NAMES, ChannelErrors, Imperfections, SensorErrors
from fjr_core.simulation.nonideal_plant import NonidealPlant, layout
from fjr_core.urdf.tree import parse_xml

TAG = "ros2_control"
_GROUP = "imperfections."
DYNAMICS = {field: declared(Imperfections)[field] for field in NAMES}
SENSORS = {field: each for field, each in declared(SensorErrors).items() if field != "velocities"}
"""Declarations of the parameters by field; their names are those of imperfections.* without the group."""


def functions_of(plant: Plant) -> dict[str, ca.Function]:
    """Return the functions of a plant with all its imperfections by their names in C."""
    made = NonidealPlant(Plant(plant.robot, plant.integrator)).functions_as_c
    return {f"plant_{name}": function for name, function in made.items()}


def table_of(robot: Robot) -> list[tuple[str, int, int, float]]:
    """Return name, first index, length and least value of each parameter of the plant.

    The payload is left out for a robot without an end effector.
    """
    rows, first = [], 0
    for field, size in layout(robot.n).sizes.items():
        if robot.links.end_effector is not None or not field.startswith("payload"):
            rows.append((DYNAMICS[field].name, first, size, DYNAMICS[field].minimum))
        first += size
    return rows


def parameters_of(scenario: Scenario) -> dict[str, object]:
    """Return the start of the arm, and the values of imperfections.* that it has and that are not the defaults.

    Names are without the group. Raises ParameterError.
    """
    values, robot, n = scenario.plant_values, scenario.plant.robot, scenario.plant.robot.n
    _ = build_imperfections(values, robot), sensor_errors(values, n)
    known: dict[str, Parameter] = {each.name: each for each in imperfection_parameters(n)}
    names = [each.name for each in (*DYNAMICS.values(), *SENSORS.values())] + ["state_delay", "command_delay", "seed"]
    found = {name: (values[_GROUP + name], known[_GROUP + name].default) for name in names}
    return {
        "initial_link_position": tuple(scenario.x0[:n].tolist()),
        "initial_motor_position": tuple(scenario.x0[n : 2 * n].tolist()),
        **{name: value for name, (value, default) in found.items() if value != default},
    }


def not_exported(scenario: Scenario) -> list[str]:
    """Return the names of the scenario's imperfections that the exported arm does not have."""
    values, defaults = scenario.plant_values, ChannelErrors()
    fields = ("jitter", "loss", "repetition")
    channel = {f: declared(ChannelErrors)[f].name for f in fields}
    names = {
        f"{_GROUP}{side}_{name}": getattr(defaults, f) for side in ("state", "command") for f, name in channel.items()
    }
    names |= {PERIOD_JITTER.name: 0.0, f"{_GROUP}publish_velocity": True}
    return [name for name, default in names.items() if values[name] != default]


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
