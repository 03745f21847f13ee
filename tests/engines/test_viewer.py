# SPDX-License-Identifier: Apache-2.0
"""MuJoCo's viewer: where it is refused, how a link shows its spring, and a window beside a run."""

from __future__ import annotations

import shutil
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from fjr_core.config.scenario import load_scenario
from fjr_engines.drawing import ORANGE, DrawnArm
from fjr_msgs_py.console.ending import Exit
from system.executables import Executable, fjr_here, installed, scenario, wait_for

SHADES = 100  # an empty screen has one or two


@pytest.fixture
def screen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The memory of a screen without a monitor, on which windows open."""
    if shutil.which("Xvfb") is None:
        pytest.skip("no Xvfb here: install the package xvfb")
    command = ["Xvfb", "-displayfd", "1", "-screen", "0", "640x480x24", "-fbdir", str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as server:
        assert server.stdout is not None
        monkeypatch.setenv("DISPLAY", f":{server.stdout.readline().strip()}")
        yield tmp_path / "Xvfb_screen0"
        server.terminate()


def test_without_a_display_the_viewer_is_refused_before_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    said = fjr_here("run", "paper_k31", "--viewer", code=1)
    assert said.splitlines() == [
        "fjr: --viewer needs a display, and DISPLAY is not set; expected a desktop, or --film FILE"
    ]


def test_a_link_turns_orange_as_its_spring_deflects() -> None:
    given = load_scenario(scenario("two_link"))
    arm = DrawnArm(given)
    shapes = [arm.model.geom_bodyid == arm.model.joint(joint).bodyid[0] for joint in given.joints]
    own = arm.model.geom_rgba.copy()
    q_l = np.array([0.3, -0.2])
    for deflection, share in (([0.02, 0.0], [1.0, 0.0]), ([-0.01, 0.0], [0.5, 0.0]), ([0.0, np.nan], [0.0, 0.0])):
        arm.pose(q_l, q_l + deflection)
        for which, expected in zip(shapes, share, strict=True):
            np.testing.assert_allclose(
                arm.model.geom_rgba[which], own[which] + expected * (ORANGE - own[which]), rtol=1e-6
            )
    assert [arm.data.joint(joint).qpos[0] for joint in given.joints] == q_l.tolist()


def test_the_obstacle_stands_beside_the_arm() -> None:
    given = load_scenario(scenario("arm7_contact"))
    wall = DrawnArm(given).model.geom("obstacle_wall")
    face = wall.pos + wall.size[2] * np.array([0.0, 1.0, 0.0])  # its normal
    np.testing.assert_allclose(face, given.plant_values["obstacle.position"], atol=1e-12)


@pytest.mark.system
def test_the_viewer_shows_the_arm_beside_a_run(screen: Path, tmp_path: Path) -> None:
    asked = ("run", "paper_k31", "--viewer", "--duration", "600", "--output", str(tmp_path / "runs"))
    run = Executable(installed("fjr", *asked))
    try:
        wait_for(lambda: len(set(screen.read_bytes()[4096:])) > SHADES, "a picture of the arm")
        run.signal(signal.SIGINT)
        assert run.end()[0] == Exit.INTERRUPTED
    finally:
        run.kill()
