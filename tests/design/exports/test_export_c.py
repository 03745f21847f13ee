# SPDX-License-Identifier: Apache-2.0
"""Export to C99: efforts equal to Python's bit by bit, no warnings, no static state, use from C++, two exports."""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import fjr_core as fjr
from design.exports.c_program import (
    C99,
    CPP,
    SHIPPED,
    built,
    changed,
    compared,
    exported,
    program_output,
    replayed,
    scenario,
)
from fjr_core.config.scenario import Scenario, parse_scenario
from fjr_design.exports.c_code import casadi_code, checked_prefix, numbers, prefix_of, quoted
from fjr_design.exports.project import export

EFFORTS, LOOP = "efforts that are not equal", "closed loop: worst difference"
EQUAL = 1e-12


def robust(n: int) -> dict[str, object]:
    """Return parameters of a law with a controller state and prediction over a sample."""
    return {"robust.residual_gain": [20.0] * n, "robust.integral_gain": [2.0] * n, "robust.delay": 0.001}


def replays(scenario: Scenario, folder: Path) -> None:
    """Export the scenario and replay it: efforts equal bit by bit, the closed loop to rounding."""
    worst = replayed(exported(scenario, folder))
    assert worst[EFFORTS] == 0
    assert worst.get(LOOP, 0.0) <= 1e-9


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_scenario_replays_without_warnings(name: str, tmp_path: Path) -> None:
    replays(scenario(name), tmp_path)


def test_law_with_controller_state_lead_and_geared_motors_on_an_implicit_plant_replays(tmp_path: Path) -> None:
    geared = {"measurement.gear_ratio": [100.0, -50.0], "integrator": "implicit_midpoint"}
    replays(changed("two_link", robust(2) | geared), tmp_path)
    assert ".lead = 1500000" in (tmp_path / "two_link.c").read_text()


def test_plant_that_differs_from_the_model_replays(tmp_path: Path) -> None:
    text = (
        "/**: {ros__parameters: {realtime_priority: 0}}",
        "/**/fjr_plant: {ros__parameters: {robot.link_inertia: [0.04]}}",
    )
    made = parse_scenario("other", "\n".join(text))
    assert not np.allclose(made.plant.robot.M_l([0.0]), made.law.robot.M_l([0.0]))
    replays(made, tmp_path)


@pytest.fixture(scope="module")
def replay(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the replay program of paper_k31, next to its recorded case."""
    folder = exported(scenario("paper_k31"), tmp_path_factory.mktemp("replay"))
    return built(C99, sorted(folder.glob("*.c")), folder / "replay")


def altered(case: Path, column: int, change: float, to: Path) -> float:
    """Write a case with another number in a column of its sample 40; return the number that it had."""
    rows = [line.split() for line in case.read_text().splitlines()]
    number = float.fromhex(rows[40][column])
    rows[40][column] = float.hex(number + change)
    to.write_text("".join(" ".join(row) + "\n" for row in rows))
    return number


@pytest.mark.parametrize("column", [2, 5, -1])
def test_replay_detects_a_wrong_number(column: int, replay: Path, tmp_path: Path) -> None:
    altered(replay.with_name("case.txt"), column, 1e-8, tmp_path / "case.txt")
    assert compared(replay, tmp_path / "case.txt", code=1)[EFFORTS] >= 1


def test_replay_allows_a_stated_rounding_of_another_c_library_and_no_more(replay: Path, tmp_path: Path) -> None:
    sources = sorted(replay.parent.glob("*.c"))
    tolerant = built(C99, sources, tmp_path / "tolerant", "-DEFFORT_TOLERANCE=1e-9")
    for change, program, code in ((1e-12, replay, 1), (1e-12, tolerant, 0), (1e-8, tolerant, 1)):
        effort = altered(replay.with_name("case.txt"), -1, change, tmp_path / "case.txt")
        found = compared(program, tmp_path / "case.txt", code=code)
        assert found[EFFORTS] == 1
        assert found["efforts: worst difference"] == pytest.approx(change / max(1, abs(effort)), rel=1e-2)


@pytest.mark.parametrize("text", ["", "t\n", "0 0 1.0\n", "1e3 0\n"])
def test_replay_reports_an_invalid_case_file(text: str, replay: Path, tmp_path: Path) -> None:
    (tmp_path / "case.txt").write_text(text)
    assert "is not a case of this export" in program_output(replay, str(tmp_path / "case.txt"), code=2)
    assert "cannot be opened" in program_output(replay, str(tmp_path / "nothing.txt"), code=2)


TWO = r"""
#include <cstdio>
#include <thread>
#include <vector>
#include "two_link.h"
#include "other.h"

#define EFFORTS_OF(P) \
  static std::vector<double> efforts_of_##P() \
  { \
    P##_work work; \
    P##_model model; \
    P##_controller controller; \
    P##_command command; \
    P##_sample sample = {0, {0.1, 0.2}, {0.15, 0.25}, {0.0, 0.1, 0.2, 0.3}}; \
    std::vector<double> all; \
    P##_scenario_model(&model, &work); \
    P##_init(&controller, &P##_scenario_settings, P##_scenario_gains, P##_scenario_reference); \
    for (int k = 0; k < 2000; ++k, sample.stamp += 1000000) { \
      sample.link[k % 2] += 1e-5; \
      P##_step(&model, &controller, &sample, sample.stamp, &command); \
      all.insert(all.end(), command.u, command.u + 2); \
    } \
    return all; \
  }
EFFORTS_OF(two_link)
EFFORTS_OF(other)

int main()
{
  std::vector<double> a, b;
  std::thread one([&] { a = efforts_of_two_link(); }), two([&] { b = efforts_of_other(); });
  one.join();
  two.join();
  const bool same = a == efforts_of_two_link() && b == efforts_of_other();
  std::printf("%s %s %a %a\n", two_link_scenario_name, other_joint_names[1], a[0], b[0]);
  return same && a != b ? 0 : 1;
}
"""


def test_two_exports_run_in_one_threaded_cpp_program(tmp_path: Path) -> None:
    other = changed("two_link", {"reference.type": "circle", "reference.circle.radius": 0.3})
    a, b = exported(scenario("two_link"), tmp_path / "a"), exported(other, tmp_path / "b", prefix="other")
    objects = [
        built(C99, [source], source.with_suffix(".o"), "-c") for source in (*a.glob("two_link*.c"), *b.glob("other*.c"))
    ]
    (tmp_path / "main.cpp").write_text(TWO)
    program = built(CPP, [tmp_path / "main.cpp", *objects], tmp_path / "main", f"-I{a}", f"-I{b}", "-pthread")
    name, joint, *values = program_output(program).split()
    assert (name, joint) == ("two_link", "elbow")
    for value, each in zip(values, (scenario("two_link"), other), strict=True):
        step = each.control_step()
        step.step(0, 0, np.array([0.1 + 1e-5, 0.2]), np.array([0.15, 0.25]), np.array([0.0, 0.1]), np.array([0.2, 0.3]))
        assert float.fromhex(value) == step.u[0]


FREESTANDING = ("-c", "-fno-pic", "-ffreestanding", "-fno-stack-protector", "-U_FORTIFY_SOURCE")
EXACT = {"ceil", "copysign", "fabs", "fma", "fmax", "fmin", "fmod", "nextafter", "rint", "sqrt"}
NEEDED = EXACT | {"cos", "exp", "log", "sin", "memcpy", "memset", "__cpu_model", "__cpu_indicator_init"}
"""What the library takes from outside: functions of C; the two of gcc select the fma instruction on x86."""


def test_exported_library_needs_functions_of_mathematics_only_and_has_no_writable_data(tmp_path: Path) -> None:
    name = "paper_k31"
    folder = exported(changed(name, robust(1)), tmp_path)
    for source in folder.glob(f"{name}*.c"):
        made = built(C99, [source], source.with_suffix(".o"), *FREESTANDING)
        symbols = subprocess.run(["nm", str(made)], capture_output=True, text=True, check=True).stdout
        kinds = {line.split()[-2]: line.split()[-1] for line in symbols.splitlines()}
        assert not set(kinds) & set("DdBbCSs"), symbols
        defined = [line.split()[-1] for line in symbols.splitlines() if line.split()[-2] in "TRV"]
        assert all(symbol.startswith(f"{name}_") for symbol in defined)
        needed = {line.split()[-1] for line in symbols.splitlines() if line.split()[-2] == "U"}
        assert {symbol for symbol in needed if not symbol.startswith(f"{name}_")} <= NEEDED


def test_constants_in_c_round_trip_exactly() -> None:
    values = np.random.default_rng(3).normal(size=50) * 10.0 ** np.random.default_rng(4).integers(-300, 300, 50)
    assert np.array_equal([float(text) for text in numbers(values).split(",")], values)
    assert numbers([]) == "0.0"
    assert numbers([np.inf, -np.inf, np.nan]) == "INFINITY, -INFINITY, NAN"
    x = ca.MX.sym("x")
    code = casadi_code("p", {"f": ca.Function("f", [x], [x * ca.DM(values)])})
    found = {float(text) for text in re.findall(r"-?\d\.\d*(?:e[+-]\d+)?", code)}
    assert set(values) <= found


ODD = """a"b c\\d grün *//* */ int evil; %s what??/"""
"""Name of scenario and joint."""


def test_any_scenario_or_joint_name_compiles(tmp_path: Path) -> None:
    odd = replace(changed("paper_k31", {"joints": [ODD]}), name=ODD)
    folder = exported(odd, tmp_path, samples=3)
    program = built(C99, sorted(folder.glob("*.c")), folder / "replay")
    assert program_output(program, str(folder / "case.txt")).startswith(ODD)


@pytest.mark.parametrize(
    ("name", "prefix"),
    [
        ("paper_k31", "paper_k31"),
        ("arm-7 b", "arm_7_b"),
        ("7", "loop_7"),
        ("_x_", "x"),
        ("ä", "loop"),
        ("Math", "loop_Math"),
        ("7" * 34 + " b", "loop_" + "7" * 34),
    ],
)
def test_prefix_is_derived_from_the_name(name: str, prefix: str) -> None:
    assert prefix_of(name) == checked_prefix(prefix) == prefix
    assert quoted("?") == '"\\077"'


@pytest.mark.parametrize(
    ("prefixes", "words"),
    [
        (("", "7a", "a-b", "a b", "ä", "a" * 41, "_a"), "expected a letter"),
        (
            ("replay", "case", "test", "all", "install", "clean", "math", "STRING", "stdio", "m"),
            "which is a name of C headers, CMake or the export; expected another one",
        ),
    ],
    ids=["no identifier", "taken"],
)
def test_other_prefixes_are_refused(prefixes: tuple[str, ...], words: str) -> None:
    for prefix in prefixes:
        with pytest.raises(fjr.ParameterError, match=f"prefix is '{prefix}'.*{words}"):
            checked_prefix(prefix)


def test_unsupported_loops_are_refused_with_the_reason() -> None:
    with pytest.raises(fjr.StateError, match="diverged at t = "):
        export(changed("paper_k3p1", {"publish_rate": 20.0, "inner_steps": 1}), "p")
    with pytest.raises(fjr.StateError, match="the law is written in Python; expected one made of expressions"):
        export(changed("paper_k31", {"law.type": "own_code:Pd"}), "p")
