# SPDX-License-Identifier: Apache-2.0
"""Export to C99: numbers equal to Python, no warnings, no static state, use from C++, two exports in one program."""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

import fjr_core as fjr
import own_code
from core.codegen.c_program import C99, CPP, SHIPPED, built, changed, exported, loop, program_output, replayed
from fjr_core.codegen import Loop, export, loop_of, prefix_of
from fjr_core.codegen.c_code import casadi_code, checked_prefix, numbers, quoted
from fjr_core.config.scenario import left_out, parse_scenario
from fjr_core.control.sampled_law import AsSampledLaw
from fjr_core.numerics.casadi_function import NumericFunction
from fjr_core.robot.robot import Robot

EQUAL, IN_A_ROW = 1e-12, 1e-9
LAW, REFERENCE, MEASURED, LATER = "law: u, V, next", "reference: jets", "plant: measured", "plant: one sample later"
LOOP = "closed loop: x, u, memory"


@dataclass(frozen=True, eq=False)
class WithControllerState:
    """The law of a scenario with the inputs that a static law ignores: integral, sent effort, dt and lead."""

    law: fjr.TrackingLaw
    lead: float = 0.003

    @property
    def robot(self) -> Robot:
        return self.law.robot

    @property
    def gain_values(self) -> np.ndarray:
        return np.append(self.law.gain_values, 0.7)

    @property
    def memory(self) -> np.ndarray:
        return np.linspace(0.01, 0.02, self.robot.n + 1)

    @cached_property
    def step_function(self) -> ca.Function:
        n, g = self.robot.n, len(self.gain_values)
        sizes = [2 * n, 2 * n, (n, 5), g, n + 1, n, 1]
        position, velocity, jets, gains, memory, sent, dt = (
            ca.MX.sym("a", *size) if isinstance(size, tuple) else ca.MX.sym("a", size) for size in sizes
        )
        u, _ = self.law.measured_expression(position, velocity, jets, gains[: g - 1])
        after = ca.vertcat(memory[:n] + dt * (position[:n] - jets[:, 0]), memory[n] + ca.dot(sent, velocity[n:]) * dt)
        names = ["position", "velocity", "jets", "gains", "memory", "sent", "dt"]
        arguments = [position, velocity, jets, gains, memory, sent, dt]
        return ca.Function(
            "step", arguments, [u - gains[g - 1] * after[:n], ca.MX(np.nan), after], names, ["u", "V", "next"]
        )


def with_controller_state(name: str) -> Loop:
    law = loop(name).law
    assert isinstance(law, AsSampledLaw)
    assert isinstance(law.law, fjr.TrackingLaw)
    return changed(name, law=WithControllerState(law.law))


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_scenario_replays_without_warnings(name: str, tmp_path: Path) -> None:
    worst = replayed(exported(loop(name), tmp_path, samples=200))
    assert set(worst) == {LAW, REFERENCE, MEASURED, LATER, LOOP}
    assert max(worst[part] for part in (LAW, REFERENCE, MEASURED, LATER)) <= EQUAL
    assert worst[LOOP] <= IN_A_ROW


@pytest.mark.parametrize("name", ["paper_k31", "two_link"])
def test_law_with_controller_state_and_lead_but_no_storage_replays(name: str, tmp_path: Path) -> None:
    worst = replayed(exported(with_controller_state(name), tmp_path))
    assert max(worst.values()) <= EQUAL
    header = (tmp_path / f"{name}.h").read_text()
    assert re.search(r"_MEMORY [23] ", header)
    assert "_LEAD 0.003 " in header
    assert "sent (n): the effort sent for the last sample, after all limits" in header


def test_implicit_midpoint_plant_replays(tmp_path: Path) -> None:
    plant = fjr.Plant(loop("two_link").plant.robot, "implicit_midpoint")
    assert max(replayed(exported(changed("two_link", plant=plant), tmp_path)).values()) <= EQUAL


def test_plant_that_differs_from_the_model_replays(tmp_path: Path) -> None:
    text = (
        "/**: {ros__parameters: {realtime_priority: 0}}",
        "/**/fjr_plant: {ros__parameters: {robot.link_inertia: [0.04]}}",
    )
    made = loop_of(parse_scenario("other", "\n".join(text)))
    assert not np.allclose(made.plant.robot.M_l([0.0]), made.law.robot.M_l([0.0]))
    assert max(replayed(exported(made, tmp_path)).values()) <= EQUAL


@pytest.mark.parametrize(
    ("column", "part"),
    [
        ("u[0]", LAW),
        ("V[0]", LAW),
        ("jets[3]", REFERENCE),
        ("velocity[1]", MEASURED),
        ("x_next[2]", LATER),
        ("x[1]", LOOP),
    ],
)
def test_replay_detects_a_wrong_number(column: str, part: str, tmp_path: Path) -> None:
    folder = exported(loop("paper_k31"), tmp_path)
    rows = [line.split(",") for line in (folder / "case.csv").read_text().splitlines()]
    k = rows[0].index(column)
    rows[40][k] = repr(float(rows[40][k]) + 1e-8)
    (folder / "case.csv").write_text("".join(",".join(row) + "\n" for row in rows))
    assert replayed(folder, code=1)[part] > EQUAL


@pytest.mark.parametrize("text", ["", "t,dt\n", "t,dt\n1,2\n", "t,dt\n" + "x," * 30 + "\n"])
def test_replay_reports_an_invalid_case_file(text: str, tmp_path: Path) -> None:
    folder = exported(loop("paper_k31"), tmp_path)
    program = built(C99, sorted(folder.glob("*.c")), folder / "replay")
    (folder / "case.csv").write_text(text)
    assert "is not a case of this export" in program_output(program, str(folder / "case.csv"), code=2)
    assert "cannot be opened" in program_output(program, str(folder / "nothing.csv"), code=2)


TWO = r"""
#include <cstdio>
#include <thread>
#include <vector>
#include "two_link.h"
#include "other.h"

static std::vector<double> efforts(bool first)
{
  static thread_local two_link_work work;  // one for each thread
  static thread_local other_work other;
  std::vector<double> all;
  double jets[10], u[2], position[4] = {0.1, 0.2, 0.15, 0.25}, velocity[4] = {0.0, 0.1, 0.2, 0.3};
  for (int k = 0; k < 2000; ++k) {
    const double t = 1e-3 * k;
    position[k % 4] += 1e-4;
    if (first) two_link_reference(t, jets, &work);
    else other_reference(t, jets, &other);
    if (first) two_link_law(position, velocity, jets, nullptr, nullptr, nullptr, 0.0, u, nullptr, nullptr, &work);
    else other_law(position, velocity, jets, nullptr, nullptr, nullptr, 0.0, u, nullptr, nullptr, &other);
    all.insert(all.end(), u, u + 2);
  }
  return all;
}

int main()
{
  std::vector<double> a, b;
  std::thread one([&] { a = efforts(true); }), two([&] { b = efforts(false); });
  one.join();
  two.join();
  const bool same = a == efforts(true) && b == efforts(false);
  std::printf("%s %s %.17g %.17g %.17g %.17g\n", two_link_scenario, other_joint_names[1], a[0], a[1], b[0], b[1]);
  return same && a != b ? 0 : 1;
}
"""


def test_two_exports_run_in_one_threaded_cpp_program(tmp_path: Path) -> None:
    other = changed("two_link", reference=fjr.Circle((0.2, -0.1), 0.3, 2.0))
    a, b = exported(loop("two_link"), tmp_path / "a"), exported(other, tmp_path / "b", prefix="other")
    objects = [
        built(C99, [source], source.with_suffix(".o"), "-c") for source in (*a.glob("two_link*.c"), *b.glob("other*.c"))
    ]
    (tmp_path / "main.cpp").write_text(TWO)
    program = built(CPP, [tmp_path / "main.cpp", *objects], tmp_path / "main", f"-I{a}", f"-I{b}", "-pthread")
    scenario, joint, *values = program_output(program).split()
    assert (scenario, joint) == ("two_link", "elbow")
    position, velocity = [0.1 + 1e-4, 0.2, 0.15, 0.25], [0.0, 0.1, 0.2, 0.3]
    law = loop("two_link").law.law
    expected = [
        law.measured_command(position, velocity, each.reference.jets(0.0))[0] for each in (loop("two_link"), other)
    ]
    assert np.array(values, dtype=float) == pytest.approx(np.concatenate(expected), rel=EQUAL)


@pytest.mark.parametrize("name", ["paper_k31", "two_link"])
def test_exported_library_has_no_writable_data(name: str, tmp_path: Path) -> None:
    folder = exported(with_controller_state(name), tmp_path)
    for source in folder.glob(f"{name}*.c"):
        made = built(C99, [source], source.with_suffix(".o"), "-c", "-fno-pic")
        symbols = subprocess.run(["nm", str(made)], capture_output=True, text=True, check=True).stdout
        kinds = {line.split()[-2]: line.split()[-1] for line in symbols.splitlines()}
        assert not set(kinds) & set("DdBbCSs"), symbols
        defined = [line.split()[-1] for line in symbols.splitlines() if line.split()[-2] in "TRV"]
        assert all(symbol.startswith(f"{name}_") for symbol in defined)
        assert not {"malloc", "free", "printf"} & set(symbols.split())


GAINS = r"""
#include <stdio.h>
#include "paper_k31.h"
int main(void)
{
  const double position[] = {0.3, 0.4}, velocity[] = {0.1, -0.2}, jets[] = {0.1, 1.0, 0.2, 0.3, 0.4};
  double gains[PAPER_K31_GAINS], u, V;
  int i;
  paper_k31_work work;
  for (i = 0; i < PAPER_K31_GAINS; ++i) gains[i] = paper_k31_gains[i];
  gains[2] *= 2.0;
  paper_k31_law(position, velocity, jets, gains, NULL, NULL, 0.0, &u, &V, NULL, &work);
  printf("%.17g %.17g\n", u, V);
  return 0;
}
"""


def test_gains_can_be_changed_as_the_header_describes(tmp_path: Path) -> None:
    folder = exported(loop("paper_k31"), tmp_path)
    assert "Lambda_l (1), Pi_l (1), K_ld (1)," in (folder / "paper_k31.h").read_text()
    (folder / "replay.c").write_text(GAINS)
    values = program_output(built(C99, sorted(folder.glob("*.c")), folder / "main")).split()
    gains = fjr.Gains(Lambda_l=10.0, Pi_l=20.0, K_ld=1.2, Lambda_m=15.0, Pi_m=60.0, K_md=0.3)
    jets = np.array([[0.1], [1.0], [0.2], [0.3], [0.4]])
    u, V = fjr.TrackingLaw(fjr.single_link(), gains).measured_command([0.3, 0.4], [0.1, -0.2], jets)
    assert np.array(values, dtype=float) == pytest.approx([u[0], V], rel=EQUAL)


def test_constants_in_c_round_trip_exactly() -> None:
    values = np.random.default_rng(3).normal(size=50) * 10.0 ** np.random.default_rng(4).integers(-300, 300, 50)
    assert np.array_equal([float(text) for text in numbers(values).split(",")], values)
    assert numbers([]) == "0.0"
    assert numbers([np.inf, -np.inf, np.nan]) == "INFINITY, -INFINITY, NAN"
    x = ca.MX.sym("x")
    code = casadi_code("p", {"f": ca.Function("f", [x], [x * ca.DM(values)])})
    found = {float(text) for text in re.findall(r"-?\d\.\d*(?:e[+-]\d+)?", code)}
    assert set(values) <= found


ODD = ('a"b', "c\\d", "grün", "what??/", "*/ int evil;", "%s")
"""Names of scenario and joint."""


def test_any_scenario_or_joint_name_compiles(tmp_path: Path) -> None:
    for name in ODD:
        folder = exported(changed("paper_k31", name=name, joints=(name,)), tmp_path / prefix_of(name), samples=3)
        assert program_output(
            built(C99, sorted(folder.glob("*.c")), folder / "replay"), str(folder / "case.csv")
        ).startswith(name)


@pytest.mark.parametrize(
    ("name", "prefix"),
    [
        ("paper_k31", "paper_k31"),
        ("arm-7 b", "arm_7_b"),
        ("7", "loop_7"),
        ("ä", "loop"),
        ("_x_", "x"),
        ("test", "loop_test"),
        ("Math", "loop_Math"),
        ("7" * 50, "loop_" + "7" * 35),
        ("7" * 34 + " b", "loop_" + "7" * 34),
    ],
)
def test_prefix_is_derived_from_the_name(name: str, prefix: str) -> None:
    assert prefix_of(name) == checked_prefix(prefix) == prefix
    assert quoted("?") == '"\\077"'


@pytest.mark.parametrize("prefix", ["", "7a", "a-b", "a b", "ä", "a" * 41, "_a"])
def test_prefixes_that_are_no_c_identifiers_are_refused(prefix: str) -> None:
    with pytest.raises(fjr.ParameterError, match="expected a letter"):
        export(loop("paper_k31"), prefix)


@pytest.mark.parametrize(
    "prefix", ["replay", "case", "test", "all", "install", "clean", "math", "STRING", "stdio", "m"]
)
def test_prefixes_that_collide_with_files_or_targets_are_refused(prefix: str) -> None:
    with pytest.raises(fjr.ParameterError, match=f"prefix is '{prefix}', which .*; expected another one"):
        export(loop("paper_k31"), prefix)


def test_unsupported_loops_are_refused_with_the_reason() -> None:
    with pytest.raises(fjr.StateError, match="expected equal numbers"):
        changed("paper_k31", joints=("a", "b"))
    with pytest.raises(fjr.StateError, match="diverged at t = "):
        export(changed("paper_k3p1", sample_period=0.05, inner_steps=1), "p")
    with pytest.raises(fjr.TrajectoryError, match="cannot be exported to C; expected one of Sine"):
        _ = changed("paper_k31", reference=Unknown()).functions
    own = fjr.PythonLaw(own_code.Pd(fjr.single_link()), fjr.single_link())
    with pytest.raises(fjr.StateError, match="the law is written in Python; expected one made of expressions"):
        changed("paper_k31", law=AsSampledLaw(own))


class Unknown:
    n = 1


def test_omitted_parameters_are_listed() -> None:
    plain = parse_scenario("plain", "/**: {ros__parameters: {realtime_priority: 0}}")
    assert left_out(plain) == []
    more = "{measurement.velocity: observer, imperfections.actuator_lag: [0.01], publish_rate: 500.0}"
    assert left_out(parse_scenario("more", f"/**: {{ros__parameters: {more}}}")) == [
        "imperfections.actuator_lag",
        "measurement.velocity",
    ]


def test_exported_law_equals_the_law_of_the_node() -> None:
    """The node's tracker evaluates `measured_command`."""
    made = loop("two_link")
    n, rng = made.n, np.random.default_rng(1)
    position, velocity, jets = rng.normal(size=2 * n), rng.normal(size=2 * n), rng.normal(size=(5, n))
    u, V, _ = NumericFunction(made.functions["law"])(
        position, velocity, jets, made.law.gain_values, [], np.zeros(n), 0.0
    )
    expected = made.law.law.measured_command(position, velocity, jets)
    assert u == pytest.approx(expected[0])
    assert float(V[0]) == pytest.approx(expected[1])
