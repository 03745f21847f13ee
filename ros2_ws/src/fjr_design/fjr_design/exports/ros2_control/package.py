# SPDX-License-Identifier: Apache-2.0
"""Write the files of the package for ros2_control, with the parameters of controller and arm as tables.

The tables are C++ for the sources, and Markdown for the README.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

import casadi as ca
import numpy as np

from fjr_core.config.plant import imperfections as build_imperfections
from fjr_core.config.plant import sensor_errors
from fjr_core.config.robot import description
from fjr_core.config.scenario import Scenario, left_out
from fjr_core.errors import ParameterError
from fjr_core.law.interfaces import StaticLaw
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.port_hamiltonian import Plant
from fjr_core.model.robot import Robot
from fjr_core.monitoring.certificate import Certificate
from fjr_core.numerics.checks import MOTOR
from fjr_core.numerics.parameter_field import declared
from fjr_core.runtime.events import KINDS, SENTENCES, level_of
from fjr_core.runtime.safety_settings import Settings
from fjr_core.simulation.imperfections import NAMES, Imperfections, SensorErrors
from fjr_core.simulation.nonideal_plant import NonidealPlant, layout
from fjr_core.urdf.tree import parse_xml
from fjr_core.version import __version__
from fjr_monitor.diagnosis.thresholds import LONGEST_JUDGED

from ..c_code import filled, number, quoted
from ..project import exportable, recorded_case, step_code

TAG = "ros2_control"
_GROUP = "imperfections."
DYNAMICS = {field: declared(Imperfections)[field] for field in NAMES}
SENSORS = {field: each for field, each in declared(SensorErrors).items() if field != "velocities"}
"""Declarations of the parameters by field; their names are those of imperfections.* without the group."""
EXPORTED = {each.name for each in (*DYNAMICS.values(), *SENSORS.values())} | {"state_delay", "command_delay", "seed"}
"""Names of the imperfections that the arm has."""
SAMPLES = 400  # of the simulation that the test of the package repeats
LONGEST_NAME = 60  # characters
CERTIFIED = ("V", "H", "dissipation", "dissipated", "u_law", "drive")
"""Outputs of the certificate's function that fjr_certify reads; the last, its gradient, would double the code."""


def package_name_of(scenario: str) -> str:
    """Convert the name of a scenario to that of a package: "Arm-7 b" gives arm_7_b_ros2_control."""
    plain = re.sub(r"[^a-z0-9]+", "_", scenario.lower()).strip("_")
    return f"{plain if plain[:1].isalpha() else f'robot_{plain}'.rstrip('_')}_ros2_control"


def export_package(scenario: Scenario, package: str, samples: int = SAMPLES) -> dict[str, str]:
    """Return the texts of all files by their path in the package.

    Raises ParameterError for an invalid name of the package, StateError for a law or plant in Python and for a loop
    that diverges within the samples of the test, TrajectoryError for a reference that is not built in.
    """
    if not re.fullmatch(r"[a-z](_?[a-z0-9])*", package) or len(package) > LONGEST_NAME:
        raise ParameterError(
            f"package is '{package}'; expected a lower-case letter, then letters, digits or single '_', "
            f"at most {LONGEST_NAME}"
        )
    scenario = exportable(scenario)
    arm = NonidealPlant(Plant(scenario.plant.robot, scenario.plant.integrator)).functions_as_c
    functions = {**_certificate(scenario.certified_law), **{f"plant_{name}": each for name, each in arm.items()}}
    texts = {f"step/{name}": text for name, text in step_code(scenario, functions).items()}
    texts |= filled("ros2_control/templates", package=package, samples=samples, **_values(scenario))
    urdf, parameters = description(scenario.plant_values), parameters_of(scenario)
    texts[f"urdf/{package}.urdf"] = with_hardware(urdf, package, scenario.joints, f"{package}_clock", parameters)
    return texts | {"test/case.txt": recorded_case(scenario, samples)}


def _certificate(law: TrackingLaw | None) -> dict[str, ca.Function]:
    """Return the function of the certificate with the outputs of CERTIFIED, if the law has one."""
    if law is None:
        return {}
    function = Certificate(law).function
    outputs = [function.index_out(name) for name in CERTIFIED]
    return {"certificate": function.slice("certificate", list(range(function.n_in())), outputs)}


def _values(scenario: Scenario) -> dict[str, Any]:
    """Return the values of the names in the templates, beside the package and its samples.

    plant_table: name, place, length and least value of each parameter of the plant. The rate of the certificate is that
    of the whole range where a closed form proves one, else of the scenario's configurations.
    """
    law, missing = scenario.certified_law, ", ".join(f"`{name}`" for name in not_exported(scenario))
    rows = []
    for name, first, length, least in table_of(scenario.plant.robot):
        bound = number(float(least)) if np.isfinite(least) else "-std::numeric_limits<double>::infinity()"
        rows.append(f"  {{{quoted(name)}, {first}, {length}, {bound}}}")  # INFINITY is a float in C++
    everywhere = law is not None and law.robot.links.M_l_vertices is not None
    return {
        "scenario": scenario,
        "version": __version__,
        "motors": [f"{joint}{MOTOR}" for joint in scenario.joints],
        "chained": [f"tracking_controller/{joint}" for joint in scenario.joints],
        "longest": LONGEST_JUDGED,
        "certified": law is not None,
        "bounded": law is not None and isinstance(scenario.sampled_law, StaticLaw),
        "beta": law.rate(None if everywhere else scenario.configurations()).beta if law else 0.0,
        "ideal": Imperfections(scenario.robot.n).vector,
        "plant_table": ",\n".join(rows),
        **_gain_values(law, scenario.robot.n),
        "safety": declared(Settings).values(),
        "arm": [*DYNAMICS.values(), *SENSORS.values()],
        "kinds": ",\n".join(f"  {{{quoted(name)}, Level::{level_of(name)}}}" for name in KINDS),
        "wiring_sentences": ",\n".join(f"  {quoted(sentence)}" for sentence in SENTENCES.values()),
        "not_exported": f"\nThe scenario also sets {missing}: not in this arm.\n" if missing else "",
    }


def _gain_values(law: TrackingLaw | None, n: int) -> dict[str, str]:
    """Return the rows of the gains that may be changed, and the index of K_md among them.

    Gains of v-dPBC only. A full matrix Pi_m is left out, because the law needs its inverse.
    """
    if law is None:
        return {"gain_table": "", "hold_damping_gain": "-1"}
    first, starts = 0, {}
    for name, symbol in law.symbols.by_name.items():
        starts[name] = first, symbol.nnz()
        first += symbol.nnz()
    inverse = starts.pop("Pi_m_inverse")
    if inverse[1] != n:
        del starts["Pi_m"]
    rows = [(name, *start, inverse[0] if name == "Pi_m" else -1) for name, start in starts.items()]
    text = ",\n  ".join(f"{{{quoted(name)}, {start}, {length}, {at}}}" for name, start, length, at in rows)
    return {"gain_table": f"\n  {text}", "hold_damping_gain": str([row[0] for row in rows].index("K_md"))}


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
    values, n = scenario.plant_values, scenario.plant.robot.n
    _ = build_imperfections(values, n), sensor_errors(values, n)
    return {
        "initial_link_position": tuple(scenario.x0[:n].tolist()),
        "initial_motor_position": tuple(scenario.x0[n : 2 * n].tolist()),
        **{name: values[_GROUP + name] for name in _imperfect(scenario) if name in EXPORTED},
    }


def not_exported(scenario: Scenario) -> list[str]:
    """Return the names of the scenario's imperfections that the exported arm does not have."""
    return [_GROUP + name for name in _imperfect(scenario) if name not in EXPORTED]


def _imperfect(scenario: Scenario) -> list[str]:
    """Return the names, without the group, of imperfections.* that are not the defaults."""
    return [name.removeprefix(_GROUP) for name in left_out(scenario) if name.startswith(_GROUP)]


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
        text = " ".join(map(repr, value)) if isinstance(value, (tuple, list)) else str(value)
        ElementTree.SubElement(hardware, "param", name=name).text = text
    for joint in joints:
        _component(system, "joint", joint, command=False)
        _component(system, "gpio", f"{joint}{MOTOR}", command=True)
    ElementTree.SubElement(ElementTree.SubElement(system, "sensor", name=clock), "state_interface", name="stamp")
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _component(system: ElementTree.Element, kind: str, name: str, command: bool) -> None:
    component = ElementTree.SubElement(system, kind, name=name)
    if command:
        ElementTree.SubElement(component, "command_interface", name="effort")
    for interface in ("position", "velocity", "effort"):
        ElementTree.SubElement(component, "state_interface", name=interface)
