# SPDX-License-Identifier: Apache-2.0
"""The steps of MuJoCo in C, against the library and the headers of its wheel."""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from pathlib import Path

import mujoco

from fjr_core.numerics.jit import CLibrary, c_library


@cache
def mujoco_program() -> CLibrary:
    """Return the library of mujoco_steps.c, compiled and cached; raise CompilerError without a C compiler."""
    wheel, text = Path(mujoco.__file__).parent, {"encoding": "utf-8"}
    robot = (files("fjr_plant") / "native" / "robot.h").read_text(**text)
    header, source = ((files(__name__) / f"mujoco_steps.{kind}").read_text(**text) for kind in "hc")
    options = [f"-I{wheel / 'include'}", f"-L{wheel}", f"-l:libmujoco.so.{mujoco.__version__}", f"-Wl,-rpath,{wheel}"]
    return c_library("fjr_mujoco", f"{robot}\n{header}", source, options=options)
