# SPDX-License-Identifier: Apache-2.0
"""A scenario: the parameters of both nodes in one ROS 2 parameter file, and the closed loop that they describe."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ParameterError
from ..extensions.law_registry import V_DPBC
from ..files.importing import is_named
from ..law.gains import Gains
from ..law.interfaces import SampledLaw, StaticLaw
from ..law.vdpbc import TrackingLaw
from ..model.port_hamiltonian import Plant
from ..model.robot import Robot
from ..monitoring.certificate import Certificate
from ..monitoring.one_step_prediction import Prediction
from ..motions.reference import Reference
from ..numerics.checks import Array
from ..robust.law import RobustLaw, sampled_law
from ..runtime.measurement_model import OBSERVER, TORQUE
from ..simulation.closed_loop import Trajectory, simulate
from ..stability.linear_controller import Sensing
from ..urdf.typical_joints import joints_without_inertia
from . import builders, guesses, parameter, reference_file, robot_file, ros_yaml
from . import law as law_parameters
from . import plant as plant_parameters
from .builders import control_law, robust_action
from .measurement import OBSERVER_BANDWIDTH, measurement_parameters
from .nonidealities import channel_errors, imperfection_parameters
from .robot import JOINTS
from .user_options import in_python, unread_options

PLANT, CONTROLLER = "fjr_plant", "fjr_controller"
OWN_PARAMETERS = {PLANT: builders.plant_parameters, CONTROLLER: builders.controller_parameters}


@dataclass(frozen=True)
class Scenario:
    """Checked parameter values of both nodes, and the objects that they describe."""

    name: str
    plant_values: Mapping[str, parameter.Value]
    controller_values: Mapping[str, parameter.Value]
    warnings: tuple[str, ...] = ()

    @property
    def joints(self) -> tuple[str, ...]:
        """Joint names in the order of all lists."""
        return parameter.names(self.controller_values, "joints")

    @property
    def sample_period(self) -> float:
        """Sample period: the time between two states of the plant [s]."""
        return 1.0 / parameter.number(self.plant_values, "publish_rate")

    @property
    def plant_is_the_model(self) -> bool:
        """True if plant and controller have the same robot parameters, as the proof assumes."""
        names = {name for name in (*self.plant_values, *self.controller_values) if name.startswith("robot.")}
        own = self.plant_values[plant_parameters.TYPE.name] != plant_parameters.FLEXIBLE_JOINT
        same = (self.plant_values.get(name) == self.controller_values.get(name) for name in names - {"robot.file"})
        return not own and all(same)

    @property
    def loop_delay(self) -> float:
        """Constant delay of the loop [s]: the sum of the simulated delays of states and commands, without jitter."""
        return sum(channel.delay for channel in channel_errors(self.plant_values))

    @property
    def sensing(self) -> Sensing:
        """Sensing of the control law: velocity observer and torque sensor, from measurement.*."""
        values = self.controller_values
        observed = values["measurement.velocity"] == OBSERVER
        bandwidth = parameter.number(values, OBSERVER_BANDWIDTH.name) if observed else None
        return Sensing(bandwidth, by_torque=values["measurement.motor"] == TORQUE)

    @cached_property
    def robot(self) -> Robot:
        """The controller's model of the robot."""
        return builders.robot(self.controller_values)

    @cached_property
    def gains(self) -> Gains:
        """The gains of v-dPBC."""
        return builders.gains(self.controller_values, self.robot.n)

    @cached_property
    def law(self) -> StaticLaw:
        """The control law."""
        return control_law(self.controller_values, self.robot)

    @property
    def certified_law(self) -> TrackingLaw | None:
        """The control law if it is v-dPBC, which has a certificate, else None; a law of the user is not imported."""
        if self.controller_values[law_parameters.TYPE.name] != V_DPBC:
            return None
        return self.tracking_law

    @property
    def tracking_law(self) -> TrackingLaw:
        """The control law if it is v-dPBC; raises ParameterError for a baseline."""
        if not isinstance(self.law, TrackingLaw):
            raise ParameterError(f"parameter 'law.type' is {self.controller_values['law.type']!r}; expected 'v_dpbc'")
        return self.law

    @cached_property
    def sampled_law(self) -> SampledLaw:
        """The control law with the robust action of robust.*, as the controller runs it."""
        return sampled_law(self.law, robust_action(self.controller_values, self.law))

    @cached_property
    def reference(self) -> Reference:
        """The reference trajectory; time 0 is the stamp of the first state that the controller answers."""
        return builders.reference(self.controller_values, self.robot.n)

    @cached_property
    def motion_warnings(self) -> tuple[str, ...]:
        """A sentence for each property of a reference from a file that asks for large efforts (docs/references.md)."""
        if self.controller_values["reference.type"] != "file":
            return ()
        return tuple(reference_file.file_warnings(self.controller_values, self.robot))

    @property
    def robot_warnings(self) -> tuple[str, ...]:
        """A sentence for each joint without inertia and each kind of robot.* value that is a guess."""
        thin = joints_without_inertia(self.robot).items()
        return (
            *(f"{self.joints[i]} {seen}; expected the inertia of its links in the URDF" for i, seen in thin),
            *guesses.guess_sentences(self.controller_values),
        )

    @cached_property
    def plant(self) -> Plant:
        """The simulated robot, from the plant's own parameters."""
        return builders.plant(self.plant_values, builders.robot(self.plant_values))

    @cached_property
    def x0(self) -> Array:
        """The plant's initial state (4n,)."""
        return builders.initial_state(self.plant_values, self.plant.robot)

    def configurations(self, k: int = 64) -> Array:
        """Return link positions (k + 1, n) [rad]: the initial ones and k of the reference."""
        return np.vstack([self.x0[: self.robot.n], self.reference.configurations(k)])

    def warm_up(self) -> None:
        """Build law and plant step as the nodes do, so that their compiled functions are cached when they start."""
        _ = self.law.measured_function
        if isinstance(self.sampled_law, RobustLaw):
            _ = self.sampled_law.ready_step
        if self.controller_values["certificate"] and isinstance(self.law, TrackingLaw):
            _ = Certificate(self.law).function, Prediction(self.law).function
        self.plant.step(self.x0, [0.0] * self.robot.n, self.sample_period)

    def simulate(self, duration: float) -> Trajectory:
        """Simulate the sampled closed loop of both nodes in lock-step, without ROS, for `duration` [s].

        The plant is ideal: imperfections.* are not simulated, so there is no delay either.
        """
        inner = self.sample_period / int(parameter.number(self.plant_values, "inner_steps"))
        law = self.sampled_law if isinstance(self.sampled_law, RobustLaw) else self.law
        return simulate(self.plant, law, self.reference, self.x0, duration, self.sample_period, inner)


def load_scenario(path: str | Path, user_code: bool = True) -> Scenario:
    """Read a scenario file; raises ParameterError, which names the file.

    user_code: import a law and a plant of the user that it names. The report of a run needs neither: false.
    """
    path = Path(path)
    document = ros_yaml.read(path, "scenario")
    try:
        return _scenario(path.stem, document, path.parent, user_code)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from None


def parse_scenario(name: str, text: str) -> Scenario:
    """Read a scenario from its text; relative paths start at the current directory. Raises ParameterError."""
    return _scenario(name, ros_yaml.parse(text), Path.cwd())


def _scenario(name: str, document: Any, folder: Path, user_code: bool = True) -> Scenario:
    warnings: list[str] = []
    checked = {}
    reference_file.read_again()
    for node, direct in given_to_nodes(document).items():
        own = OWN_PARAMETERS[node]
        given = builders.without_others(own, robot_file.merged(direct, node, folder), direct)
        known = builders.all_parameters(own, given, user_code)
        own_names = set(given) - _for_other_nodes(node, own, document)
        unread = own_names & unread_options(known, given, user_code)
        warnings += [
            f"{node}: parameter '{name}' is ignored: there is no class with options" for name in sorted(unread)
        ]
        parameter.refuse_unknown([each.name for each in known], own_names - unread, builders.names_of_others(own))
        checked[node] = parameter.complete(known, given)
    scenario = Scenario(name, checked[PLANT], checked[CONTROLLER])
    warnings += _hold_warnings(scenario) + (_python_warnings(scenario) if user_code else [])
    scenario = replace(scenario, warnings=tuple(warnings))
    joints = [checked[node]["joints"] for node in OWN_PARAMETERS]
    if joints[0] != joints[1]:
        raise ParameterError(
            f"parameter 'joints' is {joints[0]} for the plant and {joints[1]} for the controller; expected the same"
        )
    _build(scenario, user_code)
    return scenario


def given_to_nodes(document: Any) -> dict[str, dict[str, object]]:
    """Return the values that a parameter file gives to each node; raises ParameterError.

    Sections of other nodes are left out, unless their name resembles one of these nodes' or there are no others.
    """
    given = {node: ros_yaml.values_for(node, document) for node in OWN_PARAMETERS}
    own = {section for node in OWN_PARAMETERS for section in ros_yaml.sections(node)}
    for section in document:
        name = str(section).rpartition("/")[2]
        close = parameter.resembling(name, OWN_PARAMETERS, least=0.8)
        if section not in own and close and name != close:
            raise ParameterError(f"has the section '{section}', of another node; did you mean '/**/{close}'?")
    if document and not own & set(document):
        raise ParameterError(
            f"has no section of these nodes ({', '.join(map(str, document))}); expected {ros_yaml.SHARED}, "
            + " or ".join(f"/**/{node}" for node in OWN_PARAMETERS)
        )
    return given


def _build(scenario: Scenario, user_code: bool) -> None:
    """Build the objects of the values, of classes of the user on request; raises ParameterError."""
    _ = scenario.reference
    if user_code or not is_named(scenario.controller_values[law_parameters.TYPE.name]):
        _ = scenario.sampled_law
    if user_code or not is_named(scenario.plant_values[plant_parameters.TYPE.name]):
        _ = scenario.plant, scenario.x0


def _for_other_nodes(node: str, own: builders.OwnParameters, document: Any) -> set[str]:
    """Return the names in the section for all nodes that only other nodes declare."""
    private = {section: content for section, content in document.items() if section != ros_yaml.SHARED}
    shared = set(ros_yaml.values_for(node, document)) - set(ros_yaml.values_for(node, private))
    return {name for name in shared if builders.is_of_others(own, name)}


def _hold_warnings(scenario: Scenario) -> list[str]:
    """Return a warning if robust.hold, over which the law predicts or integrates, is not the sample period."""
    values, period = scenario.controller_values, scenario.sample_period
    robust = builders.robust(values, len(scenario.joints))
    if not (robust.predicts or robust.integrates) or math.isclose(robust.hold, period, rel_tol=1e-6):
        return []
    return [f"{CONTROLLER}: parameter 'robust.hold' is {values['robust.hold']} s; the states' period is {period:g} s"]


def _python_warnings(scenario: Scenario) -> list[str]:
    """Return a sentence for a law and a plant that are evaluated in Python."""
    found = (
        in_python(law_parameters.TYPE, scenario.controller_values),
        in_python(plant_parameters.TYPE, scenario.plant_values),
    )
    return [sentence for sentence in found if sentence]


def self_contained(given: Mapping[str, Mapping[str, object]], folder: Path) -> dict[str, Any]:
    """Return a parameter file of the values given to each node that needs no other file: robot, URDF, motion.

    Values that the nodes share are in the section /**, which is also the section of `-p` on a command line.
    Relative paths in `given` start at `folder`. Raises ParameterError.
    """
    whole = {node: _inlined(robot_file.merged(values, node, folder)) for node, values in given.items()}
    shared: dict[str, object] = {}
    for values in whole.values():
        shared |= {name: value for name, value in values.items() if _is_common(name, value, whole)}
    sections = {ros_yaml.SHARED: shared}
    for node, values in whole.items():
        sections[f"/**/{node}"] = {name: value for name, value in values.items() if name not in shared}
    return {section: {"ros__parameters": ros_yaml.tree_of(values)} for section, values in sections.items() if values}


def _inlined(values: Mapping[str, object]) -> dict[str, object]:
    """Return merged values with the texts of URDF and motion in place of their paths."""
    joints = parameter.names(parameter.complete([JOINTS], values), JOINTS.name)
    return reference_file.inlined(robot_file.inlined(values), joints)


def _is_common(name: str, value: object, given: Mapping[str, Mapping[str, object]]) -> bool:
    """Return True if every node that has the parameter is given this value."""
    return all(
        _same(value, values[name]) if name in values else builders.is_of_others(OWN_PARAMETERS[node], name)
        for node, values in given.items()
    )


def _same(first: object, second: object) -> bool:
    return repr(first) == repr(second)  # nan equals nan, 1 differs from 1.0


def left_out(scenario: Scenario) -> list[str]:
    """Return the names of the parameters by which plant or measurement differ from the ideal ones."""
    known = {
        "plant_values": imperfection_parameters(len(scenario.joints)),
        "controller_values": measurement_parameters(len(scenario.joints)),
    }
    pairs = [(getattr(scenario, values), parameter) for values, all_ in known.items() for parameter in all_]
    return [parameter.name for values, parameter in pairs if values[parameter.name] != parameter.default]
