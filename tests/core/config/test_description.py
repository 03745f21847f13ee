# SPDX-License-Identifier: Apache-2.0
"""Robot descriptions: a generated URDF has the inertia and gravity of the closed form."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.config import builders, parameter
from fjr_core.config.description import description
from fjr_core.config.robot_file import inlined
from fjr_core.config.scenario import load_scenario
from fjr_core.errors import ParameterError

SCENARIOS = Path(__file__).parents[3] / "ros2_ws" / "src" / "fjr_bringup" / "scenarios"


def values_of(**given: object) -> dict[str, parameter.Value]:
    named = {key.replace("__", "."): value for key, value in given.items()}
    return dict(parameter.complete(builders.all_parameters(builders.plant_parameters, named), named))


ROBOTS = {
    "Table 1": {"robot__model": "single_link"},
    "no gravity": {"robot__model": "single_link", "robot__gravity_torque": [0.0]},
    "upside down": {"robot__model": "single_link", "robot__gravity_torque": [-0.5], "joints": ["a&b"]},
    "heavy": {"robot__model": "single_link", "robot__gravity_torque": [9.0], "robot__link_inertia": [2.0]},
    "two links": {"robot__model": "planar_two_link", "joints": ["shoulder", "elbow"]},
}


@pytest.mark.parametrize("given", ROBOTS.values(), ids=ROBOTS)
def test_generated_description_has_the_same_inertia_and_gravity(given: dict[str, object]) -> None:
    values = values_of(**given)
    closed = builders.robot(values)
    read = fjr.robot_from_urdf(description(values), list(values["joints"]), closed.K, closed.M_m)
    rng = np.random.default_rng(0)
    for q_l, dq_l in rng.uniform(-3, 3, (5, 2, closed.n)):
        np.testing.assert_allclose(read.M_l(q_l), closed.M_l(q_l), rtol=1e-12)
        np.testing.assert_allclose(read.grad_P_l(q_l), closed.grad_P_l(q_l), rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(read.coriolis(q_l, dq_l, dq_l), closed.coriolis(q_l, dq_l, dq_l), atol=1e-12)


@pytest.mark.parametrize("name", ["paper_k31", "two_link", "arm7"])
def test_every_link_has_a_visual_and_every_joint_is_present(name: str) -> None:
    scenario = load_scenario(SCENARIOS / f"{name}.yaml")
    robot = ElementTree.fromstring(description(scenario.plant_values))
    assert set(scenario.joints) <= {joint.get("name") for joint in robot.iter("joint")}
    turning = {joint.find("child").get("link") for joint in robot.iter("joint") if joint.get("name") in scenario.joints}
    assert turning <= {link.get("name") for link in robot.iter("link") if link.find("visual") is not None}


def test_arm_from_a_urdf_keeps_that_urdf() -> None:
    values = load_scenario(SCENARIOS / "arm7.yaml").plant_values
    assert description(values) == Path(values["robot.urdf"]).read_text(encoding="utf-8")
    assert description(inlined(values)) == description(values)


def test_missing_file_is_reported_in_one_sentence() -> None:
    with pytest.raises(ParameterError, match="cannot read nowhere.urdf"):
        description({"robot.model": "urdf", "robot.urdf": "nowhere.urdf", "joints": ("a",)})
