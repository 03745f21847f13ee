# SPDX-License-Identifier: Apache-2.0
"""Film the recorded motion of an arm: GIF, animated PNG or MP4, from frames that a headless browser draws."""

from __future__ import annotations

import io
import os
import re
import shutil
import subprocess
from base64 import b64decode
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from fjr_core.errors import FjrError, ParameterError
from fjr_monitor.report.html import ArmReplay, write_page
from fjr_msgs_py.console.output import note, phase

if TYPE_CHECKING:
    from PIL.Image import Image

PERIOD = 0.08  # s between two frames, of the run and of the film
LONGEST = 20.0  # s; a longer run is filmed from its start
WIDTH, HEIGHT = 480, 360  # pixels of a frame
COLOURS = 64  # of GIF and PNG
ENDINGS = (".gif", ".png", ".apng", ".mp4")
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless=new",
    "--disable-gpu",
    "--enable-unsafe-swiftshader",  # WebGL by the processor
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-dev-shm-usage",
)
PATIENCE = 600.0  # s


class FilmError(FjrError):
    """A film cannot be made here: a program or a package is missing or fails."""


def check(file: Path) -> None:
    """Raise ParameterError unless the name is that of a film, FilmError unless it can be made here."""
    if file.suffix.lower() not in ENDINGS:
        raise ParameterError(f"{file} is no film; expected a name that ends with one of {', '.join(ENDINGS)}")
    if find_spec("PIL") is None:
        raise FilmError(f"{file} needs the Python package Pillow; expected it from: pip install pillow")
    if file.suffix.lower() == ".mp4" and shutil.which("ffmpeg") is None:
        raise FilmError(f"{file} needs ffmpeg; expected it from: apt-get install ffmpeg, or a name that ends with .gif")
    if not any(map(shutil.which, BROWSERS)):
        raise FilmError(
            f"{file} needs a browser, {', '.join(BROWSERS)} on the PATH; expected one from: apt-get install chromium"
        )


def film(arm: ArmReplay | None, file: Path) -> None:
    """Write the film of a run, as fast as the run, from its start and for at most LONGEST; raise FilmError."""
    check(file)
    if arm is None:
        raise FilmError("the bag has no positions of links; expected them in /joint_states")
    times = np.arange(arm.t[0], min(arm.t[-1], arm.t[0] + LONGEST), PERIOD)
    with phase(f"{file}: drawing {len(times)} frames"):
        save(frames_of_page(arm, times.tolist()), file)
    note(f"{file}: {len(times)} frames, {PERIOD * len(times):.2f} s, {file.stat().st_size // 1000} kB")


def frames_of_page(arm: ArmReplay, times: Sequence[float]) -> list[Image]:
    """Return the arm of the page of a run at these times [s]; raise FilmError if the browser does not draw it."""
    from PIL import Image

    browser = next(filter(None, map(shutil.which, BROWSERS)))
    with TemporaryDirectory(prefix="fjr-film-", ignore_cleanup_errors=True) as folder:
        page = Path(folder, "film.html")
        write_page(page, "film.html", "film", [], arm, times=times, width=WIDTH, height=HEIGHT)
        sandbox = ("--no-sandbox",) if os.geteuid() == 0 else ()
        command = [browser, *FLAGS, *sandbox, f"--user-data-dir={folder}/profile", "--dump-dom", page.as_uri()]
        try:
            said = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
        except subprocess.TimeoutExpired:
            raise FilmError(f"{browser} drew no picture in {PATIENCE:g} s; expected a browser with WebGL") from None
    pictures = re.findall(r"data:image/png;base64,([\w+/=]+)", said.stdout)
    if len(pictures) != len(times):
        raise FilmError(f"{browser} drew {len(pictures)} of {len(times)} frames; expected a browser with WebGL")
    white = Image.new("RGBA", (WIDTH, HEIGHT), "white")
    drawn = (Image.open(io.BytesIO(b64decode(text))).convert("RGBA") for text in pictures)
    return [Image.alpha_composite(white, each).convert("RGB") for each in drawn]


def save(frames: Sequence[Image], file: Path) -> None:
    """Write frames, PERIOD apart, as the ending of the file says; raise FilmError if ffmpeg fails."""
    if file.suffix.lower() == ".mp4":
        rate, size = f"{1.0 / PERIOD:g}", f"{WIDTH}x{HEIGHT}"
        source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-video_size", size, "-framerate", rate, "-i", "-"]
        command = ["ffmpeg", "-y", "-loglevel", "error", *source, "-pix_fmt", "yuv420p", str(file)]
        pixels = b"".join(frame.tobytes() for frame in frames)
        if subprocess.run(command, input=pixels, stdout=subprocess.DEVNULL, check=False).returncode:
            raise FilmError(f"ffmpeg did not write {file}; expected one that encodes MP4")
        return
    palette = frames[0].quantize(COLOURS)
    first, *others = (frame.quantize(palette=palette, dither=0) for frame in frames)
    kind = "GIF" if file.suffix.lower() == ".gif" else "PNG"
    first.save(file, kind, save_all=True, append_images=others, duration=round(1e3 * PERIOD), loop=0, optimize=True)
