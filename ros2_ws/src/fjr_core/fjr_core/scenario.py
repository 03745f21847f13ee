# SPDX-License-Identifier: Apache-2.0
"""A scenario: one ROS 2 parameter file for both nodes, read without ROS and made into the closed loop."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import yaml

from . import config, parameters
from .checks import Array
from .errors import ParameterError
from .gains import Gains
from .plant import Plant
from .reference import Sine
from .robot import Robot
from .simulate import Trajectory, simulate
from .vdpbc.law import TrackingLaw

PLANT, CONTROLLER = "fjr_plant", "fjr_controller"


@dataclass(frozen=True)
class Scenario:
    """Checked parameter values of both nodes, and the objects that they describe."""

    name: str
    plant_values: Mapping[str, parameters.Value]
    controller_values: Mapping[str, parameters.Value]
    warnings: tuple[str, ...] = ()

    @property
    def joints(self) -> tuple[str, ...]:
        """Joint names in the order of all lists."""
        return tuple(str(name) for name in self.controller_values["joints"])  # type: ignore[union-attr]

    @property
    def sample_period(self) -> float:
        """Period of the plant's states [s]."""
        return 1.0 / float(self.plant_values["publish_rate"])  # type: ignore[arg-type]

    @cached_property
    def robot(self) -> Robot:
        """The robot that the controller believes in."""
        return config.robot(self.controller_values)

    @cached_property
    def gains(self) -> Gains:
        """The controller's gains."""
        return config.gains(self.controller_values, self.robot.n)

    @cached_property
    def law(self) -> TrackingLaw:
        """The controller's law."""
        return TrackingLaw(self.robot, self.gains)

    @cached_property
    def reference(self) -> Sine:
        """The reference trajectory; its time 0 is the first answered state."""
        return config.reference(self.controller_values, self.robot.n)

    @cached_property
    def plant(self) -> Plant:
        """The simulated robot with its own parameters."""
        return Plant(config.robot(self.plant_values), str(self.plant_values["integrator"]))

    @cached_property
    def x0(self) -> Array:
        """The plant's initial state (4n,)."""
        return config.initial_state(self.plant_values, self.plant.robot)

    def simulate(self, duration: float) -> Trajectory:
        """The sampled closed loop as the two nodes run it in lock-step, without ROS, for `duration` seconds."""
        inner = self.sample_period / int(self.plant_values["inner_steps"])  # type: ignore[arg-type]
        return simulate(self.plant, self.law, self.reference, self.x0, duration, self.sample_period, inner)


def load_scenario(path: str | Path) -> Scenario:
    """Read a scenario file; raises ParameterError, naming the file, for anything that does not fit."""
    path = Path(path)
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ParameterError(f"cannot read scenario {path}: {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ParameterError(f"{path} is not valid YAML: {' '.join(str(error).split())}") from None
    try:
        return _scenario(path.stem, document)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from None


def _scenario(name: str, document: Any) -> Scenario:
    warnings: list[str] = []
    checked = {}
    for node, own in ((PLANT, config.plant_parameters), (CONTROLLER, config.controller_parameters)):
        given = _given(document, node)
        known = config.all_parameters(own, config.model_of(given))
        checked[node] = parameters.complete(known, given)
        warnings += [f"{node}: {sentence}" for sentence in parameters.unknown(known, given)]
    scenario = Scenario(name, checked[PLANT], checked[CONTROLLER], tuple(warnings))
    _ = scenario.law, scenario.reference, scenario.plant, scenario.x0  # what cannot be built is said here
    return scenario


def _given(document: Any, node: str) -> dict[str, object]:
    """The values a parameter file gives to a node, later sections over earlier ones, names joined by dots."""
    if not isinstance(document, dict):
        raise ParameterError(f"holds a {type(document).__name__}; expected a ROS 2 parameter file (a mapping)")
    given: dict[str, object] = {}
    for section, content in document.items():
        if section not in ("/**", node, f"/{node}", f"/**/{node}"):
            continue
        if not isinstance(content, dict) or not isinstance(content.get("ros__parameters"), dict):
            raise ParameterError(f"section '{section}' has no 'ros__parameters' mapping")
        given.update(_flat(content["ros__parameters"]))
    return given


def _flat(tree: Mapping[Any, Any], prefix: str = "") -> dict[str, object]:
    flat: dict[str, object] = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            flat.update(_flat(value, f"{prefix}{key}."))
        else:
            flat[f"{prefix}{key}"] = value
    return flat
