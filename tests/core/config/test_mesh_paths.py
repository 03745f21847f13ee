# SPDX-License-Identifier: Apache-2.0
"""A URDF text that leaves its folder still finds the meshes that were at hand there."""

from __future__ import annotations

from pathlib import Path

import pytest

from fjr_core.config import robot_file
from fjr_core.config.mesh_paths import located


def urdf(name: str) -> str:
    mesh = f'<mesh filename="{name}" scale="1 1 1"/>'
    return f'<robot><link name="a"><visual><geometry>\n{mesh}\n</geometry></visual></link></robot>'


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package `arm_description` with urdf/ and meshes/link.stl."""
    folder = tmp_path / "arm_description"
    (folder / "meshes").mkdir(parents=True)
    (folder / "urdf").mkdir()
    (folder / "meshes" / "link.stl").touch()
    return folder


@pytest.mark.parametrize(
    "name",
    [
        "package://arm_description/meshes/link.stl",
        "../meshes/link.stl",
    ],
)
def test_a_mesh_next_to_the_urdf_gets_its_path(package: Path, name: str) -> None:
    text = located(urdf(name), package / "urdf")
    path = Path(text.split("file://")[1].split('"')[0])
    assert path.is_absolute()
    assert path.samefile(package / "meshes" / "link.stl")
    assert text.replace(f"file://{path}", name) == urdf(name)


@pytest.mark.parametrize("name", ["package://other/meshes/link.stl", "none.stl", "file:///none.stl", "/none.stl", ""])
def test_a_mesh_that_is_elsewhere_stays_as_it_is(package: Path, name: str) -> None:
    assert located(urdf(name), package / "urdf") == urdf(name)


def test_the_text_of_a_scenario_has_the_paths(package: Path) -> None:
    (package / "urdf" / "arm.urdf").write_text(urdf("../meshes/link.stl"))
    text = str(robot_file.inlined({"robot.urdf": str(package / "urdf" / "arm.urdf")})["robot.urdf"])
    assert "file:///" in text
    assert robot_file.inlined({"robot.urdf": text})["robot.urdf"] == text
