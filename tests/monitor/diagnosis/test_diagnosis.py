# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of simulated runs: each cause alone, with and without measured torque, its error, insufficient data."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.numerics.checks import Array
from fjr_core.runtime.events import Finding
from fjr_core.stability.linearization import linearize
from fjr_monitor.diagnosis.causes import closed_loop
from fjr_monitor.diagnosis.delay_estimation import needed
from fjr_monitor.diagnosis.diagnosis import diagnose, innovations, with_findings
from fjr_monitor.diagnosis.record import Record
from fjr_monitor.diagnosis.thresholds import JointTolerances
from fjr_monitor.diagnosis.verdict import Diagnosis
from fjr_msgs_py.scenarios import library
from fuzzing import refused
from monitor.diagnosis.loops import PERIOD, recorded

DURATION = 2.5
LAW = fjr.TrackingLaw(fjr.single_link(), fjr.PAPER_GAINS, compile=True)
REFERENCE = fjr.Sine(1.0, 1.0)


@cache
def record(delay: float = 0.0, measured: bool = False, **robot: float) -> Record:
    """Record a sampled run of the paper's joint; `robot`: parameters of the plant that the law does not know."""
    real = fjr.single_link(**robot)
    x0 = real.state(0.5, 0.5, 0.0, 0.0)
    run = fjr.simulate(fjr.Plant(real), LAW, REFERENCE, x0, DURATION, PERIOD, delay=delay)
    velocity = np.array([np.concatenate(real.velocities(x)) for x in run.x])
    time_shifted = np.vstack([np.zeros((1, 1)), run.u[:-1]])
    return Record(
        t=run.t,
        position=run.x[:, :2],
        velocity=velocity,
        jets=run.jets,
        u=run.u,
        u_applied=time_shifted if measured else None,
        sent=None,
        answered=None,
        sample_period=PERIOD,
        effort_limit=np.array([np.inf]),
    )


@cache
def verdict_of(delay: float = 0.0, measured: bool = False, **robot: float) -> Diagnosis:
    """Diagnose `record` of the same arguments."""
    return diagnose(record(delay, measured, **robot), LAW)


def test_a_record_of_lists_is_that_of_arrays_and_one_of_words_is_refused() -> None:
    seen = record()
    lists = replace(seen, **{name: values.tolist() for name, values in seen.columns.items()}, effort_limit=[np.inf])
    assert diagnose(lists, LAW) == verdict_of()
    assert replace(lists, u=seen.u).u is seen.u
    refused(fjr.StateError, lambda: replace(seen, u=[["a"]] * len(seen)), "u is [['a'], ", "expected numbers")


def test_what_cannot_be_diagnosed_is_refused_in_one_sentence() -> None:
    of_two = fjr.TrackingLaw(fjr.planar_two_link(), fjr.PAPER_GAINS)
    refused(fjr.StateError, lambda: diagnose(record(), of_two), "record and law have 1 and 2 joints; expected equal")
    refused(fjr.StateError, lambda: diagnose(record(), LAW.robot), "law is a Robot; expected v-dPBC")
    refused(fjr.StateError, lambda: diagnose(record().u, LAW), "record is a ndarray; expected a fjr.Record")


@pytest.mark.parametrize("known", [slice(50, 150), np.arange(2501) % 208 > 0], ids=["a short time", "not at some"])
def test_a_run_whose_reference_is_known_at_few_states_is_diagnosed(known: Any) -> None:
    jets = np.full_like(record().jets, np.nan)
    jets[known] = record().jets[known]
    assert diagnose(replace(record(), jets=jets), LAW).kind == "holding"


def test_exact_model_predicts_the_next_state() -> None:
    found = innovations(record(), LAW)
    assert np.abs(found.error).max() <= 1e-11
    assert np.abs(found.V1 - found.predicted).max() <= 1e-11
    assert np.abs(needed(found, LAW.robot) - found.sent).max() <= 1e-7


@pytest.mark.parametrize("measured", [False, True])
def test_healthy_run_is_holding(measured: bool) -> None:
    verdict = verdict_of(measured=measured)
    assert (verdict.kind, verdict.causes) == ("holding", ())
    assert verdict.figures["violated share"] == 0.0
    assert verdict.figures["spectral radius"] < 1
    assert max(error.max() for error in verdict.errors.values()) < 1e-9


@pytest.mark.parametrize("delay", [0.7e-3, 4e-3])
def test_delay_is_detected_and_estimated_from_the_motion(delay: float) -> None:
    verdict = diagnose(record(delay=delay), LAW)
    assert (verdict.kind, verdict.causes) == ("degraded", ("delay",))
    assert verdict.figures["effort age"] == pytest.approx(delay, abs=0.02 * PERIOD)


@pytest.mark.parametrize(
    ("more", "known", "kind", "cause"),
    [(0.0, 0.2e-3, "holding", ""), (0.0, 0.3e-3, "holding", ""), (2e-3, 0.2e-3, "degraded", "delay")],
)
def test_known_latency_within_a_sample_is_holding_and_more_is_a_delay(
    more: float, known: float, kind: str, cause: str
) -> None:
    """In real time the previous effort acts until the new one arrives; known send times account for that.

    The age of the effort, as the delay margin, counts from the state.
    """
    late = record(delay=0.2e-3 + more)
    verdict = diagnose(replace(late, sent=late.t, answered=late.t + known), LAW)
    assert (verdict.kind, *verdict.causes) == (kind, *([cause] if cause else []))
    assert verdict.figures["effort age"] == pytest.approx(0.2e-3 + more, abs=0.06 * PERIOD)


def test_a_latency_that_is_not_known_is_a_delay_and_a_known_one_hides_no_mismatch() -> None:
    assert verdict_of(delay=0.2e-3).causes == ("delay",)
    other = record(delay=0.2e-3, stiffness=29.0)
    assert diagnose(replace(other, sent=other.t, answered=other.t + 0.2e-3), LAW).causes[0] == "model mismatch"


@pytest.mark.parametrize("measured", [False, True])
def test_an_effort_that_acts_before_its_known_latency_is_no_fault_of_the_robot(measured: bool) -> None:
    """A plant in real time applies a command from its last inner step on: the middleware's times are later."""
    soft = fjr.TrackingLaw(fjr.single_link(stiffness=3.1), fjr.PAPER_GAINS)
    seen = run(soft)
    applied = np.vstack([seen.u[:1], seen.u[:-1]]) if measured else None
    verdict = diagnose(replace(seen, sent=seen.t, answered=seen.t + 0.09e-3, u_applied=applied), soft)
    assert (verdict.kind, verdict.findings) == ("holding", ())


def test_missing_states_are_a_loss() -> None:
    """Every second state is missing, so each effort is held for two periods."""
    real = fjr.simulate(fjr.Plant(LAW.robot), LAW, REFERENCE, LAW.robot.state(0.5, 0.5, 0, 0), DURATION, 2 * PERIOD)
    velocity = np.array([np.concatenate(LAW.robot.velocities(x)) for x in real.x])
    seen = replace(record(), t=real.t, position=real.x[:, :2], velocity=velocity, jets=real.jets, u=real.u)
    verdict = diagnose(seen, LAW)
    assert (verdict.kind, verdict.causes) == ("degraded", ("loss",))
    assert verdict.figures["gaps"] == len(real.t) - 1


def run(law: fjr.TrackingLaw = LAW, **faults: Any) -> Record:
    """Record the loop with faults of sensors or efforts (loops.recorded)."""
    return recorded(law, REFERENCE, law.robot.state(0.5, 0.5, 0.0, 0.0), round(DURATION / PERIOD), **faults)


@cache
def looped(noise: float = 0.0, limit: float = np.inf) -> Record:
    """Run the loop with white velocity noise [rad/s] and the effort saturated at the limit [N m]."""
    rng = np.random.default_rng(7)
    noisy = lambda q, dq: (q, dq + noise * rng.standard_normal(2))  # noqa: E731
    return run(sensed=noisy, commanded=lambda u: np.clip(u, -limit, limit), limit=limit)


def test_effort_at_its_limit_is_saturation() -> None:
    verdict = diagnose(looped(limit=0.7), LAW)
    assert (verdict.kind, verdict.causes) == ("violated", ("saturation",))
    assert diagnose(looped(limit=30.0), LAW).kind == "holding"


def test_efforts_other_than_those_of_the_law_are_no_violation() -> None:
    """Without a known limit the saturated efforts are those of another source, under which V need not decay."""
    seen = looped(limit=0.7)
    assert diagnose(replace(seen, effort_limit=np.array([np.inf])), LAW).kind == "holding"


def test_sensor_noise_is_no_violation() -> None:
    assert [diagnose(looped(noise=noise), LAW).kind for noise in (1e-4, 1e-2)] == ["holding"] * 2


@pytest.mark.parametrize(("bits", "kind", "causes"), [(18, "holding", ()), (16, "violated", ("noise",))])
def test_coarse_encoders_are_noise_and_no_model_mismatch(bits: int, kind: str, causes: tuple[str, ...]) -> None:
    """The slow loop answers the low frequencies of the noise, which do not average out within a block."""
    arm = library.load("arm7", [])
    coarse, start = 2 * np.pi / 2**bits, arm.plant.robot.state(*np.split(arm.x0[:14], 2), np.zeros(7), np.zeros(7))
    seen = recorded(arm.law, arm.reference, start, 1800, sensed=lambda q, dq: (coarse * np.round(q / coarse), dq))
    verdict = diagnose(seen, arm.law)
    assert (verdict.kind, verdict.causes) == (kind, causes), verdict.sentence


def test_effort_at_its_largest_rate_is_saturation() -> None:
    last = np.zeros(1)

    def slow(u: np.ndarray) -> np.ndarray:
        last[:] = np.clip(u, last - 0.02, last + 0.02)
        return last.copy()

    seen = run(commanded=slow)
    assert diagnose(seen, LAW).kind == "unknown"
    assert diagnose(replace(seen, effort_rate=20.0), LAW).causes == ("saturation",)


@pytest.mark.parametrize(("error", "said"), [(0.0993, "99 mrad"), (0.0997, "0.1 rad"), (0.25, "0.25 rad")])
def test_errors_of_about_100_mrad_are_written_without_a_power_of_ten(error: float, said: str) -> None:
    assert JointTolerances.plain(1).largest(np.array([error])) == f"{said} at joint1"


def test_an_empty_record_has_no_state() -> None:
    assert "no state with a command" in diagnose(record().rows(slice(0)), LAW).sentence


def test_insufficient_data_give_unknown_with_a_reason() -> None:
    whole = record()
    nothing = np.full_like(whole.velocity, np.nan)
    assert "no velocities" in diagnose(replace(whole, velocity=nothing), LAW).sentence
    unanswered = diagnose(replace(whole, u=np.full_like(whole.u, np.nan)), LAW)
    assert (unanswered.kind, unanswered.causes) == ("unknown", ())
    few = {name: getattr(whole, name)[:30] for name in ("t", "position", "velocity", "jets", "u")}
    assert "29 intervals between states" in diagnose(replace(whole, **few), LAW).sentence
    other = diagnose(replace(whole, u=whole.u + 0.1), LAW)
    assert "not those of the law" in other.sentence


def test_a_record_in_parts_has_the_diagnosis_of_the_whole() -> None:
    """With gaps, missing commands and known latencies, too; the parts are shorter than a block and longer."""
    seen = record(delay=2.4e-3, measured=True, stiffness=29.0)
    rows = np.delete(np.arange(len(seen.t)), [5, 300, 301, 500, *range(600, 630), 1500])
    u = seen.u.copy()
    u[[0, 400, 401, 402, 700, 2000]] = np.nan
    gaps = replace(seen, u=u).rows(rows)
    timed = replace(gaps, sent=gaps.t, answered=gaps.t + 1e-4 * (1 + np.arange(len(gaps.t)) % 5))
    for whole, size in ((gaps, 300), (timed.rows(slice(450)), 13)):
        wanted, found = (diagnose(whole, LAW, size=each) for each in (len(whole.t), size))
        assert (found.kind, found.causes, found.sentence) == (wanted.kind, wanted.causes, wanted.sentence)
        assert list(found.figures) == list(wanted.figures)
        for name, value in wanted.figures.items():
            assert found.figures[name] == pytest.approx(value, rel=1e-9, abs=1e-13)
        for cause, error in wanted.errors.items():
            np.testing.assert_allclose(found.errors[cause], error, rtol=1e-9, atol=1e-13)


@pytest.mark.parametrize(
    ("delay", "tolerance", "kind", "cause"),
    [(0.0, 1e-9, "violated", "sampling"), (2e-3, 1e-4, "degraded", "delay"), (2e-3, 1e-6, "violated", "delay")],
)
def test_a_settled_error_beyond_tolerance_or_twice_the_foreseen_one_does_not_hold(
    delay: float, tolerance: float, kind: str, cause: str
) -> None:
    """The hold of the effort makes an error of 10 nrad to 10 urad, which is foreseen; a delay adds one that is not."""
    axes = JointTolerances(("joint1",), ("rad",), np.array([tolerance]))
    verdict = diagnose(record(delay=delay), LAW, axes=axes)
    assert (verdict.kind, verdict.causes[0]) == (kind, cause)


def test_a_run_with_a_finding_does_not_hold_however_small_its_error() -> None:
    fault = Finding("inertia", "joint1", "motor", 8e-5, "kg m^2", 1.0, "motor of joint1: inertia")
    verdict = with_findings(verdict_of(), (fault,))
    assert (verdict.kind, verdict.causes, verdict.findings) == ("degraded", ("model mismatch",), (fault,))
    assert fault.sentence in verdict.sentence


@pytest.mark.parametrize("most", [4, (0, 1, 2, 3)])
def test_delay_is_estimated_under_the_noise_of_encoders_and_compared_with_its_margin(most: int | tuple[int]) -> None:
    """The delay margin of the paper's joint is 5.45 samples; torques are not measured, and some delays vary."""
    rng, sent = np.random.default_rng(3), [np.zeros(1)]
    noise = np.array([1e-6, 1e-6, 5e-4, 5e-4])

    def acting(u: Array) -> Array:
        sent.append(u)
        return sent[max(0, len(sent) - 1 - int(rng.choice(most if isinstance(most, tuple) else [most])))]

    noisy = lambda q, dq: np.split(np.concatenate([q, dq]) + noise * rng.standard_normal(4), 2)  # noqa: E731
    verdict = diagnose(run(sensed=noisy, acting=acting), LAW)
    samples = float(np.mean(most))
    assert most != 4 or (verdict.kind, verdict.causes[0]) == ("degraded", "delay")
    assert verdict.figures["effort age"] == pytest.approx(samples * PERIOD, abs=0.05 * PERIOD)
    share = verdict.figures["effort age"] / (5.453 * PERIOD)
    assert f"{100 * share:.0f} % of the delay margin" in verdict.sentence


# The tracking error of each cause: the difference to the same run without it.

SETTLED = 1.5  # s
EXPLAINED = 0.3  # relative tolerance of the attributed error


def tracking(seen: Record) -> Array:
    """Return q_l - q_ld (k,) [rad] once the initial error has vanished."""
    settled = seen.t >= SETTLED
    return (seen.position[:, 0] - seen.jets[:, 0, 0])[settled]


@pytest.mark.parametrize(
    ("cause", "said", "changed"),
    [
        ("delay", "acted late", {"delay": 2.4e-3}),
        ("model mismatch", "differs from the model", {"stiffness": 29.0}),
        ("model mismatch", "differs from the model", {"link_inertia": 0.034}),
        ("model mismatch", "differs from the model", {"motor_inertia": 0.0035}),
        ("model mismatch", "differs from the model", {"link_damping": 0.25}),
    ],
)
def test_attributed_error_is_the_difference_to_the_run_without_the_cause(
    cause: str, said: str, changed: dict[str, float]
) -> None:
    made = np.abs(tracking(record(**changed)) - tracking(record())).max()
    verdict = verdict_of(**changed)
    assert verdict.kind in ("degraded", "violated")
    assert verdict.causes == (cause,)
    assert said in verdict.sentence
    assert verdict.errors[cause][0] == pytest.approx(made, rel=EXPLAINED)
    assert f"{1e3 * verdict.errors[cause][0]:.2g} mrad at joint1" in verdict.sentence


def test_the_grade_compares_the_error_with_the_tolerance() -> None:
    error = verdict_of(stiffness=29.0).errors["model mismatch"][0]
    for factor, kind in ((0.8, "violated"), (1.3, "degraded")):
        axes = JointTolerances(("elbow",), ("m",), np.array([factor * error]))
        verdict = diagnose(record(stiffness=29.0), LAW, axes=axes)
        assert verdict.kind == kind
        assert f"{1e3 * error:.2g} mm at elbow" in verdict.detail


def test_encoder_offset_of_0p1_mrad_is_degraded() -> None:
    """No signal measures the offset; the error that it causes in the measured positions is within the tolerance."""
    seen = run(sensed=lambda q, dq: (q + [1e-4, 0.0], dq), steps=1)
    verdict = diagnose(seen, LAW)
    assert verdict.kind == "degraded"
    assert verdict.errors["model mismatch"][0] == pytest.approx(np.abs(tracking(seen)).max(), rel=EXPLAINED)


def test_closed_loop_map_has_the_spectral_radius_of_the_linearisation() -> None:
    q_l = np.array([[0.3]])
    map_of_errors = closed_loop(LAW, q_l, PERIOD)
    radius = np.abs(np.linalg.eigvals(map_of_errors)).max()
    assert radius == pytest.approx(linearize(LAW, q_l).radii(PERIOD)[0], rel=1e-9)


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"tolerance": np.zeros(1)}, r"tolerance is \[0.0\]; expected positive numbers"),
        ({"tolerance": np.ones(2)}, r"tolerance has shape \(2,\); expected a scalar or \(1,\)"),
        ({"units": ("rad", "m")}, "units are"),
        ({"jets": np.zeros((3, 5, 1))}, r"jets has shape \(3, 5, 1\); expected \(2501, 5, 1\)"),
        ({"sample_period": 0.0}, "sample_period is 0"),
    ],
)
def test_inconsistent_records_and_tolerances_are_refused(changed: dict[str, Any], sentence: str) -> None:
    fits: Any = record() if {*changed} & {"jets", "sample_period"} else JointTolerances.plain(1)
    with pytest.raises(fjr.StateError, match=sentence):
        replace(fits, **changed)
