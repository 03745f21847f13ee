# SPDX-License-Identifier: Apache-2.0
"""A scenario: one ROS 2 parameter file for both nodes, read without ROS and made into the closed loop."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..control.robust import RobustLaw, sampled_law
from ..control.sampled_law import SampledLaw
from ..control.static_law import StaticLaw
from ..control.vdpbc.gains import Gains
from ..control.vdpbc.law import TrackingLaw
from ..errors import ParameterError
from ..estimation.measurement_model import OBSERVER, TORQUE
from ..monitoring.certificate import Balance
from ..monitoring.one_step_prediction import Prediction
from ..numerics.checks import Array
from ..robot.port_hamiltonian import Plant
from ..robot.robot import Robot
from ..simulation.closed_loop import Trajectory, simulate
from ..stability.linear_controller import Sensing
from ..trajectories.reference import Reference
from . import builders, parameter, robot_file, ros_yaml
from .builders import control_law, robust_action
from .measurement import measurement_parameters
from .nonidealities import channel_errors, imperfection_parameters

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
        return tuple(str(name) for name in self.controller_values["joints"])  # type: ignore[union-attr]

    @property
    def sample_period(self) -> float:
        """Period of the plant's states [s]."""
        return 1.0 / float(self.plant_values["publish_rate"])  # type: ignore[arg-type]

    @property
    def plant_is_the_model(self) -> bool:
        """Whether the plant is the very robot that the controller believes in: what is proven is proven for that."""
        names = {name for name in (*self.plant_values, *self.controller_values) if name.startswith("robot.")}
        return all(self.plant_values.get(name) == self.controller_values.get(name) for name in names - {"robot.file"})

    @property
    def loop_delay(self) -> float:
        """Known delay of the loop [s]: that of the simulated plant's states and commands, without their jitter."""
        return sum(channel.delay for channel in channel_errors(self.plant_values))

    @property
    def sensing(self) -> Sensing:
        """What the controller's law gets of the plant: measurement.*."""
        values = self.controller_values
        observed = values["measurement.velocity"] == OBSERVER
        bandwidth = float(values["measurement.observer_bandwidth"]) if observed else None  # type: ignore[arg-type]
        return Sensing(bandwidth, by_torque=values["measurement.motor"] == TORQUE)

    @cached_property
    def robot(self) -> Robot:
        """The robot that the controller believes in."""
        return builders.robot(self.controller_values)

    @cached_property
    def gains(self) -> Gains:
        """The controller's gains."""
        return builders.gains(self.controller_values, self.robot.n)

    @cached_property
    def law(self) -> StaticLaw:
        """The controller's law."""
        return control_law(self.controller_values, self.robot)

    @property
    def tracking_law(self) -> TrackingLaw:
        """The controller's law where it is v-dPBC; raises ParameterError where it is another one."""
        if not isinstance(self.law, TrackingLaw):
            raise ParameterError(f"parameter 'law.type' is {self.controller_values['law.type']!r}; expected 'v_dpbc'")
        return self.law

    @cached_property
    def sampled_law(self) -> SampledLaw:
        """The law as the controller runs it, with the robust action that the parameters ask for."""
        return sampled_law(self.law, robust_action(self.controller_values, self.law))

    @cached_property
    def reference(self) -> Reference:
        """The reference trajectory; its time 0 is the first answered state."""
        return builders.reference(self.controller_values, self.robot.n)

    @cached_property
    def plant(self) -> Plant:
        """The simulated robot with its own parameters."""
        robot, integrator = builders.robot(self.plant_values), str(self.plant_values["integrator"])
        return Plant(robot, integrator, compile=bool(self.plant_values["compile"]))

    @cached_property
    def x0(self) -> Array:
        """The plant's initial state (4n,)."""
        return builders.initial_state(self.plant_values, self.plant.robot)

    def configurations(self, k: int = 64) -> Array:
        """Where the links will be (k + 1, n) [rad]: at the start, and at k points of the reference."""
        return np.vstack([self.x0[: self.robot.n], self.reference.configurations(k)])

    def warm_up(self) -> None:
        """Build law and plant step as the nodes will, so that what is compiled is in the cache when they start."""
        _ = self.law.measured_function
        if isinstance(self.sampled_law, RobustLaw):
            _ = self.sampled_law.ready_step
        if self.controller_values["certificate"] and isinstance(self.law, TrackingLaw):
            _ = Balance(self.law).function, Prediction(self.law).function
        self.plant.step(self.x0, [0.0] * self.robot.n, self.sample_period)

    def simulate(self, duration: float) -> Trajectory:
        """The sampled closed loop as the two nodes run it in lock-step, without ROS, for `duration` seconds.

        Of the plant alone: no imperfection (imperfections.*) is simulated, so no delay either.
        """
        inner = self.sample_period / int(self.plant_values["inner_steps"])  # type: ignore[arg-type]
        law = self.sampled_law if isinstance(self.sampled_law, RobustLaw) else self.law
        return simulate(self.plant, law, self.reference, self.x0, duration, self.sample_period, inner)


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario file; raises ParameterError, naming the file, for anything that does not fit."""
    path = Path(path)
    document = ros_yaml.read(path, "scenario")
    try:
        return _scenario(path.stem, document, path.parent)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from None


def parse_scenario(name: str, text: str) -> Scenario:
    """The same from a scenario's text; relative paths in it are relative to the current directory."""
    return _scenario(name, ros_yaml.parse(text), Path.cwd())


def _scenario(name: str, document: Any, folder: Path) -> Scenario:
    warnings: list[str] = []
    checked = {}
    for node, own in OWN_PARAMETERS.items():
        given = robot_file.merged(ros_yaml.values_for(node, document), node, folder)
        known = builders.all_parameters(own, given)
        checked[node] = parameter.complete(known, given)
        own_names = set(given) - _meant_for_others(node, own, document)
        warnings += [f"{node}: {sentence}" for sentence in parameter.unknown(known, own_names)]
    scenario = Scenario(name, checked[PLANT], checked[CONTROLLER])
    warnings += _about_hold(scenario)
    scenario = replace(scenario, warnings=tuple(warnings))
    joints = [checked[node]["joints"] for node in OWN_PARAMETERS]
    if joints[0] != joints[1]:
        raise ParameterError(
            f"parameter 'joints' is {joints[0]} for the plant and {joints[1]} for the controller; expected the same"
        )
    _ = scenario.sampled_law, scenario.reference, scenario.plant, scenario.x0  # what cannot be built is said here
    return scenario


def _meant_for_others(node: str, own: builders.OwnParameters, document: Any) -> set[str]:
    """Names that the document gives to all nodes, of which only others have them."""
    private = {section: content for section, content in document.items() if section != ros_yaml.SHARED}
    return set(builders.names_of_others(own)) - set(ros_yaml.values_for(node, private))


def _about_hold(scenario: Scenario) -> list[str]:
    """A sentence where the law would predict or integrate over another hold than there will be."""
    values, period = scenario.controller_values, scenario.sample_period
    robust = builders.robust(values, len(scenario.joints))
    if not (robust.predicts or robust.integrates) or math.isclose(float(values["robust.hold"]), period, rel_tol=1e-6):  # type: ignore[arg-type]
        return []
    return [f"{CONTROLLER}: parameter 'robust.hold' is {values['robust.hold']} s; the states' period is {period:g} s"]


def self_contained(given: Mapping[str, Mapping[str, object]], folder: Path) -> dict[str, Any]:
    """A parameter file with the values given to each node that needs no robot file and no URDF file.

    A value stands in the section /**, which `-p` on a command line reaches, unless the nodes differ in it. Relative
    paths in `given` are relative to `folder`. Raises ParameterError.
    """
    whole = {node: robot_file.inlined(robot_file.merged(values, node, folder)) for node, values in given.items()}
    shared: dict[str, object] = {}
    for values in whole.values():
        shared |= {name: value for name, value in values.items() if _is_common(name, value, whole)}
    sections = {ros_yaml.SHARED: shared}
    for node, values in whole.items():
        sections[f"/**/{node}"] = {name: value for name, value in values.items() if name not in shared}
    return {section: {"ros__parameters": ros_yaml.tree_of(values)} for section, values in sections.items() if values}


def _is_common(name: str, value: object, given: Mapping[str, Mapping[str, object]]) -> bool:
    """Whether every node that has the parameter is given this value."""
    return all(
        _same(value, values[name]) if name in values else name in builders.names_of_others(OWN_PARAMETERS[node])
        for node, values in given.items()
    )


def _same(first: object, second: object) -> bool:
    return repr(first) == repr(second)  # nan is as nan, 1 is not 1.0


def left_out(scenario: Scenario) -> list[str]:
    """Names of the parameters by which plant or measurement of the scenario do more than what is exported."""
    known = {
        "plant_values": imperfection_parameters(len(scenario.joints)),
        "controller_values": measurement_parameters(len(scenario.joints)),
    }
    pairs = [(getattr(scenario, values), parameter) for values, all_ in known.items() for parameter in all_]
    return [parameter.name for values, parameter in pairs if values[parameter.name] != parameter.default]
