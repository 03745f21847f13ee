# SPDX-License-Identifier: Apache-2.0
"""Generated functions name their fused multiply-adds: the same bits from every compiler and processor."""

from __future__ import annotations

import re
import shutil
from functools import cache
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.cases import LOOPS, Arm, GainSet, random_point
from core.oracles.chains import arm7, scaled_gains
from fjr_core.numerics.checks import Array
from fjr_core.numerics.fused_code import LONGEST, fused
from program_cache import built

INPUTS = 6
COMPILERS = [name for name in ("cc", "clang") if shutil.which(name)]
OPTIONS = (("-O0",), ("-O3", "-march=native"))


@cache
def program(operations: int, exact: bool = False) -> ca.Function:
    """Return a random function of two vectors, with results that are read again hundreds of operations later.

    exact: of operations that do not round integers in double precision.
    """
    random = np.random.default_rng(0)
    x, y = ca.SX.sym("x", INPUTS), ca.SX.sym("y", INPUTS)
    values = [*ca.vertsplit(x), *ca.vertsplit(y)]
    sources = list(values)
    for _ in range(operations):
        a, b, c = (values[i] for i in random.integers(len(values), size=3))
        s, t = (sources[i] for i in random.integers(len(sources), size=2))
        polynomial = [
            s * t + c,
            c - s * t,
            s * t - t * c,
            ca.fmin(s * t + t * s, c),
            2 * s - t**2,
            -(s * t) + 8 / ca.SX(2) * s,
        ]
        rounded = [a + b / 3, a / 2 - b * c / (1 + b * b), ca.sin(a) * b + a * c, ca.cos(a + 1)]
        made = [*polynomial, *([] if exact else rounded)]
        values.append(made[random.integers(len(made))])
    return ca.Function("program", [x, y], [ca.vertcat(*values[-400:]), ca.vertcat(*values[::7])])


@cache
def generated(function: ca.Function) -> str:
    """Return the C code of CasADi."""
    generator = ca.CodeGenerator(function.name())
    generator.add(function)
    return str(generator.dump())


def compiled(code: str, folder: Path, *command: str) -> ca.Function:
    """Return the function `program` of a C code."""
    source, library = folder / "code.c", folder / f"{len(list(folder.iterdir()))}.so"
    source.write_text(code)
    built(command, [source], library, "-std=gnu99", "-ffp-contract=off", "-fPIC", "-shared")
    return ca.external("program", str(library))


def results(function: ca.Function, arguments: Array) -> Array:
    """Return all results as one array."""
    return np.concatenate([each.full().ravel() for each in function(*arguments)])


def test_all_compilers_and_processors_give_the_same_bits(tmp_path: Path) -> None:
    """Without -march=native the operation is a function of the C library on most processors."""
    function = program(3 * LONGEST)
    texts = [fused(generated(function), longest) for longest in (None, LONGEST)]
    builds = list(zip(texts, OPTIONS, strict=True))  # whole without optimisation, in parts with it
    built = [compiled(text, tmp_path, name, *flags) for name in COMPILERS for text, flags in builds]
    for arguments in np.random.default_rng(0).normal(size=(5, 2, INPUTS)):
        first, *others = (results(each, arguments) for each in built)
        assert all(np.array_equal(first, other) for other in others)
        assert np.allclose(first, results(function, arguments), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("longest", [None, 50])
def test_results_without_rounding_are_those_of_casadi(longest: int | None, tmp_path: Path) -> None:
    function = program(3 * LONGEST, exact=True)
    machine_code = compiled(fused(generated(function), longest), tmp_path, COMPILERS[0], "-O1")
    for arguments in np.random.default_rng(0).integers(-3, 4, size=(5, 2, INPUTS)).astype(float):
        assert np.array_equal(results(machine_code, arguments), results(function, arguments))


def test_every_sum_with_a_product_is_one_operation_and_equal_operations_are_computed_once() -> None:
    code = fused(generated(program(3 * LONGEST)))
    products = set(re.findall(r"(t\d+)=\([^()]*\*[^()]*\);", code))
    sums = re.findall(r"=\((t\d+)[+-](t\d+)\);", code)
    assert code.count("fma(") > LONGEST
    assert sums
    assert not [pair for pair in sums if set(pair) & products and len(set(pair)) == 2]
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    code = fused(generated(ca.Function("program", [x, y], [ca.sin(x * y), ca.cos(y * x), (x + y) / 2, 3 * (y + x)])))
    assert len(re.findall(r"\(t\d+\*t\d+\)", code)) == 2  # x y, and 3 (x + y)
    assert len(re.findall(r"\(t\d+\+t\d+\)", code)) == 1


def test_parts_are_short() -> None:
    parts = fused(generated(program(3 * LONGEST)), LONGEST).split("noinline")[1:]
    assert len(parts) > 3
    lines = [part.partition("\n}")[0].splitlines()[1:] for part in parts]
    assert max(sum(not re.search(r"=b\[\d+\]|b\[\d+\]=", line) for line in each) for each in lines) <= 1.5 * LONGEST


def test_functions_with_calls_do_not_change() -> None:
    x = ca.MX.sym("x", INPUTS)
    inner, outer = program(20), []
    for k in range(LONGEST // 4):
        outer.append(inner(x, k * x)[0])
    calls = generated(ca.Function("calls", [x], outer))
    function = re.compile(r"^static int casadi_f0.*?^\}", re.MULTILINE | re.DOTALL)
    assert "casadi_f1(" in function.search(calls)[0]
    assert function.search(fused(calls, LONGEST))[0] == function.search(calls)[0]


SEVEN = (arm7(), scaled_gains(arm7()))


@pytest.mark.parametrize(("arm", "gains"), [LOOPS[-3], LOOPS[-1], SEVEN], ids=lambda case: case.name)
def test_compiled_law_and_plant_give_the_same_numbers(arm: Arm, gains: GainSet) -> None:
    as_c, in_vm = (fjr.TrackingLaw(arm.robot, gains.gains, compile=flag) for flag in (True, False))
    fast, slow = (fjr.Plant(arm.robot, compile=flag) for flag in (True, False))
    for seed in range(5):
        p = random_point(arm, seed)
        assert as_c.effort(p.x_v, p.x, p.jets, p.omega) == pytest.approx(
            in_vm.effort(p.x_v, p.x, p.jets, p.omega), rel=1e-9
        )
        assert as_c.command(p.x, p.jets) == pytest.approx(in_vm.effort(p.x, p.x, p.jets), rel=1e-9)
        here, there = as_c.evaluate(p.x_v, p.x, p.jets), in_vm.evaluate(p.x_v, p.x, p.jets)
        assert (here.V, here.dV) == pytest.approx((there.V, there.dV), rel=1e-9)
        assert fast.step(p.x, p.u, 1e-3) == pytest.approx(slow.step(p.x, p.u, 1e-3), rel=1e-9)
