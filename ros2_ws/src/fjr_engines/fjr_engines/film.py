# SPDX-License-Identifier: Apache-2.0
"""Film the recorded motion of an arm: GIF, animated PNG or MP4, from frames of MuJoCo or of a headless browser.

MuJoCo draws where EGL or OSMesa is there. Else the browser draws the arm of the page, with the motor sides beside it.
"""

from __future__ import annotations

import io
import os
import pickle
import re
import shutil
import subprocess
import sys
from base64 import b64decode
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numpy.typing import NDArray

from fjr_core.config.scenario import Scenario
from fjr_core.errors import PIP, FjrError, ParameterError, RobotError
from fjr_core.numerics.checks import Array
from fjr_monitor.report.html import ArmReplay, write_page
from fjr_monitor.report.shown import Shown, arm_replay
from fjr_msgs_py.console.output import note, phase

Frames = NDArray[np.uint8]
"""Red, green and blue (k, height, width, 3)."""
PERIOD = 0.08  # s between two frames, of the run and of the film
LONGEST = 20.0  # s; a longer run is filmed from its start
WIDTH, HEIGHT = 480, 360  # pixels of a frame
COLOURS, SPARSE = 64, 3  # of GIF and PNG; each third pixel along each side chooses them
ENDINGS = (".gif", ".png", ".apng", ".mp4")
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ["--headless=new", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
FLAGS += ["--disable-component-update", "--disable-dev-shm-usage", "--enable-unsafe-swiftshader"]  # WebGL without a GPU
BACKENDS = ("egl", "osmesa")  # of MuJoCo's renderer without a display


class FilmError(FjrError):
    """A film cannot be made here: a program or a package is missing or fails."""


def check(file: Path) -> None:
    """Raise ParameterError unless the name is that of a film, FilmError unless it can be made here."""
    if file.suffix.lower() not in ENDINGS:
        raise ParameterError(f"{file} is no film; expected a name that ends with one of {', '.join(ENDINGS)}")
    if find_spec("PIL") is None:
        raise FilmError(f"{file} needs the Python package Pillow; expected it from: {PIP} pillow")
    if file.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise FilmError(f"{file} needs ffmpeg; expected it from: apt-get install ffmpeg, or a name that ends with .gif")
    if not any(map(shutil.which, BROWSERS)) and not backend():
        raise FilmError(
            f"{file} needs a browser ({', '.join(BROWSERS)}), or MuJoCo with EGL or OSMesa; expected one, e.g. from: "
            "apt-get install chromium"
        )


@cache
def backend() -> str:
    """Return the first of BACKENDS, or that of the variable MUJOCO_GL, with which MuJoCo draws here; "" if none."""
    asked = os.environ.get("MUJOCO_GL")
    begin = [sys.executable, "-c", "import mujoco; mujoco.GLContext(8, 8).free()"]
    with TemporaryDirectory() as folder:  # where MuJoCo logs its errors
        for name in [asked] if asked else BACKENDS:
            env = os.environ | {"MUJOCO_GL": name}
            if not subprocess.run(begin, capture_output=True, env=env, cwd=folder, check=False).returncode:
                return name
    return ""


def film(data: Shown, file: Path) -> None:
    """Write the film of a run, as fast as the run, from its start and for at most LONGEST; raise FilmError."""
    check(file)
    arm = arm_replay(data)
    if arm is None:
        raise FilmError("the bag has no positions of links; expected them in /joint_states")
    times = arm.t[0] + PERIOD * np.arange(max(1.0, np.ceil(min(np.ptp(arm.t), LONGEST) / PERIOD)))
    with phase(f"{file}: drawing {len(times)} frames"), TemporaryDirectory(ignore_cleanup_errors=True) as name:
        frames = frames_of_mujoco(data.run.scenario, arm, times, Path(name))
        save(frames_of_page(arm, times, Path(name)) if frames is None else frames, file)
    note(f"{file}: {len(times)} frames, {PERIOD * len(times):.2f} s, {file.stat().st_size // 1000} kB")


def frames_of_mujoco(scenario: Scenario, arm: ArmReplay, times: Array, folder: Path) -> Frames | None:
    """Return the arm at these times (k,) [s] as MuJoCo's renderer draws it; None where it cannot."""
    if not backend():
        return None
    from fjr_engines.drawing import DrawnArm

    try:
        drawn_arm = DrawnArm(scenario)
    except (RobotError, ValueError):  # ValueError: MuJoCo's, for a mesh
        return None
    sides = np.hstack([arm.link, arm.motor])
    q_l, q_m = np.split(np.column_stack([np.interp(times, arm.t, column) for column in sides.T]), 2, axis=1)
    command, env = [sys.executable, "-m", "fjr_engines.drawing"], os.environ | {"MUJOCO_GL": backend()}
    given = pickle.dumps((drawn_arm, q_l, q_m, HEIGHT, WIDTH))
    done = subprocess.run(command, input=given, capture_output=True, env=env, cwd=folder, check=False)
    drawn = np.frombuffer(done.stdout, np.uint8)
    return drawn.reshape(-1, HEIGHT, WIDTH, 3) if drawn.size == len(times) * HEIGHT * WIDTH * 3 else None


def frames_of_page(arm: ArmReplay, times: Array, folder: Path) -> Frames:
    """Return the arm of the page of a run at these times (k,) [s]; raise FilmError if the browser does not draw it."""
    from PIL import Image

    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        raise FilmError("MuJoCo does not draw this robot; expected a browser from: apt-get install chromium")
    page = folder / "film.html"
    write_page(page, "film.html", "film", [], arm, times=times.tolist(), width=WIDTH, height=HEIGHT)
    sandbox = ("--no-sandbox",) if os.geteuid() == 0 else ()
    command = [browser, *FLAGS, *sandbox, f"--user-data-dir={folder}/profile", "--dump-dom", page.as_uri()]
    said = subprocess.run(command, capture_output=True, text=True, check=False).stdout
    pictures = re.findall(r"data:image/png;base64,([\w+/=]+)", said)
    if len(pictures) != len(times):
        raise FilmError(f"{browser} drew {len(pictures)} of {len(times)} frames; expected a browser with WebGL")
    white = Image.new("RGBA", (WIDTH, HEIGHT), "white")
    drawn = (Image.open(io.BytesIO(b64decode(text))).convert("RGBA") for text in pictures)
    return np.stack([np.asarray(Image.alpha_composite(white, each).convert("RGB")) for each in drawn])


def save(frames: Frames, file: Path) -> None:
    """Write frames, PERIOD apart, as the ending of the file says; raise FilmError if ffmpeg fails."""
    from PIL import Image

    if file.suffix.lower() == ".mp4":
        rate, size = f"{1.0 / PERIOD:g}", f"{WIDTH}x{HEIGHT}"
        source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-video_size", size, "-framerate", rate, "-i", "-"]
        command = ["ffmpeg", "-y", "-loglevel", "error", *source, "-pix_fmt", "yuv420p", str(file)]
        if subprocess.run(command, input=frames.tobytes(), stdout=subprocess.DEVNULL, check=False).returncode:
            raise FilmError(f"ffmpeg did not write {file}; expected one that encodes MP4")
        return
    sparse = Image.fromarray(np.concatenate(frames[:, ::SPARSE, ::SPARSE]))
    palette = sparse.quantize(COLOURS, Image.Quantize.FASTOCTREE)
    first, *others = (Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames)
    first.save(file, save_all=True, append_images=others, duration=round(1e3 * PERIOD), loop=0, optimize=True)
