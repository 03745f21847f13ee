# SPDX-License-Identifier: Apache-2.0
"""Long generated functions are compiled in parts, with the same operations in the same order."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from fjr_core.numerics import jit
from fjr_core.numerics.function_splitting import LONGEST, split_functions

INPUTS = 6
with_a_compiler = pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler (cc) on this machine")


def program(operations: int) -> ca.Function:
    """Return a random function of two vectors, with results that are read again hundreds of operations later."""
    random = np.random.default_rng(0)
    x, y = ca.SX.sym("x", INPUTS), ca.SX.sym("y", INPUTS)
    values = [*ca.vertsplit(x), *ca.vertsplit(y)]
    for _ in range(operations):
        a, b = (values[i] for i in random.integers(len(values), size=2))
        values.append([a + b / 3, a - b / 2, ca.sin(a) * b, ca.cos(a + 1)][random.integers(4)])
    return ca.Function("program", [x, y], [ca.vertcat(*values[-400:]), ca.vertcat(*values[::7])])


def generated(function: ca.Function) -> str:
    """Return the C code of CasADi."""
    generator = ca.CodeGenerator(function.name())
    generator.add(function)
    return str(generator.dump())


def bodies(code: str) -> list[list[str]]:
    """Return the assignments and results of each static function, without declarations, loads and stores."""
    found = [text.partition("\n}")[0] for text in code.split("\nstatic ")]
    kept = [[line for line in body.splitlines() if re.match(r"  (a\d+=(?!b\[)|if )", line)] for body in found]
    return [body for body in kept if body]


@with_a_compiler
def test_a_function_in_parts_gives_the_same_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(jit, "OPTIONS", ("-O1", "-ffp-contract=off", "-fPIC", "-shared"))  # no fused operations
    function = program(3 * LONGEST)
    machine_code = jit.compiled(function)
    assert machine_code.class_name() == "External"
    random = np.random.default_rng(0)
    for _ in range(5):
        arguments = random.normal(size=(2, INPUTS))
        for here, there in zip(machine_code(*arguments), function(*arguments), strict=True):
            assert np.array_equal(here.full(), there.full())


def test_parts_hold_the_statements_of_the_function_in_their_order() -> None:
    code = generated(program(3 * LONGEST))
    parts = bodies(split_functions(code))
    assert len(parts) > 3
    assert max(map(len, parts)) <= LONGEST
    assert sum(parts, []) == sum(bodies(code), [])


def test_functions_that_are_short_or_have_calls_do_not_change() -> None:
    short = generated(program(LONGEST // 4))
    x = ca.MX.sym("x", INPUTS)
    inner, results = program(20), []
    for k in range(LONGEST // 4):
        results.append(inner(x, k * x)[0])
    calls = generated(ca.Function("calls", [x], results))
    assert max(map(len, re.findall(r"\{\n(.*?)^\}", calls, re.MULTILINE | re.DOTALL))) > 20 * LONGEST
    assert split_functions(short) == short
    assert split_functions(calls) == calls
