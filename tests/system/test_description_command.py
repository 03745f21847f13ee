# SPDX-License-Identifier: Apache-2.0
"""`fjr description`: a robot as a URDF on standard output."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from fjr_core.config.scenario import load_scenario
from system.executables import fjr_here, scenario

pytestmark = pytest.mark.system


@pytest.mark.parametrize("name", ["paper_k31", "two_link", "arm7"])
def test_urdf_has_the_joints_of_the_scenario(name: str) -> None:
    robot = ElementTree.fromstring(fjr_here("description", name))
    assert set(load_scenario(scenario(name)).joints) <= {joint.get("name") for joint in robot.iter("joint")}


def test_urdf_includes_parameters_of_the_command_line() -> None:
    light, heavy = (fjr_here("description", "two_link", "--set", f"robot.link_mass:=[{m}, 0.8]") for m in (1.2, 2.5))
    assert '<mass value="1.2"' in light
    assert '<mass value="2.5"' in heavy
