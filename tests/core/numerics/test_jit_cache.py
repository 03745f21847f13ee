# SPDX-License-Identifier: Apache-2.0
"""Compiled code is reused for the same robot and gain pattern only."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.monitoring.certificate import Certificate, CertificateSeries
from fjr_core.numerics.code_cache import cache_folder

pytestmark = pytest.mark.skipif(not (shutil.which("cc") or shutil.which("gcc")), reason="no C compiler")
POINT = ([0.3, -0.2, 0.4, 0.1], [1.0, 0.5, -0.3, 0.2], np.arange(10.0).reshape(5, 2) / 10)


@pytest.fixture
def derivations(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Provide an empty cache and return the list of functions derived since."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    seen: list[str] = []
    derive = Certificate._derived
    monkeypatch.setattr(Certificate, "_derived", lambda self: seen.append("certificate") or derive(self))
    return seen


def balance(gains: fjr.Gains = fjr.PAPER_GAINS, **robot: float) -> Certificate:
    return Certificate(fjr.TrackingLaw(fjr.planar_two_link(**robot), gains, compile=True))


def at_point(certificate: Certificate, u: list[float] | None = None) -> CertificateSeries:
    """Return the certificate at POINT, one instant."""
    return certificate.along(*(np.array(each)[None] for each in POINT), None if u is None else [u])


def test_a_cached_function_is_not_derived_again(derivations: list[str]) -> None:
    first = at_point(balance())
    second = at_point(balance())
    assert len(derivations) == 1
    assert (first.V, first.dV, first.H) == (second.V, second.dV, second.H)


def test_a_cached_law_is_not_derived_again_and_takes_other_gains(
    derivations: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    derive, robot, other = (
        fjr.TrackingLaw.measured_expressions,
        fjr.planar_two_link(),
        fjr.Gains(11, 21, 0.7, 16, 61, 0.4),
    )
    monkeypatch.setattr(
        fjr.TrackingLaw, "measured_expressions", lambda law, *given: derivations.append("law") or derive(law, *given)
    )
    first, second = (fjr.TrackingLaw(robot, fjr.PAPER_GAINS, compile=True) for _ in range(2))
    assert first.measured_command(*POINT)[0].tolist() == second.measured_command(*POINT)[0].tolist()
    changed = second.with_gains(other).measured_command(*POINT)
    assert derivations == ["law"]
    u, V = fjr.TrackingLaw(robot, other).measured_command(*POINT)
    assert (changed[0], changed[1]) == (pytest.approx(u, rel=1e-12), pytest.approx(V, rel=1e-12))


def test_gain_values_are_arguments_and_their_pattern_is_fixed(derivations: list[str]) -> None:
    at_point(balance())
    at_point(balance(fjr.Gains(11.0, 21.0, 0.7, 16.0, 61.0, 0.4)))
    assert len(derivations) == 1
    full = [[20.0, 1.0], [1.0, 12.0]]
    at_point(balance(fjr.Gains(10.0, full, 0.6, 15.0, 60.0, 0.3)))
    assert len(derivations) == 2


@pytest.mark.parametrize(
    "change",
    [{"stiffness": 30.0}, {"gravity": 9.7}, {"link_mass": (1.3, 0.8)}, {"motor_damping": 0.05}, {"input_gain": 1.1}],
    ids=lambda change: next(iter(change)),
)
def test_another_robot_is_derived(derivations: list[str], change: dict) -> None:
    one = at_point(balance(), [1.0, 2.0])
    other = at_point(balance(**change), [1.0, 2.0])
    assert len(derivations) == 2
    assert one.u_law.tolist() != other.u_law.tolist() or one.supplied != other.supplied


def test_truncated_machine_code_is_recompiled(derivations: list[str]) -> None:
    wanted = at_point(balance()).V
    for library in cache_folder().glob("certificate-*.so"):
        library.write_bytes(library.read_bytes()[:100])
    assert wanted == at_point(balance()).V
    assert len(derivations) == 2
