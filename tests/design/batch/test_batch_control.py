# SPDX-License-Identifier: Apache-2.0
"""A run of a study is controlled as the node controls: its samples give the control step in Python the same efforts."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from design.batch.test_batch import normals
from fjr_core.numerics.symbolic import NumericFunction
from fjr_core.robust.law import Robust, sampled_law
from fjr_core.runtime.control_step import ControlStep
from fjr_core.runtime.events import KINDS
from fjr_core.runtime.measurement_model import Measurement
from fjr_core.runtime.safety_settings import Settings
from fjr_design.batch import ClosedLoop, Draws, Outcomes, Recorded
from fjr_design.batch.parametric_robot import NAMES, ParametricPlant, vector

ARM = fjr.planar_two_link()
PERIOD, DURATION = 1e-3, 0.25
MOTION = fjr.Sine([0.4, 0.3], [3.0, 5.0])
ROBUST = [Robust(), Robust(residual_gain=30.0, delay=1.5e-3), Robust(integral_gain=20.0)]
MEASURED = [(None, Measurement(2)), (150.0, Measurement(2)), (100.0, Measurement(2, "observer", "torque", K=ARM.K)),
            (None, Measurement(2, gear_ratio=[-50.0, 80.0]))]  # fmt: skip


@cache
def law() -> fjr.TrackingLaw:
    return fjr.TrackingLaw(ARM, fjr.PAPER_GAINS, compile=True)


def random_settings(rng: np.random.Generator) -> Settings:
    """Return limits of which some act during a run, a start and a stop policy."""
    limits = {
        "effort": rng.uniform(5.0, 30.0, 2),
        "effort_rate": rng.uniform(300.0, 3000.0, 2),
        "link_velocity": rng.uniform(1.0, 3.0, 2),
        "tracking_error": rng.uniform(0.1, 0.5, 2),
        "deflection": rng.uniform(0.05, 0.3, 2),
        "start_error": 0.2,
    }
    chosen = {name: value for name, value in limits.items() if rng.uniform() < 0.4}
    start = {"ramp_time": rng.choice([0.0, 0.05]), "start_join_time": rng.choice([0.0, 0.1])}
    return Settings(("shoulder", "elbow"), **chosen, **start, on_stop=str(rng.choice(["zero", "gravity_hold"])))


def random_loop(seed: int) -> tuple[ClosedLoop, Draws, Robust]:
    rng = np.random.default_rng(seed)
    bandwidth, measurement = MEASURED[seed % len(MEASURED)]
    observer = None if bandwidth is None else fjr.VelocityObserver(ARM, bandwidth, compile=True)
    robust = ROBUST[seed % len(ROBUST)]
    x0 = ARM.state(*rng.uniform(-0.3, 0.3, (1, 2)).repeat(2, axis=0), *rng.uniform(-0.1, 0.1, (2, 2)))
    loop = ClosedLoop(
        ARM, sampled_law(law(), robust), MOTION, x0, DURATION, PERIOD, settle_after=0.1,
        settings=random_settings(rng), observer=observer, measurement=measurement,
    )  # fmt: skip
    draws = Draws(
        5, stiffness=rng.uniform(0.8, 1.2, 5), link_inertia=rng.uniform(0.8, 1.2, 5), link_torque=rng.uniform(-1, 1, 5),
        coulomb_m=rng.choice([0.0, 0.1], 5), smoothing=0.05,
        hysteresis=[0.0, 0.3, 0.0, 0.0, 0.0], slip=5e-3, payload_mass=rng.choice([0.0, 0.1], 5),
        payload_position=[0.1, 0, 0], delay=rng.choice([0.0, 0.4e-3, 1.7e-3], 5), effort_limit=rng.uniform(10, 50, 5),
        position_noise=rng.choice([0.0, 1e-5], 5), velocity_noise=rng.choice([0.0, 1e-3], 5), resolution=1e-6,
        seed=seed,
    )  # fmt: skip
    return loop, draws, robust


def replayed(loop: ClosedLoop, robust: Robust, limit: Any, measured: np.ndarray[Any, Any]) -> tuple[Any, ControlStep]:
    """Give the samples (s, 4n) of a run to the control step as the node has it; return the efforts (s, n)."""
    settings = loop.settings
    assert settings is not None
    within = {"effort": np.minimum(settings.effort, limit)}
    step = ControlStep(
        law(), MOTION, replace(settings, **within), loop.observer, True, robust, loop.measurement,
    )  # fmt: skip
    efforts = []
    for k, sample in enumerate(measured):
        stamp = round(k * PERIOD * 1e9)
        assert step.step(stamp, stamp, *np.split(sample, 4))
        efforts.append(step.u.copy())
    return np.array(efforts), step


def check_run(loop: ClosedLoop, step: ControlStep, u: Any, outcomes: Outcomes, sent: Any, i: int) -> None:
    assert u.tobytes() == sent.tobytes()
    events = [step.controller.journal.event[k] for k in range(step.controller.journal.events)]
    stops = [event for event in events if KINDS[event.kind] in ("stops", "starts refused")]
    assert len(stops) == (outcomes.cause[i] != "")
    for event in stops:
        assert outcomes.stopped[i] == pytest.approx(event.stamp * 1e-9, abs=1e-12)
        assert KINDS[max(event.detail, event.kind)].removeprefix("stops: ") == outcomes.cause[i]


def test_the_samples_of_a_run_give_the_control_step_the_same_efforts_to_the_last_bit() -> None:
    counts = np.zeros(len(KINDS))
    for seed in range(3, 18):  # each measurement with each option, and each event
        loop, draws, robust = random_loop(seed)
        outcomes, recorded = loop.recorded(draws)
        for i in (0, 3):
            samples = recorded.measured[i][np.isfinite(recorded.u[i]).all(axis=1)]
            u, step = replayed(loop, robust, draws.columns("effort_limit", 2)[i], samples)
            check_run(loop, step, u, outcomes, recorded.u[i][: len(samples)], i)
            counts += list(step.controller.journal.count)
    happened = {kind for kind, count in zip(KINDS, counts, strict=True) if count}
    assert happened >= {"stops: link velocity", "stops: tracking error", "stops: deflection", "starts refused",
                        "efforts saturated", "efforts rate limited"}  # fmt: skip


def expected_samples(x: Any, velocity: Any, draws: Draws, i: int) -> Any:
    """Return what the sensors of run i measure at the states x (s, 4n): noise of NumPy's Philox, then quantised."""
    seed = int(np.asarray(draws.seed)[i])
    z = np.array([normals(seed, k, 2) for k in range(len(x))])
    noise = np.concatenate([z[:, :, 0], z[:, :, 1]], axis=1), np.concatenate([z[:, :, 2], z[:, :, 3]], axis=1)
    position = x[:, :4] + draws.columns("position_noise", 2)[i] * noise[0]
    return np.round(position / 1e-6) * 1e-6, velocity + draws.columns("velocity_noise", 2)[i] * noise[1]


def check_motion(recorded: Recorded, draws: Draws, i: int) -> None:
    """Compare the motion with steps of the drawn plant in CasADi's virtual machine, and the samples with NumPy."""
    parts = {name: draws.columns(name, 2) for name in NAMES}
    parameters, plant = vector(parts)[i], ParametricPlant(ARM, "full").functions_as_c
    step, velocity = (NumericFunction(plant[f"full_{name}"]) for name in ("step", "velocity"))
    whole, late = divmod(draws.columns("delay", 2)[i, 0], PERIOD)
    sent = np.vstack([np.zeros((int(whole) + 1, 2)), recorded.u[i]])
    sliders = recorded.x[i, 0, 2:4] - recorded.x[i, 0, :2]
    for k, (x, x_next) in enumerate(zip(recorded.x[i], recorded.x[i][1:], strict=False)):
        x = np.append(x, sliders)
        for effort, length in ((sent[k], late), (sent[k + 1], PERIOD - late)):
            steps = int(np.ceil(length / (PERIOD / 4) - 1e-9))
            for _ in range(steps):
                x = step(x, effort, parameters, length / steps)[0]
        sliders = x[8:]
        assert x[:8] == pytest.approx(x_next, rel=1e-9, abs=1e-11)
    exact = np.array([velocity(x, parameters)[0] for x in recorded.x[i]])
    position, measured = expected_samples(recorded.x[i], exact, draws, i)
    assert recorded.measured[i, :, :4] == pytest.approx(position, abs=1e-12)
    assert recorded.measured[i, :, 4:] == pytest.approx(measured, abs=1e-9)


def test_a_run_moves_and_measures_as_drawn() -> None:
    loop, draws, _ = random_loop(0)
    plain = ClosedLoop(ARM, sampled_law(law()), MOTION, loop.x0, 0.05, PERIOD, settle_after=0.01)
    _, recorded = plain.recorded(draws)
    for i in range(5):
        check_motion(recorded, draws, i)


@pytest.mark.parametrize("policy", ["zero", "gravity_hold"])
def test_a_stopped_run_continues_under_its_stop_policy(policy: str) -> None:
    joint = fjr.single_link(stiffness=31.0)
    own, limit = fjr.TrackingLaw(joint, fjr.PAPER_GAINS), 2.0
    settings = Settings(("joint1",), link_velocity=limit, on_stop=policy)
    x0 = joint.state(0.5, 0.5, 0.0, 0.0)
    loop = ClosedLoop(joint, sampled_law(own), fjr.Sine(1.0, 3.0), x0, 2.0, PERIOD, lost=0.6, settings=settings)
    free = ClosedLoop(joint, sampled_law(own), fjr.Sine(1.0, 3.0), x0, 2.0, PERIOD, lost=0.6)
    outcomes, recorded = loop.recorded(Draws(1))
    q_l, q_m, dq_l, dq_m = recorded.measured[0].T
    first = int(np.argmax(np.abs(dq_l) > limit))
    assert (outcomes.cause[0], outcomes.stopped[0]) == ("link velocity", pytest.approx(first * PERIOD))
    assert recorded.u[0, :first].tobytes() == free.recorded(Draws(1))[1].u[0, :first].tobytes()
    hold = 0.8 * np.sin(q_l) - own.hold_damping[0, 0] * dq_m if policy == "gravity_hold" else 0 * q_l
    assert recorded.u[0, first:, 0] == pytest.approx(hold[first:], rel=1e-12, abs=1e-15)
    assert outcomes.stable[0]
    assert np.abs(recorded.x[0, :, 0] - np.sin(3.0 * recorded.t)).max() > 0.6  # a stopped arm is not lost
    assert (free.run(Draws(1)).cause[0], free.run(Draws(1)).stopped[0]) == ("", np.inf)


@pytest.mark.parametrize(("bandwidth", "measurement"), MEASURED[1:])
def test_observer_gear_and_torque_sensor_track_as_measured_positions_do(bandwidth: Any, measurement: Any) -> None:
    observer = None if bandwidth is None else fjr.VelocityObserver(ARM, bandwidth, compile=True)
    q = ARM.state([0.0, 0.0], [0.0, 0.0], [1.2, 1.5], [1.2, 1.5])
    loops = [
        ClosedLoop(ARM, sampled_law(law()), MOTION, q, 1.0, PERIOD, settle_after=0.5, observer=one, measurement=other)
        for one, other in ((None, None), (observer, measurement))
    ]
    exact, found = (loop.run(Draws(1)) for loop in loops)
    assert found.stable[0]
    assert found.peak[0] == pytest.approx(exact.peak[0], abs=2e-3)


def test_a_reference_in_python_gives_the_numbers_of_the_same_built_in_one() -> None:
    class Own:
        n = 2

        def jets(self, t: Any) -> Any:
            return MOTION.jets(t)

    x0 = ARM.state([0.1, 0.0], [0.1, 0.0], [0.0, 0.0], [0.0, 0.0])
    robust = sampled_law(law(), Robust(delay=1.5e-3))
    built_in, own = (
        ClosedLoop(ARM, robust, reference, x0, 0.05, PERIOD, settle_after=0.01).run(Draws(2, stiffness=[1.0, 1.1]))
        for reference in (MOTION, Own())
    )
    assert own.rms == pytest.approx(built_in.rms, rel=1e-9)
