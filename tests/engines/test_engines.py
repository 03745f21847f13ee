# SPDX-License-Identifier: Apache-2.0
"""Engines move the robot of eq. (36): each, SciPy and the plant's own integrator agree, with each imperfection."""

from __future__ import annotations

import builtins
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import fjr_core as fjr
import robot_survey
from core.oracles.chains import random_urdf
from fjr_core.errors import PIP, FjrError
from fjr_core.simulation.imperfections import Imperfections
from fjr_msgs_py.scenarios.library import load
from fjr_plant.engine import engine_kind
from fjr_plant.simulated_robot import SimulatedRobot
from system.executables import fjr_here
from system.shared_runs import record

Array = NDArray[Any]
WHEELS = {"mujoco": "mujoco", "drake": "pydrake"}
ORDERS = {"mujoco": (3.5, 4.7), "drake": (4.5, 5.7)}
MISSING = {
    name: pytest.mark.skipif(find_spec(wheel) is None, reason=f"{name} is not installed")
    for name, wheel in WHEELS.items()
}
engines = pytest.mark.parametrize("engine", [pytest.param(name, marks=mark) for name, mark in MISSING.items()])
INNER = 250_000  # ns
SAMPLE = 1_000_000  # ns
"""Inner step and sample period."""


def chain() -> fjr.Robot:
    """Return three joints of a random URDF in another order than along the chain; one slides, gravity is oblique."""
    case = random_urdf(3, seed=4)
    K, M_m = (400.0, 900.0, 200.0), (0.3, 0.5, 0.2)
    robot = fjr.robot_from_urdf(case.xml, case.joints, K, M_m, 0.4, 0.2, case.gravity, locked=case.locked)
    assert any(robot.prismatic)
    assert robot.links.order != (0, 1, 2)
    return robot


MADE = [fjr.single_link(), chain()]
robots = pytest.mark.parametrize("robot", MADE, ids=["single_link", "chain"])


def moved(
    robot: fjr.Robot,
    engine: str = "own",
    imperfections: Imperfections | None = None,
    inner_step: int = INNER,
    plant: fjr.Plant | None = None,
) -> SimulatedRobot:
    """Return a simulated robot that moves at the start."""
    k = np.arange(1, robot.n + 1)
    x0 = robot.state(0.4 / k, 0.45 / k, 0.3 * k, -0.2 * k)
    joints, kind = [f"a{k}" for k in range(robot.n)], engine_kind({"engine": engine, "lockstep": True})
    return SimulatedRobot(plant or fjr.Plant(robot), x0, inner_step, imperfections, engine=kind, joints=joints)


def run(simulated: SimulatedRobot, samples: int = 100, external: float = 0.0) -> Array:
    """Return the measurements (k, 6n) of each sample under varying efforts and external torques."""
    rows, begin, n = [], simulated.time // SAMPLE, len(simulated.u)
    for k in range(begin, begin + samples):
        simulated.u = 2 * np.sin(0.05 * k + np.arange(n))
        simulated.external = np.full(n, external * np.cos(0.03 * k))
        simulated.advance_to((k + 1) * SAMPLE)
        rows.append(np.concatenate(simulated.measure()))
    return np.array(rows)


@engines
@pytest.mark.parametrize("robot", [*MADE, load("arm7").plant.robot], ids=["single_link", "chain", "arm7"])
def test_motion_converges_to_the_solution_of_eq_36_with_the_order_of_the_integrator(
    robot: fjr.Robot, engine: str
) -> None:
    """Under a constant effort, by SciPy's method of order 8 from the Hamiltonian form; arm7 has stiffer springs."""
    plant, u, errors = fjr.Plant(robot), np.linspace(0.5, 1.5, robot.n), []
    coarse = 8 * INNER if robot.n < 7 else 2 * INNER
    for inner_step in (coarse, coarse // 2, INNER // 10):
        simulated = moved(robot, engine, inner_step=inner_step)
        start = simulated.x
        simulated.u = u
        simulated.advance_to(96 * SAMPLE)
        exact = solve_ivp(lambda _, x: plant.derivative(x, u), (0, 0.096), start, "DOP853", rtol=1e-12, atol=1e-13)
        errors.append(np.max(np.abs(simulated.x - exact.y[:, -1])))
    low, high = ORDERS[engine]
    assert low < np.log2(errors[0] / errors[1]) < high
    assert errors[2] < 2e-8


@engines
@robots
def test_all_imperfections_act_as_in_the_own_plant(robot: fjr.Robot, engine: str) -> None:
    """Two integrators of the same equation in other coordinates; short steps resolve the corner of friction."""
    k = 1 + 0.3 * np.arange(robot.n)
    bad = Imperfections(
        robot.n,
        coulomb_l=0.1 * k,
        static_m=0.15 * k,
        load_m=0.05 * k,
        smoothing=0.2 * k,
        cubic=40 * k,
        hysteresis=0.1 * k,
        slip=0.3 / k,
        ripple=0.07 * k,
        effort_limit=1.5 * k,
        lag=0.004 * k,
        payload_mass=0.3,
        payload_position=(0.1, -0.05, 0.03),
    )
    seen, expected = (run(moved(robot, each, bad, INNER // 8), external=0.5) for each in (engine, "own"))
    np.testing.assert_allclose(seen, expected, rtol=1e-6, atol=1e-6)
    assert np.max(np.abs(seen - run(moved(robot, engine), external=0.5))) > 0.01


@engines
@robots
def test_payload_is_attached_and_released_without_a_jump_of_the_motion(robot: fjr.Robot, engine: str) -> None:
    simulated, other = moved(robot, engine), moved(robot)
    for mass in (0.0, 0.4, 0.0):
        bad, before = Imperfections(robot.n, payload_mass=mass, payload_position=(0.1, 0.0, 0.02)), simulated.measure()
        for each in (simulated, other):
            each.change(bad)
        np.testing.assert_allclose(simulated.measure()[1], before[1], rtol=1e-10)
        np.testing.assert_allclose(run(simulated, 20), run(other, 20), rtol=1e-6, atol=1e-7)


@engines
def test_run_after_a_reset_is_bit_identical(engine: str) -> None:
    simulated = moved(fjr.planar_two_link(), engine)
    first = run(simulated)
    simulated.reset()
    assert np.array_equal(run(simulated), first)


@engines
def test_two_robots_in_one_process_do_not_disturb_each_other(engine: str) -> None:
    one, two = moved(fjr.planar_two_link(), engine), moved(fjr.single_link(), engine)
    alone = run(moved(fjr.planar_two_link(), engine), 40)
    interleaved = []
    for _ in range(40):
        interleaved.append(run(one, 1)[0])
        run(two, 1)
    assert np.array_equal(interleaved, alone)


@engines
def test_state_that_is_not_finite_ends_the_motion_with_its_reason(engine: str) -> None:
    simulated = moved(fjr.planar_two_link(), engine)
    simulated.u = np.full(2, 1e200)
    with pytest.raises(FjrError, match="is not finite after .* s: the motion diverged"):
        simulated.advance_to(10 * SAMPLE)
    simulated.reset()
    assert np.isfinite(run(simulated, 10)).all()


REFUSED = {
    "M_m is": fjr.Plant(fjr.planar_two_link(motor_inertia=[[0.02, 0.001], [0.001, 0.01]])),
    "expected plant.type: flexible_joint and integrator: rk4": fjr.Plant(fjr.single_link(), "implicit_midpoint"),
}


@engines
@pytest.mark.parametrize("sentence", REFUSED)
def test_what_an_engine_cannot_express_is_refused_in_one_sentence(sentence: str, engine: str) -> None:
    plant = REFUSED[sentence]
    with pytest.raises(FjrError, match=sentence) as refused:
        moved(plant.robot, engine, plant=plant)
    assert "; expected" in str(refused.value)


@pytest.mark.parametrize("engine", WHEELS)
def test_missing_engine_is_refused_before_the_run_with_the_command_that_installs_it(
    engine: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = builtins.__import__

    def without(name: str, *args: Any, **kwargs: Any) -> Any:
        if name.partition(".")[0] == WHEELS[engine]:
            raise ModuleNotFoundError(f"No module named '{name}'", name=name)
        return real(name, *args, **kwargs)

    for name in [name for name in sys.modules if name.startswith("fjr_engines")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(builtins, "__import__", without)
    said = fjr_here("run", "paper_k31", "--engine", engine, "--lockstep", code=2)
    assert said.endswith(f"is not installed; expected it from: {PIP} {engine}\n")


@MISSING["drake"]
def test_engine_in_python_is_refused_in_real_time() -> None:
    with pytest.raises(FjrError, match="'drake' in real time; expected lockstep: true"):
        engine_kind({"engine": "drake", "lockstep": False})


@pytest.mark.system
@engines
def test_loop_of_the_survey_is_lock_step_to_the_last_bit(engine: str, tmp_path: Path) -> None:
    run = record("two_link", 0.2, tmp_path, f"engine:={engine}", "compile:=false")
    motion = robot_survey.moved_by(engine, "two_link", inner_steps=4, duration=0.2)
    samples = min(len(run.t), len(motion.positions))
    assert samples > 150
    assert np.array_equal(run.q_l[:samples], motion.positions[:samples, :2])


@pytest.mark.system
@MISSING["drake"]
def test_table_counts_the_scenarios_in_which_all_engines_agree() -> None:
    found = robot_survey.compared("paper_k3p1", duration=0.1)
    other = {**found, "differences": [1e-9, 1e-9, 1.1e-6]}
    said, *_, row = robot_survey.engine_table({"paper_k3p1": found, "other": other})
    assert "In 1 of 2 scenarios" in said
    assert row.startswith("| other | 1 | 4 | 1.0e-09 | 1.0e-09 | 1.1e-06 |")
    assert row.endswith("| 255.762 |")
