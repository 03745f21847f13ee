# SPDX-License-Identifier: Apache-2.0
"""The compiled closed loop of many runs gives the numbers of `simulate` for each run, independently of the others."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from core.oracles.cases import ARMS, Arm, linear
from core.oracles.chains import arm7, scaled_gains
from fjr_core import ParameterError, StateError
from fjr_core.numerics import jit as jit_cache
from fjr_core.runtime.library import c_text
from fjr_core.runtime.measurement_model import Measurement
from fjr_core.simulation.imperfections import Imperfections
from fjr_core.simulation.nonideal_plant import NonidealPlant
from fjr_design.batch import ClosedLoop, Draws, Outcomes, closed_loop, draws
from fjr_design.batch.closed_loop import FIELDS as OUTCOMES
from fuzzing import refused

PERIOD = 1e-3
AGREE = 1e-9
SINGLE, PLANAR = (ARMS[0], linear(1).gains), (ARMS[-1], linear(2).gains)
PLANAR_COUPLED = fjr.planar_two_link(input_gain=[[0.5, 0.5], [0.5, -0.5]]), linear(2).gains
LATE = [(*SINGLE, 0.3e-3), (*SINGLE, 2.6e-3), (*PLANAR, 0.0), (*PLANAR, 1e-3)]
LATE += [(arm7(), scaled_gains(arm7()).gains, 2.6e-3)]


def start(robot: fjr.Robot) -> Any:
    q_l = np.linspace(0.3, 0.1, robot.n)
    return robot.state(q_l, q_l, np.full(robot.n, 0.1), np.full(robot.n, -0.1))


def loop_of(robot: fjr.Robot, gains: fjr.Gains, duration: float = 0.3, **changes: Any) -> ClosedLoop:
    law = fjr.TrackingLaw(changes.pop("believed", robot), gains)
    reference = fjr.Sine(amplitude=np.full(robot.n, 0.4), frequency=3.0)
    values = {"settle_after": 0.1, **changes}
    return ClosedLoop(robot, law, reference, start(robot), duration, PERIOD, **values)


def paper_loop(**changes: Any) -> ClosedLoop:
    return loop_of(ARMS[0].robot, fjr.PAPER_GAINS, **changes)


def simulated(loop: ClosedLoop, delay: float = 0.0) -> fjr.Trajectory:
    plant, inner = fjr.Plant(loop.robot), PERIOD / loop.inner_steps
    return fjr.simulate(plant, loop.law, loop.reference, loop.x0, loop.duration, PERIOD, inner, delay)


def every_row(result: Outcomes) -> np.ndarray[Any, Any]:
    return np.column_stack([getattr(result, name) for name in OUTCOMES])


@pytest.mark.parametrize(("arm", "gains", "delay"), LATE, ids=lambda each: each.name if isinstance(each, Arm) else "")
def test_nominal_draws_agree_with_simulate(arm: Arm, gains: fjr.Gains, delay: float) -> None:
    loop = loop_of(arm.robot, gains, duration=0.15)
    result, recorded = loop.recorded(Draws(1, delay=delay))
    run = simulated(loop, delay)
    error = np.abs(run.x[:, : arm.n] - run.jets[:, 0])
    assert recorded.t == pytest.approx(run.t, abs=1e-15)
    assert recorded.x[0] == pytest.approx(run.x, rel=AGREE, abs=AGREE)
    assert recorded.u[0] == pytest.approx(run.u, rel=AGREE, abs=AGREE * np.abs(run.u).max())
    assert result.rms[0] == pytest.approx(np.sqrt(np.mean(error[100:] ** 2, axis=0)), rel=1e-9)
    assert result.peak[0] == pytest.approx(error[100:].max(axis=0), rel=1e-9)
    assert result.effort_peak[0] == pytest.approx(np.abs(run.u).max(axis=0), rel=1e-9)
    assert result.stable[0]


@pytest.mark.parametrize("settle_after", [0.0, PERIOD, 0.02])
def test_effort_noise_is_that_of_all_changes_from_the_settling_on(settle_after: float) -> None:
    result, recorded = paper_loop(duration=0.03, settle_after=settle_after).recorded(Draws(1, velocity_noise=0.1))
    changes = np.diff(recorded.u[0, :, 0])[max(round(settle_after / PERIOD), 1) - 1 :]
    assert result.effort_noise[0, 0] == pytest.approx(np.sqrt(np.mean(changes**2) / 2), rel=1e-12)


def test_power_is_that_of_the_torques_of_motors_that_the_input_matrix_couples() -> None:
    result, recorded = loop_of(*PLANAR_COUPLED, duration=0.2).recorded(Draws(1))
    dq_m = np.array([PLANAR_COUPLED[0].velocities(x)[1] for x in recorded.x[0]])
    torque = recorded.u[0] @ np.array([[0.5, 0.5], [0.5, -0.5]]).T
    assert result.power[0] == pytest.approx(np.abs((torque * dq_m).sum(axis=1)).mean(), rel=1e-12)


def test_final_error_settling_time_and_power_match_their_definitions() -> None:
    loop = paper_loop(duration=1.6, band=0.02)
    result, recorded = loop.recorded(Draws(1, link_torque=0.1))
    error = np.abs(recorded.x[0, :, 0] - loop.reference.jets(recorded.t)[:, 0, 0])
    assert result.final[0, 0] == pytest.approx(error[-1001:].mean(), rel=1e-12)
    outside = np.flatnonzero(error > 0.02)
    assert result.settling[0] == (np.inf if outside[-1] == 1600 else pytest.approx((outside[-1] + 1) * PERIOD))
    velocity = np.array([loop.robot.velocities(x)[1][0] for x in recorded.x[0]])
    assert result.power[0] == pytest.approx(np.abs(recorded.u[0, :, 0] * velocity).mean(), rel=1e-12)


def test_errors_are_held_against_the_limits_of_each_joint() -> None:
    loop = loop_of(PLANAR[0].robot, PLANAR[1])
    _, recorded = loop.recorded(Draws(1))
    error = np.abs(recorded.x[0, :, :2] - loop.reference.jets(recorded.t)[:, 0])
    first, second = (0.9 * error.max(axis=0)).tolist()
    settled, lost = replace(loop, band=[first, 1.0]).run(Draws(1)), replace(loop, lost=[1.0, second]).run(Draws(1))
    assert settled.settling[0] == pytest.approx(PERIOD * (1 + np.flatnonzero(error[:, 0] > first)[-1]))
    assert lost.lost_at[0] == pytest.approx(PERIOD * np.flatnonzero(error[:, 1] > second)[0])


def test_a_prismatic_joint_settles_and_is_lost_in_metres() -> None:
    robot = replace(PLANAR[0].robot, prismatic=(True, False))
    loop = loop_of(robot, PLANAR[1])
    assert (list(loop.band), list(loop.lost)) == ([0.002, 0.01], [0.3, np.pi / 2])


MANY = {
    "stiffness": np.linspace(0.7, 1.3, 7),
    "gravity": np.linspace(0.5, 1.5, 7),
    "delay": np.linspace(0, 3e-3, 7),
    "position_noise": np.where(np.arange(7) % 2, 1e-5, 0),
    "coulomb_l": np.where(np.arange(7) % 3, 0.05, 0),
}


def test_run_is_bit_identical_alone_and_among_others() -> None:
    loop = paper_loop()
    together = loop.run(Draws(7, **MANY))
    apart = [loop.run(Draws(7, **MANY).taken(part)) for part in (slice(0, 3), [3], [6, 5, 4])]
    rows = np.vstack([every_row(part) for part in apart])
    assert rows[[0, 1, 2, 3, 6, 5, 4]].tobytes() == every_row(together).tobytes()


def normals(seed: int, sample: int, n: int) -> np.ndarray[Any, Any]:
    """Return normal numbers (n, 4) by NumPy's Philox4x64-10 and Box-Muller."""
    drawn = np.vstack([draws.words((seed, 0), sample + (joint << 64), 1) for joint in range(n)])
    first, second = np.moveaxis(draws.unit(drawn).reshape(n, 2, 2), 2, 0)
    radius, angle = np.sqrt(-2 * np.log(1 - first)), 2 * np.pi * second
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=2).reshape(n, 4)


def test_noise_is_the_philox_generator_of_numpy() -> None:
    ffi, lib, _ = closed_loop.batch_library(1, 0)
    for seed, sample, n in ((0, 0, 1), (3, 17, 7), (2**64 - 1, 2**33, 2)):
        z = np.empty((n, 4))
        lib.fjr_noise(seed, sample, n, ffi.from_buffer("double[]", z))
        assert z == pytest.approx(normals(seed, sample, n), rel=1e-12, abs=1e-15)


def test_noise_is_white_with_unit_variance() -> None:
    z = np.array([normals(5, k, 2) for k in range(2000)]).reshape(2000, 8)
    assert z.mean(axis=0) == pytest.approx(0, abs=0.1)
    assert np.cov(z.T) == pytest.approx(np.eye(8), abs=0.1)
    assert np.mean(z[1:] * z[:-1], axis=0) == pytest.approx(0, abs=0.1)


def test_parameter_factors_equal_simulate_with_another_plant() -> None:
    """The oracle is a plant built with the multiplied parameters."""
    believed = fjr.single_link(stiffness=31.0)
    plant = fjr.single_link(31.0 * 0.8, link_inertia=0.031 * 1.3, gravity_torque=0.8 * 1.1, motor_inertia=0.004 * 0.9,
                            link_damping=0.2 * 0.5, motor_damping=0.007 * 2.0)  # fmt: skip
    factors = {"stiffness": 0.8, "link_inertia": 1.3, "gravity": 1.1, "motor_inertia": 0.9, "link_damping": 0.5,
               "motor_damping": 2.0}  # fmt: skip
    drawn = loop_of(believed, fjr.PAPER_GAINS).recorded(Draws(1, **factors))[1]
    law = fjr.TrackingLaw(believed, fjr.PAPER_GAINS)
    x0 = plant.state(0.3, 0.3, 0.1, -0.1)
    run = fjr.simulate(fjr.Plant(plant), law, fjr.Sine(0.4, 3.0), x0, 0.3, PERIOD)
    assert drawn.x[0] == pytest.approx(run.x, rel=AGREE, abs=AGREE)
    assert drawn.u[0] == pytest.approx(run.u, rel=AGREE, abs=AGREE)


def test_more_mass_of_one_link_is_that_of_an_arm_with_another_link() -> None:
    """The oracle is the arm built with the changed numbers, joint by joint in the order of the robot."""
    believed, values = fjr.planar_two_link(), {"link_mass": (1.2, 0.8 * 1.2), "link_inertia": (0.010, 0.005 * 1.2)}
    plant, gains = fjr.planar_two_link(**values), PLANAR[1]
    drawn = loop_of(believed, gains).recorded(Draws(1, link_mass=[[1.0, 1.2]]))[1]
    other = loop_of(plant, gains, believed=believed)
    run = simulated(other)
    assert drawn.x[0] == pytest.approx(run.x, rel=AGREE, abs=AGREE)
    bare = replace(believed, links=replace(believed.links, bodies=()))
    with pytest.raises(ParameterError, match="for an arm without bodies"):
        loop_of(bare, gains).run(Draws(1, link_mass=1.2))


FIELDS = {
    "stiffness": 0.9, "link_mass": 1.1, "link_inertia": 1.1, "gravity": 1.2, "motor_inertia": 1.1, "link_damping": 2.0,
    "motor_damping": 2.0, "coulomb_l": 0.05, "coulomb_m": 0.05, "link_torque": 0.1, "delay": 5e-4,
    "cubic": 500.0, "hysteresis": 0.2,
    "position_noise": 1e-4, "velocity_noise": 1e-3, "resolution": 1e-3, "effort_limit": 5.0,
}  # fmt: skip


@pytest.mark.parametrize("name", FIELDS)
def test_every_drawn_parameter_changes_the_run(name: str) -> None:
    result = paper_loop().run(Draws(2, **{name: [Draws(1).columns(name, 1)[0, 0], FIELDS[name]]}))
    assert result.rms[0] != result.rms[1]


@pytest.mark.parametrize("name", ["hysteresis", "cubic"])
def test_a_spring_of_another_shape_moves_as_in_the_plant_of_the_node(name: str) -> None:
    """The oracle is NonidealPlant, with sliders of its own, under the efforts that the run sent."""
    loop = paper_loop()
    values = {"cubic": 2000.0} if name == "cubic" else {"hysteresis": 0.2, "slip": 5e-3}
    recorded = loop.recorded(Draws(1, **values))[1]
    plant, parameters = NonidealPlant(fjr.Plant(loop.robot)), Imperfections(1, **values).vector
    x = recorded.x[0, 0]
    state = np.concatenate([x, [0.0], x[1:2] - x[:1]])
    for k, u in enumerate(recorded.u[0][:-1]):
        for _ in range(4):
            state = plant.step(state, u, [0.0], parameters, PERIOD / 4)
        assert state[:4] == pytest.approx(recorded.x[0, k + 1], rel=AGREE, abs=AGREE)
    assert np.abs(recorded.x[0][:, 1] - recorded.x[0][:, 0]).max() > 5e-3  # the element slips


def test_payload_position_smoothing_slip_and_seed_change_the_run() -> None:
    loop = paper_loop()
    base = {"payload_mass": 0.1, "payload_position": [0.2, 0, 0], "coulomb_l": 0.05, "position_noise": 1e-4,
            "hysteresis": 0.1}  # fmt: skip
    changes = [{}, {"payload_position": [0.3, 0, 0]}, {"smoothing": 0.05}, {"slip": 0.05}, {"seed": 3}]
    found = [float(loop.run(Draws(1, **{**base, **change})).rms[0, 0]) for change in changes]
    assert len(set(found)) == len(changes)


def test_diverging_run_ends_and_the_others_continue() -> None:
    result = paper_loop().run(Draws(3, delay=[0.0, 0.02, 0.0]))
    assert result.stable.tolist() == [True, False, True]
    assert result.lost_at[1] < 0.3
    assert np.isinf([result.rms[1, 0], result.peak[1, 0], result.settling[1], result.lost_at[0]]).all()
    assert result.rms[0] == result.rms[2]


MAKE: dict[type[fjr.FjrError], Callable[..., object]] = {
    ParameterError: lambda **values: paper_loop().run(Draws(3, **values)),
    StateError: paper_loop,
}
REFUSED: list[tuple[type[fjr.FjrError], dict[str, Any], str]] = [
    (ParameterError, {"stifness": 1.0}, "stifness is not drawn; expected some of "),
    (ParameterError, {"stiffness": 0.0}, "the minimum of stiffness is 0; expected positive"),
    (ParameterError, {"stiffness": [1.0, 1.0]}, "stiffness has shape (2,)"),
    (ParameterError, {"stiffness": np.ones((3, 2))}, "stiffness has shape (3, 2)"),
    (ParameterError, {"delay": -1e-3}, "the minimum of delay is -0.001; expected 0 or more"),
    (ParameterError, {"delay": np.ones((3, 1))}, "delay has shape (3, 1)"),
    (ParameterError, {"link_torque": np.nan}, "link_torque has entries that are not finite"),
    (ParameterError, {"gravity": "much"}, "gravity is 'much'; expected numbers"),
    (ParameterError, {"seed": [0.5, 1, 2]}, "seed is of float64"),
    (StateError, {"duration": 0.0}, "duration is 0.0 s; expected a positive"),
    (StateError, {"band": "wide"}, "band is 'wide'; expected numbers"),
    (StateError, {"lost": 0.0}, "lost is [0.0]; expected positive numbers"),
    (StateError, {"lost": [1.0, 1.0]}, "lost has shape (2,); expected a scalar or (1,)"),
    (StateError, {"settle_after": -0.1}, "settle_after is -0.1 s; expected 0 or more"),
    (StateError, {"settle_after": 0.3}, "settle_after is 0.3 s; expected less than --duration, 0.3 s"),
    (
        StateError,
        {"duration": 0.3004, "settle_after": 0.3002},
        "no sample of 0.001 s lies between settle_after, 0.30",
    ),
    (StateError, {"inner_steps": 0}, "inner_steps is 0; expected 1 or more"),
    (StateError, {"believed": ARMS[-1].robot}, "1, 2 and 1 joints; expected equal"),
    (StateError, {"settings": closed_loop.plain_settings(2)}, "settings has 2 joints; expected 1"),
    (StateError, {"measurement": Measurement(2)}, "measurement has 2 joints; expected 1"),
    (StateError, {"observer": fjr.VelocityObserver(ARMS[-1].robot, 150.0)}, "observer has 2 joints; expected 1"),
    (StateError, {"measurement": Measurement(1, "observer")}, "observer is None with a measurement without velocities"),
]


@pytest.mark.parametrize(("error", "given", "words"), REFUSED)
def test_invalid_draws_and_loops_are_refused_in_one_sentence(
    error: type[fjr.FjrError], given: dict[str, Any], words: str
) -> None:
    refused(error, lambda: MAKE[error](**given), words)


def test_fingerprint_covers_source_and_casadi(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found = [paper_loop().fingerprint, paper_loop().fingerprint]
    for name in ("a.py", "a.c", "b.c"):
        (tmp_path / name).write_text(name)
        jit_cache.source_digest.cache_clear()
        digest = jit_cache.source_digest(tmp_path)
        monkeypatch.setattr(jit_cache, "source_digest", lambda *_, digest=digest: digest)
        found.append(paper_loop().fingerprint)
        monkeypatch.undo()
    monkeypatch.setattr(jit_cache.ca, "__version__", "another")
    found.append(paper_loop().fingerprint)
    assert found[0] == found[1]
    assert len(set(found)) == len(found) - 1


def test_the_loop_in_c_compiles_without_warnings(tmp_path: Path) -> None:
    folder = Path(closed_loop.__file__).parent
    texts = [c_text(2, 3), "#define LANES 4", *((folder / name).read_text() for name in closed_loop.SOURCES)]
    (tmp_path / "loop.c").write_text("\n".join(texts))
    command = ["cc", "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-c", "loop.c"]
    subprocess.run(command, cwd=tmp_path, check=True, timeout=60)
