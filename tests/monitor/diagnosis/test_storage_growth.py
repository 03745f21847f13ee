# SPDX-License-Identifier: Apache-2.0
"""Short runs, growth of V and a high share of violated blocks are never diagnosed as "holding"."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import fjr_core as fjr
from fjr_core.monitoring.certificate import Certificate
from fjr_core.numerics.checks import Array
from fjr_monitor.diagnosis.causes import CauseErrors, StorageBudget
from fjr_monitor.diagnosis.diagnosis import diagnose
from fjr_monitor.diagnosis.online_diagnosis import OnlineDiagnosis
from fjr_monitor.diagnosis.record import Record
from fjr_monitor.diagnosis.thresholds import DIVERGED, EXCEEDED, FEWEST, JointTolerances
from fjr_monitor.diagnosis.verdict import BlockStatistics
from fuzzing import fuzzed
from monitor.diagnosis.loops import Certified, recorded

ROBOT = fjr.planar_two_link()
GAINS = fjr.Gains(
    Lambda_l=16.0,
    Pi_l=[[32.22, 4.272], [4.272, 4.229]],
    K_ld=[[1.697, 0.225], [0.225, 0.2227]],
    Lambda_m=16.0,
    Pi_m=[40.0, 25.0],
    K_md=[0.32, 0.16],
)
LAW = fjr.TrackingLaw(ROBOT, GAINS, compile=True)
BALANCE = Certificate(LAW)
REFERENCE = fjr.Sine([0.5, 0.7], [2.0, 3.0])
NOMINAL = ((1.0, 0.0), (0.0, 1.0))
WIRINGS = (NOMINAL, ((0.0, 1.0), (1.0, 0.0)), ((-1.0, 0.0), (0.0, 1.0)), ((1.0, 0.0), (0.0, -1.0)))


@cache
def record(
    samples: int,
    wiring: tuple[tuple[float, float], ...] = NOMINAL,
    delay: int = 0,
    stiffness: float = 1.0,
    offset: float = 0.3,
) -> Record:
    """Return the two-link arm for some samples, or until it has diverged.

    wiring: matrix from sent to acting efforts. delay: in samples. stiffness: ratio of plant to model.
    offset [rad]: of both joints at the start.
    """
    real, efforts = replace(ROBOT, K=stiffness * ROBOT.K), [np.zeros(2)] * delay

    def acting(u: Array) -> Array:
        efforts.append(u)
        return np.array(wiring) @ efforts.pop(0)

    start = real.state([offset] * 2, [offset] * 2, [0, 0], [0, 0])
    return recorded(LAW, REFERENCE, start, samples, real, acting=acting)


def growth(seen: Record) -> float:
    """Return the largest ratio of V to its lowest earlier value, with 1 mJ added for hold and tolerated error."""
    V = BALANCE.along(seen.position, seen.velocity, seen.jets).V
    return float((V / (np.minimum.accumulate(V) + 1e-3)).max())


def live(seen: Record) -> list[str]:
    """Return the kinds of the online diagnosis, one every 20 samples."""
    certified = Certified(LAW)
    running, kinds = OnlineDiagnosis(LAW, (seen.effort_limit, np.inf), certified), []
    for k in range(len(seen.t)):
        certified.take(k * 1_000_000, seen.position[k], seen.velocity[k], seen.jets[k], seen.u[k])
        if certified.count:
            running.look(5.0)
        if k % 20 == 19:
            kinds.append(running.verdict().kind)
    return kinds


@pytest.mark.parametrize("wiring", WIRINGS[1:])
def test_efforts_on_the_wrong_joint_or_with_the_wrong_sign_are_never_holding(
    wiring: tuple[tuple[float, float], ...],
) -> None:
    seen = record(83, wiring)
    assert growth(seen) > 1e3
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert diagnose(seen, LAW).kind == "violated"
        assert live(seen)[-1] == "violated"


@fuzzed(12)
@given(
    samples=st.integers(3, 130),
    wiring=st.sampled_from(WIRINGS),
    delay=st.integers(0, 12),
    stiffness=st.floats(0.2, 5.0),
    offset=st.floats(-1.0, 1.0),
)
def test_growth_of_V_is_never_holding(
    samples: int, wiring: tuple[tuple[float, float], ...], delay: int, stiffness: float, offset: float
) -> None:
    seen = record(samples, wiring, delay, round(stiffness, 1), round(offset, 1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        verdict, kinds = diagnose(seen, LAW), live(seen)
    if growth(seen) > 2 * EXCEEDED:
        assert verdict.kind in ("violated", "degraded", "unknown")
        assert "holding" not in kinds[-1:]
    if growth(seen) > 2 * DIVERGED:  # a diverging run of few blocks may raise its own floor, and is then unknown
        assert verdict.kind == "violated" or (verdict.kind == "unknown" and len(seen.t) <= 20 * FEWEST)
    assert verdict.kind != "holding" or len(seen.t) > 20 * FEWEST


def test_a_healthy_run_of_any_length_is_not_violated() -> None:
    for samples in (3, 30, 61, 130):
        kind = diagnose(record(samples), LAW).kind
        assert kind == ("holding" if samples > 20 * FEWEST else "unknown")


def concluded(count: int, above: int, grown: float = 1.0, error: float = 0.0) -> str:
    """Return the kind of diagnosis if the first blocks are violated by a delay that causes an error [rad]."""
    causes = np.zeros((count, 4))
    causes[:above, 2] = 1.0
    nothing = np.zeros(count)
    blocks = StorageBudget(causes, nothing, nothing, nothing, nothing, np.ones(count, dtype=bool))
    peaks = np.zeros((count, 4, 2))
    peaks[:above, 2] = error
    judged = BlockStatistics(0.9, JointTolerances.plain(2))
    none = np.zeros((count, 2))
    judged.add(blocks, CauseErrors(peaks, none, none, peaks.sum(axis=1)))
    return judged.conclude(grown, {}).kind


@given(count=st.integers(0, 300), share=st.floats(0, 1), grown=st.floats(0, 1e12), error=st.floats(0, 0.1))
def test_holding_requires_enough_blocks_a_small_share_and_no_growth(
    count: int, share: float, grown: float, error: float
) -> None:
    above = round(share * count)
    kind = concluded(count, above, grown, error)
    if kind == "holding":
        assert count >= FEWEST
        assert above <= 0.1 * count
        assert grown <= EXCEEDED
        assert not above or error <= 1e-3
    if grown > DIVERGED:
        assert kind == "violated"
    elif count >= FEWEST and above >= FEWEST and above > 0.3 * count:
        assert kind == ("degraded" if error <= 1e-3 else "violated")


def test_two_violated_blocks_of_four_do_not_hold() -> None:
    assert concluded(4, 2, error=1.0) == "violated"
    assert concluded(4, 1, error=1.0) == "unknown"
    assert concluded(100, 1, error=1e-6) == "holding"
    assert concluded(100, 1, error=1.0) == "violated"


@pytest.mark.parametrize("size", [1e100, np.inf])
def test_a_record_that_overflows_is_diagnosed_without_warning(size: float) -> None:
    """Neither the offline nor the online diagnosis emits a NumPy warning for numbers near the largest one."""
    seen = record(200)
    factor = np.geomspace(1.0, min(size, 1e300), len(seen.t))[:, None]
    factor[-1] = size
    broken = replace(seen, position=seen.position * factor, velocity=seen.velocity * factor, u=seen.u * factor)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert diagnose(broken, LAW).kind != "holding"
        assert live(broken)[-1] != "holding"
