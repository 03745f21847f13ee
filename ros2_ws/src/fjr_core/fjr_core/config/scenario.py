# SPDX-License-Identifier: Apache-2.0
"""A scenario: the parameters of both nodes in one ROS 2 parameter file, and the closed loop that they describe."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import ParameterError, prefixed
from ..extensions.law_registry import V_DPBC
from ..files.importing import is_named
from ..numerics.checks import Array
from . import controller as controller_parameters
from . import law as law_parameters
from . import parameter, robot_file, ros_yaml
from . import plant as plant_parameters
from . import reference as reference_parameters
from . import robot as robot_parameters
from .controller import OBSERVER_BANDWIDTH, measurement_parameters
from .nodes import CONTROLLER, NODES, PLANT, is_of_others, own_parameters, resolve

if TYPE_CHECKING:
    from ..law.gains import Gains
    from ..law.interfaces import SampledLaw, StaticLaw
    from ..law.vdpbc import TrackingLaw
    from ..model.port_hamiltonian import Plant
    from ..model.robot import Robot
    from ..motions.reference import Reference
    from ..runtime.control_step import ControlStep
    from ..runtime.measurement_model import Measurement
    from ..runtime.safety_settings import Settings
    from ..runtime.velocity_observer import VelocityObserver
    from ..simulation.closed_loop import Trajectory
    from ..stability.linear_controller import Sensing


@dataclass(frozen=True)
class Scenario:
    """Checked parameter values of both nodes, and the objects that they describe, which are built on use."""

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
        """True if plant and controller have the same robot parameters and nothing is touched, as the proof assumes."""
        names = {name for name in (*self.plant_values, *self.controller_values) if name.startswith("robot.")}
        names = {name for name in names if not name.startswith(("robot.deviations.", "robot.guesses."))}
        own = self.plant_values[plant_parameters.TYPE.name] != plant_parameters.FLEXIBLE_JOINT
        same = (self.plant_values.get(name) == self.controller_values.get(name) for name in names - {"robot.file"})
        return not own and self.plant_values[plant_parameters.OBSTACLE_TYPE] == plant_parameters.NONE and all(same)

    @property
    def loop_delay(self) -> float:
        """Constant delay of the loop [s]: the sum of the simulated delays of states and commands, without jitter."""
        return sum(channel.delay for channel in plant_parameters.channel_errors(self.plant_values))

    @property
    def sensing(self) -> Sensing:
        """Sensing of the control law: velocity observer and torque sensor, from measurement.*."""
        from ..stability.linear_controller import Sensing

        bandwidth = parameter.number(self.controller_values, OBSERVER_BANDWIDTH.name)
        return Sensing(bandwidth if self.measurement.observed else None, self.measurement.by_torque)

    @cached_property
    def robot(self) -> Robot:
        """The controller's model of the robot."""
        return robot_parameters.robot(self.controller_values)

    @cached_property
    def gains(self) -> Gains:
        """The gains of v-dPBC."""
        return law_parameters.gains(self.controller_values, self.robot.n)

    @cached_property
    def law(self) -> StaticLaw:
        """The control law."""
        return law_parameters.control_law(self.controller_values, self.robot)

    @property
    def certified_law(self) -> TrackingLaw | None:
        """The control law if it is v-dPBC, which has a certificate, else None; a law of the user is not imported."""
        return self.tracking_law if self.controller_values[law_parameters.TYPE.name] == V_DPBC else None

    @property
    def tracking_law(self) -> TrackingLaw:
        """The control law if it is v-dPBC; raises ParameterError for a baseline."""
        from ..law.vdpbc import TrackingLaw

        if not isinstance(self.law, TrackingLaw):
            raise ParameterError(f"parameter 'law.type' is {self.controller_values['law.type']!r}; expected 'v_dpbc'")
        return self.law

    @cached_property
    def sampled_law(self) -> SampledLaw:
        """The control law with the robust action of robust.*, as the controller runs it."""
        action = law_parameters.robust_action(self.controller_values, self.law)
        if action.off:
            return self.law.sampled
        from ..robust.law import RobustLaw

        return RobustLaw(self.law, action)

    @cached_property
    def settings(self) -> Settings:
        """Limits, start and stop policy of the controller."""
        return controller_parameters.safety(self.controller_values, self.robot)

    @cached_property
    def measurement(self) -> Measurement:
        """What the sensors measure."""
        return controller_parameters.measurement(self.controller_values, self.robot)

    @property
    def observer(self) -> VelocityObserver | None:
        """A new velocity observer; None if velocities are measured."""
        return controller_parameters.observer(self.controller_values, self.robot)

    @cached_property
    def reference(self) -> Reference:
        """The reference trajectory; time 0 is the stamp of the first state that the controller answers."""
        return reference_parameters.reference(self.controller_values, self.robot.n)

    @cached_property
    def motion_warnings(self) -> tuple[str, ...]:
        """A sentence for each property of a reference from a file that asks for large efforts (docs/references.md)."""
        if self.controller_values["reference.type"] != "file":
            return ()
        from .motion_warnings import file_warnings

        return tuple(file_warnings(self.controller_values, self.robot))

    @property
    def robot_warnings(self) -> tuple[str, ...]:
        """A sentence for each joint without inertia and each kind of robot.* value that is a guess."""
        from ..urdf.typical_joints import joints_without_inertia

        thin = joints_without_inertia(self.robot).items()
        return (
            *(f"{self.joints[i]} {seen}; expected the inertia of its links in the URDF" for i, seen in thin),
            *robot_parameters.guess_sentences(self.controller_values),
        )

    @cached_property
    def plant(self) -> Plant:
        """The simulated robot, from the plant's own parameters."""
        return plant_parameters.plant(self.plant_values, robot_parameters.robot(self.plant_values))

    @cached_property
    def x0(self) -> Array:
        """The plant's initial state (4n,)."""
        return plant_parameters.initial_state(self.plant_values, self.plant.robot)

    @property
    def inner_steps(self) -> int:
        """Integrator steps of the plant per sample."""
        return int(parameter.number(self.plant_values, "inner_steps"))

    def control_step(self, simulated: bool = False, compile: bool = False) -> ControlStep:
        """Return the control step of the controller, waiting for its first sample; see ControlStep."""
        from ..runtime.control_step import ControlStep

        robust = law_parameters.robust_action(self.controller_values, self.law)
        parts = self.law, self.reference, self.settings, self.observer
        return ControlStep(*parts, simulated, robust, self.measurement, compile)

    def configurations(self, k: int = 64) -> Array:
        """Return link positions (k + 1, n) [rad]: the initial ones and k of the reference."""
        return np.vstack([self.x0[: self.robot.n], self.reference.configurations(k)])

    def warm_up(self) -> None:
        """Build law and plant step as the nodes do, so that their compiled functions are cached when they start."""
        from ..law.vdpbc import TrackingLaw
        from ..monitoring.certificate import Certificate, Prediction

        _ = self.law.function, self.sampled_law.function
        if self.controller_values["certificate"] and isinstance(self.law, TrackingLaw):
            _ = Certificate(self.law).function, Prediction(self.law).function
        self.plant.step(self.x0, [0.0] * self.robot.n, self.sample_period)

    def simulate(self, duration: float) -> Trajectory:
        """Simulate the sampled closed loop of both nodes in lock-step, without ROS, for `duration` [s].

        The plant is ideal: imperfections.* are not simulated, so there is no delay either.
        """
        from ..simulation.closed_loop import simulate

        inner = self.sample_period / self.inner_steps
        return simulate(self.plant, self.sampled_law, self.reference, self.x0, duration, self.sample_period, inner)

    def checked(self, user_code: bool = True) -> Scenario:
        """Return this scenario once what it describes is built; raises ParameterError for values that contradict.

        user_code: build a law and a plant of the user, too.
        """
        own_law, own_plant = (is_named(values[kind.name]) for kind, values in _types(self))
        _ = self.reference, self.measurement, robot_parameters.stated_errors(self.controller_values)
        if user_code or not own_law:
            _ = self.sampled_law
        if user_code or not own_plant:
            _ = self.plant, self.x0
        return self


def load_scenario(path: str | Path, user_code: bool = True) -> Scenario:
    """Read and check a scenario file; raises ParameterError, which names the file.

    user_code: import a law and a plant of the user that it names. The report of a run needs neither: false.
    """
    scenario = read_scenario(path, user_code)
    with prefixed(f"{path}: "):
        return scenario.checked(user_code)


def read_scenario(path: str | Path, user_code: bool = True) -> Scenario:
    """Read a scenario file and check each value by itself; `checked` does the rest. Arguments as of load_scenario."""
    path = Path(path)
    document = ros_yaml.read(path, "scenario")
    with prefixed(f"{path}: "):
        return _scenario(path.stem, document, path.parent, user_code)


def parse_scenario(name: str, text: str) -> Scenario:
    """Read and check a scenario of a text; relative paths start at the current directory. Raises ParameterError."""
    return _scenario(name, ros_yaml.parse(text), Path.cwd()).checked()


def _scenario(name: str, document: Any, folder: Path, user_code: bool = True) -> Scenario:
    """Return the scenario of a document, with its values checked and its warnings."""
    reference_parameters.forget_files()
    checked, warnings = checked_values(document, folder, user_code)
    scenario = Scenario(name, checked[PLANT], checked[CONTROLLER])
    in_python = [parameter.in_python(kind, values) for kind, values in _types(scenario) if user_code]
    scenario = replace(scenario, warnings=(*warnings, *filter(None, [_hold_warning(scenario), *in_python])))
    joints = [checked[node]["joints"] for node in (PLANT, CONTROLLER)]
    if joints[0] != joints[1]:
        raise ParameterError(
            f"parameter 'joints' is {joints[0]} for the plant and {joints[1]} for the controller; expected the same"
        )
    return scenario


def _types(scenario: Scenario) -> tuple[tuple[parameter.Parameter, parameter.Values], ...]:
    """Return the parameters that may name classes of the user, each with the values of its node."""
    return (law_parameters.TYPE, scenario.controller_values), (plant_parameters.TYPE, scenario.plant_values)


def _hold_warning(scenario: Scenario) -> str:
    """Return a warning if robust.hold, over which the law predicts or integrates, is not the sample period."""
    values, period = scenario.controller_values, scenario.sample_period
    robust = law_parameters.robust(values, len(scenario.joints))
    if not (robust.predicts or robust.integrates) or math.isclose(robust.hold, period, rel_tol=1e-6):
        return ""
    return f"{CONTROLLER}: parameter 'robust.hold' is {values['robust.hold']} s; the states' period is {period:g} s"


def left_out(scenario: Scenario) -> list[str]:
    """Return the names of the parameters by which plant or measurement differ from the ideal ones."""
    n = len(scenario.joints)
    known = [(scenario.plant_values, each) for each in plant_parameters.imperfection_parameters(n)]
    known += [(scenario.controller_values, each) for each in measurement_parameters(n)]
    return [each.name for values, each in known if values[each.name] != each.default]


def given_to_nodes(document: Any) -> dict[str, dict[str, object]]:
    """Return the values that a parameter file gives to each node; raises ParameterError.

    Sections of other nodes are left out, unless their name resembles one of these nodes' or there are no others.
    """
    given = {node: ros_yaml.values_for(node, document) for node in NODES}
    own = {section for node in NODES for section in ros_yaml.sections(node)}
    for section in document:
        name = str(section).rpartition("/")[2]
        close = parameter.resembling(name, NODES, least=0.8)
        if section not in own and close and name != close:
            raise ParameterError(f"has the section '{section}', of another node; did you mean '/**/{close}'?")
    if document and not own & set(document):
        raise ParameterError(
            f"has no section of these nodes ({', '.join(map(str, document))}); expected {ros_yaml.SHARED}, "
            + " or ".join(f"/**/{node}" for node in NODES)
        )
    return given


def checked_values(
    document: Any, folder: Path, user_code: bool = True
) -> tuple[dict[str, dict[str, parameter.Value]], tuple[str, ...]]:
    """Return the complete values of each node that a parameter file in `folder` describes, and the warnings.

    user_code: see all_parameters. Raises ParameterError.
    """
    checked, warnings, by_node = {}, [], given_to_nodes(document)
    private = {section: content for section, content in document.items() if section != ros_yaml.SHARED}
    for node, direct in by_node.items():
        own, alone = own_parameters(node), ros_yaml.values_for(node, private)
        given = {name: value for name, value in direct.items() if name in alone or not is_of_others(own, name)}
        found = resolve(own, given, node, folder, user_code=user_code)
        checked[node] = found.values
        warnings += [f"{node}: parameter '{name}' is ignored: there is no class with options" for name in found.ignored]
    return checked, tuple(warnings)


def self_contained(given: Mapping[str, Mapping[str, object]], folder: Path) -> dict[str, Any]:
    """Return a parameter file of the values given to each node that needs no other file: robot, URDF, motion.

    Values that the nodes share are in the section /**, which is also the section of `-p` on a command line.
    Relative paths in `given` start at `folder`. Raises ParameterError.
    """
    whole = {}
    for node, values in given.items():
        merged = robot_file.merged(values, node, folder)
        joints = parameter.names(parameter.complete([robot_parameters.JOINTS], merged), "joints")
        inlined = robot_file.motion_inlined(robot_file.inlined(merged), joints)
        whole[node] = {name: value for name, value in inlined.items() if not is_of_others(own_parameters(node), name)}

    def is_common(name: str, value: object) -> bool:
        """Return whether every node that has the parameter is given this value."""
        return all(
            repr(values[name]) == repr(value)  # nan equals nan, 1 differs from 1.0
            if name in values
            else is_of_others(own_parameters(node), name)
            for node, values in whole.items()
        )

    shared = {name: value for values in whole.values() for name, value in values.items() if is_common(name, value)}
    sections = {ros_yaml.SHARED: shared}
    for node, values in whole.items():
        sections[f"/**/{node}"] = {name: value for name, value in values.items() if name not in shared}
    return {section: {"ros__parameters": ros_yaml.tree_of(values)} for section, values in sections.items() if values}
