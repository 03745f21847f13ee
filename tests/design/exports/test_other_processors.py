# SPDX-License-Identifier: Apache-2.0
"""Exported C on other processors (Debian's cross compilers, qemu-user): equal bit by bit, or up to the C library.

Sine, cosine and exponential of glibc round alike where the processor has fused multiply-adds; without, and in another C
library, they differ in the last bit.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from design.exports.c_program import built, changed, exported
from time_limits import HANG

WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wdouble-promotion", "-Wshadow", "-Werror")
EQUAL = {
    "aarch64-linux-gnu": ((), "qemu-aarch64"),
    "riscv64-linux-gnu": ((), "qemu-riscv64"),
    "s390x-linux-gnu": ((), "qemu-s390x"),  # big-endian
}
"""Options and emulator of processors with fused multiply-adds."""
ROUNDED = {
    "arm-linux-gnueabihf": (("-mfpu=neon",), "qemu-arm"),
    "i686-linux-gnu": (("-msse2", "-mfpmath=sse"), "qemu-i386"),
}
ROUNDING = "-DEFFORT_TOLERANCE=1e-9"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an export with observer, residual, prediction over the delay, gears and limits that act."""
    values = {
        "measurement.velocity": "observer",
        "measurement.gear_ratio": [100.0, -50.0],
        "robust.residual_gain": [20.0, 20.0],
        "robust.delay": 0.001,
        "limits.effort": [6.0, 2.0],
        "on_stop": "gravity_hold",
    }
    return exported(changed("two_link", values), tmp_path_factory.mktemp("export"))


def replayed_on(target: str, options: tuple[str, ...], emulator: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Compile for a processor with warnings as errors, and replay under an emulator."""
    compiler = f"{target}-gcc"
    for program in (compiler, emulator):
        if not shutil.which(program):
            pytest.skip(f"{program} is not installed (apt-get install gcc-{target} qemu-user)")
    command = (compiler, "-std=c99", "-O2", *WARNINGS, "-ffp-contract=off", *options)
    program = built(command, sorted(folder.glob("*.c")), folder / f"replay-{target}")
    words = [emulator, "-L", f"/usr/{target}", str(program), str(folder / "case.txt")]
    return subprocess.run(words, capture_output=True, text=True, timeout=HANG)


@pytest.mark.parametrize("target", EQUAL)
def test_efforts_are_equal_bit_by_bit_on_a_processor_with_fused_multiply_adds(target: str, folder: Path) -> None:
    done = replayed_on(target, *EQUAL[target], folder)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("target", ROUNDED)
def test_efforts_are_equal_up_to_rounding_of_sine_and_cosine_elsewhere(target: str, folder: Path) -> None:
    options, emulator = ROUNDED[target]
    done = replayed_on(target, (*options, ROUNDING), emulator, folder)
    assert done.returncode == 0, done.stdout
