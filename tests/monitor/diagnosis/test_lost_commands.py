# SPDX-License-Identifier: Apache-2.0
"""Commands that never reach the robot, which holds the last one: their share, and no fault of the robot for them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis import lost_commands
from fjr_monitor.diagnosis.diagnosis import diagnose
from fjr_monitor.diagnosis.online_diagnosis import OnlineDiagnosis
from fjr_monitor.diagnosis.record import Record
from fjr_monitor.diagnosis.thresholds import BLOCK
from fjr_monitor.diagnosis.verdict import Diagnosis
from monitor.diagnosis.loops import KNOWN, Certified, in_real_time, record_in_real_time

LAW = fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS, compile=True)
REFERENCE = fjr.Sine(1.0, 1.0)
START = LAW.robot.state(0.5, 0.5, 0.0, 0.0)
SAMPLES, LONGEST = 3000, 20
MODEL = {"stiffness": 31.0, "motor_damping": 7e-3, "input_gain": 1.0}


def bursts(seed: int, share: float, mean: float) -> set[int]:
    """Return samples in bursts of geometric length, up to LONGEST."""
    rng, lost, k = np.random.default_rng(seed), set[int](), 40
    while k < SAMPLES:
        k += int(rng.geometric(share / mean / (1 - share)))
        length = min(int(rng.geometric(1 / mean)), LONGEST)
        lost |= {*range(k, min(k + length, SAMPLES))}
        k += length
    return lost


def recorded(unheard: Collection[int], noise: float = 0.0, **robot: float) -> Record:
    """Return the record of a loop whose commands act at once, unless they are unheard."""
    how: dict[str, Any] = {"begins": lambda k: 0, "unheard": unheard, "noise": noise}
    return record_in_real_time(LAW, REFERENCE, START, SAMPLES, fjr.single_link(**{**MODEL, **robot}), **how)


def running(unheard: Collection[int]) -> Diagnosis:
    """Return the last verdict of the running controller."""
    certified = Certified(LAW)
    found = OnlineDiagnosis(LAW, (np.array([np.inf]), np.inf), certified)
    for k, *state in in_real_time(LAW, REFERENCE, START, SAMPLES, begins=lambda k: 0, unheard=unheard):
        certified.take(k * 1_000_000, *state, latency=KNOWN)
        if k:
            found.look(10.0)
        if k == SAMPLES // 2:
            found.verdict()
    return found.verdict()


@pytest.mark.parametrize(("share", "mean"), [(0.1, 8.0), (0.2, 5.0)])
def test_commands_lost_in_bursts_are_a_loss_and_no_fault_of_the_robot(share: float, mean: float) -> None:
    unheard = bursts(3, share, mean)
    verdict = diagnose(recorded(unheard), LAW)
    assert (verdict.kind, verdict.causes, verdict.findings) == ("degraded", ("loss",), ())
    assert 0.7 < verdict.figures["lost commands"] * SAMPLES / len(unheard) < 1.1
    assert "% of the commands never acted" in verdict.sentence
    late = [k for k in unheard if k >= SAMPLES / 2]
    verdict = running(unheard)
    assert (verdict.kind, verdict.causes) == ("degraded", ("loss",))
    assert 0.5 < verdict.figures["lost commands"] * SAMPLES / 2 / len(late) < 1.5


@pytest.mark.parametrize("measured", [False, True])
def test_by_the_measured_torque_every_lost_command_is_counted(measured: bool) -> None:
    unheard = bursts(4, 0.1, 8.0)
    seen = recorded(unheard)
    applied = [seen.u[0]]
    for k, u in enumerate(seen.u[:-1]):
        applied.append(applied[-1] if k in unheard else u)
    verdict = diagnose(replace(seen, u_applied=np.array(applied) if measured else None), LAW)
    assert verdict.causes == ("loss",)
    assert verdict.figures["lost commands"] == pytest.approx(len(unheard) / SAMPLES, rel=0.01 if measured else 0.3)


@pytest.mark.parametrize("noise", [0.0, 1e-4, 1e-3, 1e-2])
def test_in_a_healthy_loop_no_command_is_lost(noise: float) -> None:
    verdict = diagnose(recorded((), noise), LAW)
    assert (verdict.kind, verdict.findings, verdict.figures["lost commands"]) == ("holding", (), 0.0)


@pytest.mark.parametrize("lost", [set(), bursts(5, 0.1, 5.0)], ids=["all heard", "lost"])
@pytest.mark.parametrize(
    ("robot", "kind", "size"),
    [
        ({"motor_damping": 27e-3}, "viscous friction", 0.02),
        ({"stiffness": 27.0}, "stiffness", -12.9),
        ({"input_gain": 0.9}, "torque constant", -10.0),
    ],
)
def test_lost_commands_hide_no_fault_and_a_fault_is_no_lost_command(
    robot: dict[str, float], kind: str, size: float, lost: set[int]
) -> None:
    verdict = diagnose(recorded(lost, 1e-4, **robot), LAW)
    (finding,) = verdict.findings
    assert (finding.kind, verdict.causes) == (kind, ("model mismatch",))
    assert finding.size == pytest.approx(size, rel=0.05)
    assert verdict.figures["lost commands"] < len(lost) / SAMPLES + 0.02


def momentum(seed: int, lost: Collection[int], torque: Array, sigma: float) -> tuple[Array, Array]:
    """Return commands (k, 2), and what motion requires beyond them, for white noise sigma of the momentum."""
    rng = np.random.default_rng(seed)
    u = np.cumsum(rng.standard_normal((len(torque), 2)), axis=0)
    acting = u.copy()
    for k in sorted(lost):
        acting[k] = acting[k - 1]
    noise = sigma * rng.standard_normal((len(torque) + 1, 2))
    return u, acting - u + np.diff(noise, axis=0) + torque[:, None]


@pytest.mark.parametrize("torque", [0.0, 5.0])
def test_the_likeliest_sequence_is_that_of_the_lost_commands(torque: float) -> None:
    """Steps of 1 N m beside noise of 0.3: single commands may be missed, a constant torque changes nothing."""
    lost = {*range(60, 66), 100, 101, *range(200, 230), *range(300, 304)}
    u, e = momentum(1, lost, np.full(400, torque), 0.3)
    no = np.zeros(400)
    found, before = lost_commands.lost_commands(u, e, no, (lost_commands.noise_of(u, e), no))
    assert len({*np.flatnonzero(found)} ^ lost) <= 3
    held = [k for k in lost if found[k] and k - 1 in lost and found[k - 1]]
    assert all((before[k] == before[k - 1]).all() for k in held)


@pytest.mark.parametrize("begin", [0, 7])
def test_a_block_is_decoded_alike_in_any_part(begin: int) -> None:
    lost = {*range(200, 206), *range(230, 260), *range(300, 303)}
    u, e = momentum(2, lost, np.zeros(500), 0.3)
    no, noise = np.zeros(500), lost_commands.noise_of(u, e)
    whole, _ = lost_commands.lost_commands(u, e, no, (noise, no), begin)
    first = begin + 5 * BLOCK
    kept = slice(first - lost_commands.BEFORE - lost_commands.LONGEST - 1, first + 12 * BLOCK + lost_commands.AFTER)
    part, _ = lost_commands.lost_commands(u[kept], e[kept], no[kept], (noise, no[kept]), first - kept.start)
    blocks = slice(first - kept.start, first - kept.start + 12 * BLOCK)
    assert (part[blocks] == whole[first : first + 12 * BLOCK]).all()
    assert whole.sum() == pytest.approx(len(lost), abs=6)
