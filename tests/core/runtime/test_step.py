# SPDX-License-Identifier: Apache-2.0
"""The C text of the control step: clean, free of state and allocation, the same bits from every compiler."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.cases import LOOPS
from design.exports.c_program import C99, built, program_output
from fjr_core.motions.point_to_point import Hold
from fjr_core.numerics.jit import OPTIONS, SAME_BITS
from fjr_core.robust.law import Robust
from fjr_core.runtime import velocity_observer
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.library import HEADER, c_text, constant, text
from fjr_core.runtime.safety_settings import Settings

COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-O2", "-c")
CONTROLLERS = "40"  # called at random
NATIVE = [option for option in OPTIONS if option not in ("-fPIC", "-shared")]
BUILDS = {
    "-O0": ["-O0", *SAME_BITS],
    "-O2": ["-O2", *SAME_BITS],
    "that of the nodes": NATIVE,
    "sanitizers": [
        "-O1",
        *SAME_BITS,
        "-fsanitize=address,undefined,float-cast-overflow",
        "-fno-sanitize-recover=all",
    ],
}
CALLED = {
    *("exp", "log", "sin", "cos", "sincos", "sqrt", "fmod", "ceil", "rint", "nextafter", "fmax", "fmin"),
    *("memcpy", "memset"),
}
ENTRIES = set(re.findall(r"^\w[\w ]*?\b(fjr_\w+)\(", text(HEADER), re.MULTILINE))
TWO, TWO_GAINS = LOOPS[-1]
TWO_SINES = fjr.Sine([0.1, 0.2], [2.0, 3.0])
MS = 1_000_000  # ns

needs_nm = pytest.mark.skipif(shutil.which("nm") is None, reason="no nm (binutils)")


def compiled(command: Sequence[str], source: str, folder: Path) -> Path:
    """Compile a C source without a warning; return the path of the result."""
    folder.mkdir(exist_ok=True)
    (folder / "code.c").write_text(source)
    return built(command, [folder / "code.c"], folder / "built")


@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize(("n", "memory"), [(1, 0), (7, 40)])
def test_the_text_compiles_without_a_warning(n: int, memory: int, compiler: str, tmp_path: Path) -> None:
    compiled([compiler, *STRICT], c_text(n, memory), tmp_path)


@pytest.mark.parametrize("n", [3, *(pytest.param(n, marks=pytest.mark.full) for n in (1, 7))])
def test_random_calls_send_finite_efforts_within_limit_and_rate_of_the_same_bits_in_every_build(
    n: int, tmp_path: Path
) -> None:
    """No sanitizer finds a fault, whatever the samples are and in whichever order the functions are called."""
    source = c_text(n, 3) + Path(__file__).with_name("random_calls.c").read_text()
    digests = [
        program_output(compiled(["cc", "-std=c99", *options], source, tmp_path / name), CONTROLLERS)
        for name, options in BUILDS.items()
    ]
    assert set(digests) == {digests[0]}


@needs_nm
def test_the_object_has_no_state_no_allocation_and_no_symbols_but_those_of_the_header(tmp_path: Path) -> None:
    object_file = compiled([*C99, "-c"], c_text(7, 5), tmp_path)
    symbols = [line.split()[-2:] for line in subprocess.check_output(["nm", object_file], text=True).splitlines()]
    assert {name for kind, name in symbols if kind.isupper() and kind != "U"} == ENTRIES
    assert not [name for kind, name in symbols if kind in "bBdDcCsSgG"], "expected no writable static data"
    assert {name for kind, name in symbols if kind == "U"} - {"_GLOBAL_OFFSET_TABLE_", "__stack_chk_fail"} <= CALLED


def random_sample(step: ControlStep, rng: np.random.Generator, stamp: int) -> Any:
    n = step.law.robot.n
    found = step.ffi.new("struct fjr_sample *")
    found.stamp, found.link, found.motor = stamp, *rng.uniform(-0.3, 0.3, (2, n)).tolist()
    found.velocity = rng.uniform(-0.3, 0.3, 2 * n).tolist()
    return found


def test_a_copied_controller_continues_with_the_same_bits() -> None:
    """All state is in the structure: two copies go on independently, in the middle of transitions as well."""
    settings = Settings(("joint1", "joint2"), start_join_time=0.02, recovery_join_time=0.03, state_timeout=0.05)
    law, observer = fjr.TrackingLaw(TWO.robot, TWO_GAINS.gains), fjr.VelocityObserver(TWO.robot, 150.0)
    step = ControlStep(law, TWO_SINES, settings, observer, robust=Robust(integral_gain=4.0, delay=1e-3))
    ffi, lib, rng = step.ffi, step.lib, np.random.default_rng(0)
    copied, commands = ffi.new("struct fjr_controller *"), [ffi.new("struct fjr_command *") for _ in range(2)]
    for k in range(0, 200, 2):
        if k == 60:
            step.follow(Hold([0.1, 0.2]))
        if k == 120:
            lib.fjr_hold(step.controller)
        copied[0] = step.controller[0]
        for stamp in (k * MS, (k + 1) * MS if k % 50 else (k + 200) * MS):
            sample = random_sample(step, rng, stamp)
            answers = [
                lib.fjr_step(step.model, controller, sample, stamp, command)
                for controller, command in zip((step.controller, copied), commands, strict=True)
            ]
            assert answers[0] == answers[1]
            assert bytes(ffi.buffer(commands[0])) == bytes(ffi.buffer(commands[1]))
        assert bytes(ffi.buffer(step.controller)) == bytes(ffi.buffer(copied))


@pytest.mark.parametrize("dt", [MS // 3, 10 * MS, 89 * MS, 101 * MS])  # 89: the longest gap
def test_the_observer_of_the_step_is_the_velocity_observer(dt: int) -> None:
    """The class estimates where there is no controller, e.g. from bags; both give the same bits."""
    law, observer = fjr.TrackingLaw(TWO.robot, TWO_GAINS.gains), fjr.VelocityObserver(TWO.robot, 150.0)
    step = ControlStep(law, TWO_SINES, Settings(("joint1", "joint2"), state_timeout=9.0), observer, simulated=True)
    rng = np.random.default_rng(2)
    for k in range(20):
        stamp, before = (k * MS if k < 10 else 10 * MS + dt + k * MS), np.array(list(step.controller.limits.left))
        q_l, q_m = rng.uniform(-0.3, 0.3, (2, 2))
        observer.update(stamp, q_l, q_m, before)
        assert step.step(stamp, k * MS, q_l, q_m, None, None)
        np.testing.assert_array_equal(step.measured[:8], observer.state)


@pytest.mark.parametrize("name", ["LONGEST_CALL", "LONGEST_GAP"])
def test_the_constants_of_the_observer_are_those_of_the_class(name: str) -> None:
    assert constant(name) == getattr(velocity_observer, name)
