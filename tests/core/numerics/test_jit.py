# SPDX-License-Identifier: Apache-2.0
"""Compiled code gives CasADi's numbers, is cached by content or inputs, and is safe for concurrent processes."""

from __future__ import annotations

import logging
import os
import shutil
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import fjr_core as fjr
from core.numerics.processes import COMPILED, CUBES, output, started
from fjr_core.errors import CompilerError
from fjr_core.monitoring.certificate import Certificate, CertificateSeries
from fjr_core.numerics import jit as compiling
from fjr_core.numerics.jit import machine_code
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.library import step_library
from fjr_core.runtime.safety_settings import Settings

pytestmark = pytest.mark.usefixtures("cache")
with_a_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc) on this machine")


@pytest.fixture
def function() -> ca.Function:
    x = ca.SX.sym("x", 3)
    return ca.Function("cubes", [x], [x**3 + ca.sin(x)])


def logging_compiler(folder: Path) -> Path:
    """Install a C compiler that logs a line for every library it builds."""
    script = folder / "logging-cc"
    script.write_text(
        f'#!/bin/sh\ncase "$*" in *--version*) ;; *) echo built >> "{folder}/builds" ;; esac\nexec cc "$@"\n'
    )
    script.chmod(0o755)
    return script


@with_a_compiler
def test_compiled_code_is_loaded_from_the_cache_folder(cache: Path) -> None:
    law = fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS, compile=True)
    assert not cache.exists()  # compilation waits for the first use
    assert law.command_function.class_name() == "External"
    assert [path.name.partition("-")[0] for path in cache.glob("*.so")] == ["command"]


@with_a_compiler
def test_each_function_is_built_once(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, function: ca.Function
) -> None:
    monkeypatch.setenv("CC", str(logging_compiler(tmp_path)))
    for _ in range(3):
        assert compiling.compiled(function)([1, 2, 3]).full().ravel() == pytest.approx(
            np.arange(1, 4) ** 3 + np.sin([1, 2, 3])
        )
    x = ca.SX.sym("x", 3)
    changed = compiling.compiled(ca.Function("cubes", [x], [x**3 + ca.cos(x)]))
    assert changed([1, 2, 3]).full().ravel() == pytest.approx(np.arange(1, 4) ** 3 + np.cos([1, 2, 3]))
    assert (tmp_path / "builds").read_text().split() == ["built", "built"]


@with_a_compiler
def test_concurrent_processes_build_once(tmp_path: Path) -> None:
    processes = [started(CUBES, CC=str(logging_compiler(tmp_path))) for _ in range(4)]
    assert [output(process).strip() for process in processes] == [COMPILED] * 4
    assert (tmp_path / "builds").read_text().split() == ["built"]


def single_warning(caplog: pytest.LogCaptureFixture, function: ca.Function) -> str:
    """Compile twice and return the only warning; check that the function is still usable."""
    with caplog.at_level(logging.WARNING, "fjr_core.numerics.jit"):
        for _ in range(2):
            assert compiling.compiled(function) is function
    assert len(caplog.messages) == 1
    return caplog.messages[0]


def test_without_a_compiler_the_virtual_machine_runs_with_one_warning(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, function: ca.Function
) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.setitem(sys.modules, "ziglang", None)
    sentence = single_warning(caplog, function)
    assert "no C compiler (cc, gcc, clang) is on the path; expected one: apt-get install gcc" in sentence
    assert "or pip install ziglang" in sentence
    law = fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS, compile=True)
    assert np.isfinite(law.command(np.zeros(4), np.zeros((5, 1)))).all()


def test_the_control_step_needs_a_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-cc")
    law, settings = fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS), Settings(("joint1",))
    step_library.cache_clear()
    for needing in (compiling.c_compiler, lambda: ControlStep(law, fjr.Hold([0.0]), settings)):
        with pytest.raises(CompilerError, match=r"no C compiler \(no-such-cc\) is on the path; expected one"):
            needing()


@with_a_compiler
def test_the_compiler_of_the_wheel_ziglang_is_used_where_no_other_is(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, function: ca.Function
) -> None:
    """The wheel is 100 MB: a package of its name calls cc instead and keeps the folder given to zig."""
    package, cc = tmp_path / "ziglang", shutil.which("cc")
    package.mkdir()
    (package / "__init__.py").touch()
    script = ("#!/bin/sh", f"PATH={os.environ['PATH']}", f'echo "$1 $ZIG_GLOBAL_CACHE_DIR" > {package}/called', "shift")
    (package / "zig").write_text("\n".join([*script, f'exec {cc} "$@"\n']))
    (package / "zig").chmod(0o755)
    monkeypatch.setenv("PATH", "")
    monkeypatch.syspath_prepend(tmp_path)
    assert compiling.compiled(function).class_name() == "External"
    assert (package / "called").read_text() == f"cc {cache / 'zig'}\n"


@pytest.mark.skipif(find_spec("ziglang") is None, reason="the wheel ziglang is not installed")
def test_the_real_ziglang_gives_the_same_bits(monkeypatch: pytest.MonkeyPatch, function: ca.Function) -> None:
    points, wanted = np.linspace(-2, 2, 300).reshape(3, 100), compiling.compiled(function)
    monkeypatch.setenv("PATH", "")
    found = compiling.compiled(function)
    assert machine_code(found) != machine_code(wanted)
    np.testing.assert_array_equal(found.map(100)(points).full(), wanted.map(100)(points).full())


@pytest.mark.parametrize(
    ("compiler", "words"),
    [
        ("false", "false failed"),
        ("true", "true wrote no shared object"),
        ("no-such-cc", "no C compiler (no-such-cc)"),
        ('gcc "', "No closing"),
    ],
)
def test_a_failing_compiler_is_logged_once(
    compiler: str, words: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, function: ca.Function
) -> None:
    monkeypatch.setenv("CC", compiler)
    assert words in single_warning(caplog, function)


@with_a_compiler
def test_functions_without_c_code_run_in_the_virtual_machine(caplog: pytest.LogCaptureFixture) -> None:
    plant = fjr.Plant(fjr.single_link(), "implicit_midpoint", compile=True)
    assert np.isfinite(plant.step(np.zeros(4), [1.0], 1e-3)).all()
    assert "implicit_midpoint" in caplog.text


@with_a_compiler
@pytest.mark.parametrize("spoilt", [lambda code: code[:100], lambda code: b"x" * len(code)], ids=["short", "other"])
def test_a_spoilt_library_is_rebuilt(spoilt: Callable[[bytes], bytes], cache: Path, function: ca.Function) -> None:
    compiling.compiled(function)
    (library,) = cache.glob("*.so")
    library.write_bytes(spoilt(library.read_bytes()))
    assert compiling.compiled(function).class_name() == "External"


# Code that is found by its inputs.

POINT = ([0.3, -0.2, 0.4, 0.1], [1.0, 0.5, -0.3, 0.2], np.arange(10.0).reshape(5, 2) / 10)


@pytest.fixture
def derivations(cache: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return the list of functions derived since the cache was empty."""
    seen: list[str] = []
    derive = Certificate._derived
    monkeypatch.setattr(Certificate, "_derived", lambda self: seen.append("certificate") or derive(self))
    return seen


def balance(gains: fjr.Gains = fjr.PAPER_GAINS, **robot: float) -> Certificate:
    return Certificate(fjr.TrackingLaw(fjr.planar_two_link(**robot), gains, compile=True))


def at_point(certificate: Certificate, u: list[float] | None = None) -> CertificateSeries:
    """Return the certificate at POINT, one instant."""
    return certificate.along(*(np.array(each)[None] for each in POINT), None if u is None else [u])


@with_a_compiler
def test_a_cached_function_is_not_derived_again(derivations: list[str]) -> None:
    first = at_point(balance())
    second = at_point(balance())
    assert len(derivations) == 1
    assert (first.V, first.dV, first.H) == (second.V, second.dV, second.H)


@with_a_compiler
def test_a_cached_law_is_not_derived_again_and_takes_other_gains(
    derivations: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    derive, robot = fjr.TrackingLaw.measured_expressions, fjr.planar_two_link()
    other = fjr.Gains(11, 21, 0.7, 16, 61, 0.4)
    monkeypatch.setattr(
        fjr.TrackingLaw, "measured_expressions", lambda law, *given: derivations.append("law") or derive(law, *given)
    )
    first, second = (fjr.TrackingLaw(robot, fjr.PAPER_GAINS, compile=True) for _ in range(2))
    assert first.measured_command(*POINT)[0].tolist() == second.measured_command(*POINT)[0].tolist()
    changed = second.with_gains(other).measured_command(*POINT)
    assert derivations == ["law"]
    u, V = fjr.TrackingLaw(robot, other).measured_command(*POINT)
    assert (changed[0], changed[1]) == (pytest.approx(u, rel=1e-12), pytest.approx(V, rel=1e-12))


@with_a_compiler
def test_gain_values_are_arguments_and_their_pattern_is_fixed(derivations: list[str]) -> None:
    at_point(balance())
    at_point(balance(fjr.Gains(11.0, 21.0, 0.7, 16.0, 61.0, 0.4)))
    assert len(derivations) == 1
    full = [[20.0, 1.0], [1.0, 12.0]]
    at_point(balance(fjr.Gains(10.0, full, 0.6, 15.0, 60.0, 0.3)))
    assert len(derivations) == 2


@with_a_compiler
def test_another_robot_is_derived(derivations: list[str]) -> None:
    changes = (
        {"stiffness": 30.0},
        {"gravity": 9.7},
        {"link_mass": (1.3, 0.8)},
        {"motor_damping": 0.05},
        {"input_gain": 1.1},
    )
    one = at_point(balance(), [1.0, 2.0])
    for change in changes:
        other = at_point(balance(**change), [1.0, 2.0])
        assert one.u_law.tolist() != other.u_law.tolist() or one.supplied != other.supplied
    assert len(derivations) == 1 + len(changes)


@with_a_compiler
def test_truncated_machine_code_is_recompiled(cache: Path, derivations: list[str]) -> None:
    wanted = at_point(balance()).V
    for library in cache.glob("certificate-*.so"):
        library.write_bytes(library.read_bytes()[:100])
    assert wanted == at_point(balance()).V
    assert len(derivations) == 2
