# SPDX-License-Identifier: Apache-2.0
"""Online diagnosis of a loop in real time, in which commands arrive within the sample with varying latency."""

from __future__ import annotations

import numpy as np
import pytest

import fjr_core as fjr
from fjr_monitor.diagnosis.online_diagnosis import WINDOW, Latency, OnlineDiagnosis
from fjr_monitor.diagnosis.thresholds import JointTolerances
from fjr_monitor.diagnosis.verdict import Diagnosis
from monitor.diagnosis.loops import KNOWN, Certified, in_real_time

PERIOD, BETA = 1e-3, 10.0
LAW = fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS, compile=True)
REFERENCE = fjr.Sine(1.0, 1.0)


def run(seconds: float, known: bool = True, late: int = 0, tolerance: float = 1e-3, **robot: float) -> list[Diagnosis]:
    """Diagnose once per second; `known`: latency of each command is known; `late`: additional delay in samples."""
    real = fjr.single_link(**robot)
    plant, x = fjr.Plant(real), real.state(0.5, 0.5, 0.0, 0.0)
    certified = Certified(LAW)
    axes = JointTolerances(("joint1",), ("rad",), np.array([tolerance]))
    running = OnlineDiagnosis(LAW, (np.array([np.inf]), np.inf), certified, axes)
    latencies = np.random.default_rng(7).uniform(0.15e-3, 0.5e-3, int(seconds / PERIOD))
    efforts, verdicts = [np.zeros(1)] * (late + 2), []
    for k, latency in enumerate(latencies):
        velocity, jets = np.concatenate(real.velocities(x)), REFERENCE.jets(k * PERIOD)
        u, _ = LAW.measured_command(x[:2], velocity, jets)
        efforts.append(u)
        certified.take(k * 1_000_000, x[:2], velocity, jets, u, latency=latency if known else 0.0)
        if k:
            running.look(BETA)
        x = plant.step(x, efforts[-2 - late], latency)
        x = plant.step(x, efforts[-1 - late], PERIOD - latency)
        if (k + 1) % round(1 / PERIOD) == 0:
            verdicts.append(running.verdict())
    return verdicts


def test_loop_with_known_latency_within_a_sample_is_holding() -> None:
    assert [verdict.kind for verdict in run(2.0)] == ["holding"] * 2
    assert [verdict.kind for verdict in run(2.0, tolerance=1e-9)] == ["holding"] * 2
    assert "holding" not in [verdict.kind for verdict in run(2.0, known=False)]


def test_efforts_late_by_whole_samples_are_a_delay() -> None:
    for verdict in run(2.0, late=2):
        assert (verdict.kind, verdict.causes) == ("degraded", ("delay",))
        assert verdict.figures["effort age"] == pytest.approx(2 * PERIOD, abs=0.6 * PERIOD)


def test_wrong_plant_parameter_is_a_model_mismatch() -> None:
    assert [verdict.causes for verdict in run(2.0, stiffness=22.0)] == [("model mismatch",)] * 2


def test_states_that_wait_for_a_paused_controller_are_a_delay() -> None:
    """Each 0.1 s it answers none for 25 ms, then all at once; in between each within half a sample."""
    plant, x = fjr.Plant(LAW.robot), LAW.robot.state(0.5, 0.5, 0.0, 0.0)
    certified, axes = Certified(LAW), JointTolerances(("joint1",), ("rad",), np.array([1e-3]))
    running = OnlineDiagnosis(LAW, (np.array([np.inf]), np.inf), certified, axes)
    waiting, acting = [], np.zeros(1)
    for k, usual in enumerate(np.random.default_rng(7).uniform(0.15e-3, 0.5e-3, 2000)):
        velocity, jets = np.concatenate(LAW.robot.velocities(x)), REFERENCE.jets(k * PERIOD)
        u, _ = LAW.measured_command(x[:2], velocity, jets)
        paused = max(0, 25 - (k - 20) % 100) if k >= 20 else 0
        latency = paused * PERIOD or usual
        certified.take(k * 1_000_000, x[:2], velocity, jets, u, latency=latency)
        waiting.append(u)
        if k:
            running.look(BETA)
        if paused != 1 and paused:
            x = plant.step(x, acting, PERIOD)
            continue
        x = plant.step(x, acting, min(latency, PERIOD))
        acting, waiting = waiting[-1], []
        x = plant.step(x, acting, PERIOD - latency) if latency < PERIOD else x
    assert running.verdict().causes == ("delay",)


@pytest.mark.parametrize(("friction", "seen"), [(0.2, set()), (0.21, {"model mismatch"})])
def test_states_that_a_late_robot_leaves_out_are_no_model_mismatch(friction: float, seen: set[str]) -> None:
    """It leaves out up to four states in a row, through which the older effort acts, and takes efforts over late."""
    rng, certified, real = np.random.default_rng(2), Certified(LAW), fjr.single_link(link_damping=friction)
    running = OnlineDiagnosis(LAW, (np.array([np.inf]), np.inf), certified)
    lost: set[int] = set()
    for k in rng.integers(50, 4900, 16).tolist():
        for count in rng.integers(1, 5, 4).tolist():
            lost, k = lost | {*range(k, k + count)}, k + count + 1
    begins, start = rng.integers(1, 4, 5000).tolist(), LAW.robot.state(0.5, 0.5, 0.0, 0.0)
    verdicts: list[Diagnosis] = []
    for k, *state in in_real_time(LAW, REFERENCE, start, 5000, real, lost, begins.__getitem__):
        certified.take(k * 1_000_000, *state, latency=KNOWN)
        if k:
            running.look(BETA)
        if k // 1000 > len(verdicts):
            verdicts.append(running.verdict())
    for verdict in verdicts:
        assert {*verdict.causes} & {"model mismatch"} == seen, verdict.sentence


def test_a_verdict_ends_with_the_states_it_is_about() -> None:
    plant, x, certified = fjr.Plant(LAW.robot), LAW.robot.state(0.5, 0.5, 0.0, 0.0), Certified(LAW)
    running = OnlineDiagnosis(LAW, (np.array([np.inf]), np.inf), certified)

    def moved(x: np.ndarray, begin: int) -> np.ndarray:
        for k in range(begin, begin + 300):
            velocity, jets = np.concatenate(LAW.robot.velocities(x)), REFERENCE.jets(k * PERIOD)
            u, _ = LAW.measured_command(x[:2], velocity, jets)
            certified.take(k * 1_000_000, x[:2], velocity, jets, u)
            running.look(BETA, int(k > begin))
            x = plant.step(x, u, PERIOD)
        return x

    x = moved(x, 0)
    assert running.verdict().kind == "holding"
    silent = running.verdict()
    assert (silent.kind, silent.sentence) == ("unknown", "no diagnosis: too few states with a command of the law")
    certified.forget()
    certified.restart()
    moved(x, 300)
    assert running.verdict().kind == "holding"


@pytest.mark.parametrize("offset", [0, 5_000_000_000, -5_000_000_000])
def test_latency_does_not_depend_on_the_clock_offset(offset: int) -> None:
    latency, delays = Latency(), [120_000, 100_000, 250_000, 100_000]
    found = [
        latency.of(k * 1_000_000, k * 1_000_000 + way + offset, k * 1_000_000 + way + offset + 50_000)
        for k, way in enumerate(delays)
    ]
    assert found == pytest.approx([50e-6, 50e-6, 200e-6, 50e-6])


def test_the_clock_offset_is_estimated_again_when_it_grows() -> None:
    latency = Latency()
    for k in range(3 * WINDOW):
        jump = 3_000_000 if k >= WINDOW else 0
        last = latency.of(k, k + 100_000 + jump, k + 100_000 + jump)
    assert last == 0.0
    latency.forget()
    assert latency.of(0, 7, 9) == pytest.approx(2e-9)
