# SPDX-License-Identifier: Apache-2.0
"""References as CasADi functions and as exported C give the jets of the Python references at every time."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import fjr_core as fjr
from core.codegen.c_program import changed, exported, replayed
from fjr_core.codegen.reference_function import jets_function
from fjr_core.trajectories.reference import Reference

RNG = np.random.default_rng(0)
SPLINE = fjr.Spline(np.arange(6.0) ** 1.3, RNG.normal(size=(6, 2)))
SINE = fjr.Sine((0.5, 0.2), (2.0, 3.0), (0.4, -0.3), (0.1, 0.2))
WAY = ((0.1, 0.2), (1.5, -0.4), 1.6)
REFERENCES: dict[str, Reference] = {
    "sine": SINE,
    "sine that stands": fjr.Sine((0.5, 0.2), (0.0, 3.0), 0.1, 0.3),
    "multi-sine": fjr.MultiSine([[0.5, 0.2], [0.1, 0.3]], [[2.0, 3.0], [1.0, 0.5]], [[0.1, 0.2], [0.3, 0.4]], 0.2),
    "one sine of a multi-sine": fjr.MultiSine([[0.5, 0.2]], 2.0),
    "point to point": fjr.PointToPoint(*WAY, 0.2),
    "to and fro": fjr.PointToPoint(*WAY, 0.2, True),
    "to and fro without dwell": fjr.PointToPoint(*WAY, 0.0, True),
    "circle": fjr.Circle((0.4, -0.3), 0.3, -2.0, 0.4, 1.7),
    "hold": fjr.Hold((0.4, -0.3)),
    "spline": SPLINE,
    "samples": fjr.SampledMotion(np.arange(90) / 30, np.sin(np.arange(180).reshape(90, 2) / 30), 1e-3),
    "moving end": fjr.Spline([1.0, 2.0], RNG.normal(size=(2, 2)), RNG.normal(size=(2, 2)), moving_end=True),
    "joined": fjr.transition(SPLINE.jets(1.0), 1.0, SINE, 2.0),
    "shifted": fjr.time_shifted(SPLINE, 0.3),
}
TIMES = np.sort(np.concatenate([np.linspace(-1.0, 9.0, 301), np.arange(6.0) ** 1.3, [1.6, 1.8, 3.4, 3.6, 1e6]]))
each = pytest.mark.parametrize("reference", list(REFERENCES.values()), ids=list(REFERENCES))


@each
def test_casadi_jets_equal_the_jets_of_the_reference(reference: Reference) -> None:
    function, jets = jets_function(reference), reference.jets(TIMES)
    found = np.array([function(float(t)).full().T for t in TIMES])
    scale = np.maximum(1.0, np.abs(jets).max(axis=(1, 2)))
    assert np.abs(found - jets).max(axis=(1, 2)) == pytest.approx(0.0 * scale, abs=1e-12)


def test_each_row_is_the_derivative_of_the_row_above() -> None:
    """Check by central differences, because CasADi derives the rows of sines and circles."""
    h = 1e-4
    for name in ("sine", "multi-sine", "circle"):
        function = jets_function(REFERENCES[name])
        later, before = (function(2.3 + side * h).full() for side in (1, -1))
        assert (later - before)[:, :4] / (2 * h) == pytest.approx(function(2.3).full()[:, 1:], abs=1e-5)


@pytest.mark.parametrize("name", ["to and fro", "circle", "spline", "joined", "multi-sine", "shifted"])
def test_exported_reference_replays_to_rounding(name: str, tmp_path: Path) -> None:
    assert (
        replayed(exported(changed("two_link", reference=REFERENCES[name]), tmp_path, samples=60))["reference: jets"]
        <= 1e-12
    )
