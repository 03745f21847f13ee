# SPDX-License-Identifier: Apache-2.0
"""The tracking error attributed to each cause agrees with the difference to the same run without the cause."""

from __future__ import annotations

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.numerics.checks import Array
from fjr_core.stability.linearization import linearize
from fjr_monitor.diagnosis.causes import closed_loop
from fjr_monitor.diagnosis.diagnosis import diagnose
from fjr_monitor.diagnosis.record import Record
from fjr_monitor.diagnosis.thresholds import JointTolerances
from monitor.diagnosis.loops import PERIOD, recorded
from monitor.diagnosis.test_diagnosis import DURATION, LAW, REFERENCE, record

SETTLED = 1.5  # s
EXPLAINED = 0.3  # relative tolerance of the attributed error


def tracking(seen: Record) -> Array:
    """Return q_l - q_ld (k,) [rad] once the initial error has vanished."""
    settled = seen.t >= SETTLED
    return (seen.position[:, 0] - seen.jets[:, 0, 0])[settled]


@pytest.mark.parametrize(
    ("cause", "changed"),
    [
        ("delay", {"delay": 2.4e-3}),
        ("model mismatch", {"stiffness": 29.0}),
        ("model mismatch", {"link_damping": 0.25}),
    ],
)
def test_attributed_error_is_the_difference_to_the_run_without_the_cause(cause: str, changed: dict[str, float]) -> None:
    run = record(**changed)
    made = np.abs(tracking(run) - tracking(record())).max()
    verdict = diagnose(run, LAW)
    assert verdict.causes[0] == cause
    assert verdict.errors[cause][0] == pytest.approx(made, rel=EXPLAINED)
    assert f"{1e3 * verdict.errors[cause][0]:.2g} mrad at joint1" in verdict.sentence


def test_healthy_run_attributes_no_error_to_any_cause() -> None:
    verdict = diagnose(record(), LAW)
    assert max(error.max() for error in verdict.errors.values()) < 1e-9


def test_the_grade_compares_the_error_with_the_tolerance() -> None:
    run = record(stiffness=29.0)
    error = diagnose(run, LAW).errors["model mismatch"][0]
    for factor, kind in ((0.8, "violated"), (1.3, "degraded")):
        axes = JointTolerances(("elbow",), ("m",), np.array([factor * error]))
        verdict = diagnose(run, LAW, axes=axes)
        assert verdict.kind == kind
        assert f"{1e3 * error:.2g} mm at elbow" in verdict.detail


def test_encoder_offset_of_0p1_mrad_is_degraded() -> None:
    """No signal measures the offset; the error that it causes in the measured positions is within the tolerance."""
    start, offset = LAW.robot.state(0.5, 0.5, 0.0, 0.0), np.array([1e-4, 0.0])
    samples = round(DURATION / PERIOD)
    seen = recorded(LAW, REFERENCE, start, samples, sensed=lambda q, dq: (q + offset, dq), steps=1)
    verdict = diagnose(seen, LAW)
    assert verdict.kind == "degraded"
    assert verdict.errors["model mismatch"][0] == pytest.approx(np.abs(tracking(seen)).max(), rel=EXPLAINED)


def test_closed_loop_map_has_the_spectral_radius_of_the_linearisation() -> None:
    q_l = np.array([[0.3]])
    map_of_errors = closed_loop(LAW, q_l, PERIOD)
    radius = np.abs(np.linalg.eigvals(map_of_errors)).max()
    assert radius == pytest.approx(linearize(LAW, q_l).radii(PERIOD)[0], rel=1e-9)


@pytest.mark.parametrize(
    ("tolerance", "units", "sentence"),
    [
        ([0.0], ("rad",), r"tolerance is \[0.0\]; expected positive numbers"),
        ([1e-3, 1e-3], ("rad",), r"tolerance has shape \(2,\); expected a scalar or \(1,\)"),
        ([1e-3], ("rad", "m"), "units are"),
    ],
)
def test_axes_of_the_wrong_shape_are_refused(tolerance: list[float], units: tuple[str, ...], sentence: str) -> None:
    with pytest.raises(fjr.StateError, match=sentence):
        JointTolerances(("joint1",), units, np.array(tolerance))
