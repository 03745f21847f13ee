# SPDX-License-Identifier: Apache-2.0
"""A film of a recorded run: frames, size and duration as asked for, the motion in it, and what is refused."""

from __future__ import annotations

import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from fjr_engines import film
from fjr_engines.film import HEIGHT, PERIOD, WIDTH, FilmError
from fjr_monitor.report.html import ArmReplay
from fjr_monitor.report.shown import Shown
from system.executables import fjr_here
from system.shared_runs import DURATION, shared_run

pytestmark = pytest.mark.system


@pytest.fixture(autouse=True)
def fresh() -> Iterator[None]:
    """What was found out about MuJoCo's renderer holds for the environment of one test only."""
    film.backend.cache_clear()
    yield
    film.backend.cache_clear()


def drawn_by(renderer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let MuJoCo or the browser draw; skip the test where the machine lacks it."""
    if renderer == "browser":
        monkeypatch.setenv("MUJOCO_GL", "disabled")
        if not any(map(shutil.which, film.BROWSERS)):
            pytest.skip("no Chromium here: install the package chromium")
    elif not film.backend():
        pytest.skip("MuJoCo draws nothing here: install the package libegl1 or libosmesa6")


def program(folder: Path, name: str, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Put a shell script of this name at the beginning of the path."""
    (folder / name).write_text(f"#!/bin/sh\n{text}\n")
    (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(folder), prepend=":")


@pytest.mark.parametrize(("renderer", "ending"), [("browser", "gif"), ("MuJoCo", "png")])
def test_a_film_shows_the_motion_in_its_time(
    tmp_path_factory: pytest.TempPathFactory,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    renderer: str,
    ending: str,
) -> None:
    """A fifth of the usual frames: the processor draws them."""
    drawn_by(renderer, monkeypatch)
    period = 5 * PERIOD
    monkeypatch.setattr(film, "PERIOD", period)
    run, file = shared_run(tmp_path_factory, "arm7"), tmp_path / f"arm7.{ending}"
    fjr_here("report", str(run), "--output", str(tmp_path / "report"), "--film", str(file))
    with Image.open(file) as moving:
        frames = [np.asarray(frame.convert("RGB"), dtype=float) for frame in ImageSequence.Iterator(moving)]
        durations = {frame.info["duration"] for frame in ImageSequence.Iterator(moving)}
    assert len(frames) == round(DURATION["arm7"] / period)
    assert {frame.shape for frame in frames} == {(HEIGHT, WIDTH, 3)}
    assert durations == {1e3 * period}
    assert file.stat().st_size * period / PERIOD < 500e3
    settled, half, again = (frames[round(t / period)] for t in (0.96, 1.96, 2.96))  # the reference repeats after 2 s
    assert np.abs(settled - half).mean() > 10 * np.abs(settled - again).mean()


def test_a_film_of_one_state_is_one_picture(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn_by("MuJoCo", monkeypatch)
    whole = film.arm_replay

    def first(data: Shown) -> ArmReplay | None:
        arm = whole(data)
        return arm and replace(arm, t=arm.t[:1], link=arm.link[:1], motor=arm.motor[:1])

    monkeypatch.setattr(film, "arm_replay", first)
    run, file = shared_run(tmp_path_factory, "paper_k31"), tmp_path / "joint.gif"
    fjr_here("report", str(run), "--output", str(tmp_path / "report"), "--film", str(file))
    with Image.open(file) as picture:
        assert getattr(picture, "n_frames", 1) == 1


def test_the_frames_of_mp4_go_to_ffmpeg_whose_failure_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = f'echo "$@" > {tmp_path}/asked; cat > {tmp_path}/pixels'
    program(tmp_path, "ffmpeg", text, monkeypatch)
    frames = np.zeros((2, HEIGHT, WIDTH, 3), np.uint8)
    frames[..., 0] = np.reshape([10, 20], (2, 1, 1))
    film.save(frames, tmp_path / "arm.mp4")
    asked = (tmp_path / "asked").read_text()
    assert f"-video_size {WIDTH}x{HEIGHT} -framerate {1 / PERIOD:g} -i -" in asked
    assert asked.split()[-1] == str(tmp_path / "arm.mp4")
    assert (tmp_path / "pixels").read_bytes() == frames.tobytes()
    program(tmp_path, "ffmpeg", f"{text}; exit 1", monkeypatch)
    with pytest.raises(FilmError, match="ffmpeg did not write"):
        film.save(frames, tmp_path / "arm.mp4")


@pytest.mark.parametrize(
    ("name", "code", "sentence"),
    [
        ("arm.avi", 2, "is no film; expected a name that ends with one of .gif, .png, .apng, .mp4"),
        ("arm.mp4", 1, "needs ffmpeg; expected it from: apt-get install ffmpeg"),
        ("arm.gif", 1, "needs a browser .*, or MuJoCo with EGL or OSMesa; expected one, e.g. from: apt-get install"),
    ],
)
def test_what_is_missing_is_named_before_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, code: int, sentence: str
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("MUJOCO_GL", "disabled")
    said = fjr_here("run", "paper_k31", "--output", str(tmp_path), "--film", name, code=code)
    assert re.match(f"fjr: {name} {sentence}", said)
    assert len(said.splitlines()) == 1


def test_a_browser_that_draws_nothing_is_named(
    tmp_path_factory: pytest.TempPathFactory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = shared_run(tmp_path_factory, "arm7")
    program(tmp_path, "chromium", "exit 0", monkeypatch)
    monkeypatch.setenv("MUJOCO_GL", "disabled")
    said = fjr_here("report", str(run), "--output", str(tmp_path), "--film", str(tmp_path / "a.gif"), code=1)
    assert "chromium drew 0 of 40 frames; expected a browser with WebGL" in said


def test_a_film_shows_one_bag(tmp_path: Path) -> None:
    said = fjr_here("report", str(tmp_path), str(tmp_path), "--film", "arm.gif", code=2)
    assert "--film shows one bag; 2 are given; expected one" in said
