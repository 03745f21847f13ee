# SPDX-License-Identifier: Apache-2.0
"""Compiled code gives CasADi's numbers, is cached by content or inputs, and is safe for concurrent processes."""

from __future__ import annotations

import logging
import os
import shutil
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from cffi import FFI

import fjr_core as fjr
from core.numerics.processes import COMPILED, CUBES, output, started
from fjr_core.errors import PIP, CompilerError
from fjr_core.monitoring.certificate import Certificate, CertificateSeries
from fjr_core.numerics import jit as compiling
from fjr_core.numerics.jit import declarations, ffi_of
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.library import HEADER, step_library, text
from fjr_core.runtime.safety_settings import Settings

pytestmark = pytest.mark.usefixtures("cache")


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


def test_compiled_code_is_loaded_from_the_cache_folder(cache: Path) -> None:
    law = fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS, compile=True)
    assert not cache.exists()  # compilation waits for the first use
    assert law.command_function.class_name() == "External"
    assert [path.name.partition("-")[0] for path in cache.glob("*.so")] == ["command"]


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


def test_concurrent_processes_build_once(tmp_path: Path) -> None:
    processes = [started(CUBES, CC=str(logging_compiler(tmp_path))) for _ in range(3)]
    assert [output(process).strip() for process in processes] == [COMPILED] * 3
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
    assert f"or {PIP} ziglang" in sentence
    law = fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS, compile=True)
    assert np.isfinite(law.command(np.zeros(4), np.zeros((5, 1)))).all()


def test_the_control_step_needs_a_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-cc")
    law, settings = fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS), Settings(("joint1",))
    step_library.cache_clear()
    for needing in (compiling.c_compiler, lambda: ControlStep(law, fjr.Hold([0.0]), settings)):
        with pytest.raises(CompilerError, match=r"no C compiler \(no-such-cc\) is on the path; expected one"):
            needing()


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


FAILING = {"false": "false failed", "true": "true wrote no shared object", 'gcc "': "No closing"}


@pytest.mark.parametrize("compiler", FAILING)
def test_a_failing_compiler_is_logged_once(
    compiler: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, function: ca.Function
) -> None:
    monkeypatch.setenv("CC", compiler)
    assert FAILING[compiler] in single_warning(caplog, function)


def test_functions_without_c_code_run_in_the_virtual_machine(caplog: pytest.LogCaptureFixture) -> None:
    plant = fjr.Plant(fjr.single_link(), "implicit_midpoint", compile=True)
    assert np.isfinite(plant.step(np.zeros(4), [1.0], 1e-3)).all()
    assert "implicit_midpoint" in caplog.text


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


def test_a_function_is_derived_once_for_each_robot_and_pattern_of_the_gains_whose_values_are_arguments(
    derivations: list[str],
) -> None:
    first, second = at_point(balance()), at_point(balance())
    at_point(balance(fjr.Gains(11.0, 21.0, 0.7, 16.0, 61.0, 0.4)))
    assert len(derivations) == 1
    assert (first.V, first.dV, first.H) == (second.V, second.dV, second.H)
    at_point(balance(fjr.Gains(10.0, [[20.0, 1.0], [1.0, 12.0]], 0.6, 15.0, 60.0, 0.3)))
    assert len(derivations) == 2
    assert first.u_law.tolist() != at_point(balance(gravity=1.3)).u_law.tolist()
    assert len(derivations) == 3


def test_robots_that_differ_in_one_parameter_have_other_fingerprints() -> None:
    names = ("stiffness", "gravity", "motor_inertia", "link_damping", "motor_damping", "input_gain")
    others = [fjr.planar_two_link(**{name: 1.3}).fingerprint() for name in names]
    assert len({fjr.planar_two_link().fingerprint(), *others}) == 1 + len(names)


# C declarations are parsed once; what is kept is verified before it is executed.

STEP = declarations(text(HEADER), {"FJR_N": 3, "FJR_MEMORY": 2})
STRUCTS = ("controller", "model", "settings", "sample", "command", "reference")
POINTS = "struct point { double x, y; };"
READ = f"""
import sys
from fjr_core.numerics.jit import ffi_of
assert ffi_of("{POINTS}").sizeof("struct point") == 16
print("pycparser" in sys.modules)
"""


def layout(ffi: FFI) -> dict[str, object]:
    """Return offset and type of each field, and the enumerations."""
    fields = {
        f"{name}.{field}": (found.offset, found.type.cname)
        for name in STRUCTS
        for field, found in ffi.typeof(f"struct fjr_{name}").fields
    }
    return {**fields, "kinds": ffi.typeof("enum fjr_kind").elements}


def test_a_later_process_does_not_parse() -> None:
    assert ffi_of(POINTS).sizeof("struct point") == 16
    assert "pycparser" in sys.modules
    assert output(started(READ)).strip() == "False"


def test_kept_types_are_those_that_cffi_parses_and_changed_code_is_not_executed(cache: Path) -> None:
    """A folder that is not writable only costs time."""
    parsed = FFI()
    parsed.cdef(STEP)
    for _ in range(2):  # written, then kept
        assert layout(ffi_of(STEP)) == layout(parsed)
    (kept,) = cache.glob("c_types-*.py")
    kept.write_text("raise AssertionError")
    assert ffi_of(STEP).sizeof("struct fjr_sample") == 8 * (1 + 4 * 3)
    shutil.rmtree(cache)
    cache.write_text("a file in place of the folder")
    assert ffi_of(STEP).sizeof("struct fjr_sample") == 8 * (1 + 4 * 3)
