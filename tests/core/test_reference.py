# SPDX-License-Identifier: Apache-2.0
"""References: four exact derivatives, shapes, scalars against arrays."""

from __future__ import annotations

import numpy as np
import pytest
from oracle import stencil

import fjr_core as fjr

SINES = {
    "plain": fjr.Sine(1.0, 1.0),
    "shifted": fjr.Sine(0.7, 2.5, offset=-0.4, phase=1.1),
    "three": fjr.Sine((1.0, 0.5, -0.2), (1.0, 2.0, 3.5), offset=(0.0, 0.1, 0.2), phase=(0.3, 0.0, -2.0)),
    "still": fjr.Sine(0.0, 1.0, offset=0.3),
}
sines = pytest.mark.parametrize("reference", SINES.values(), ids=SINES)


@sines
@pytest.mark.parametrize("t", [0.0, 0.37, 12.3])
def test_each_row_is_the_derivative_of_the_one_above(reference: fjr.Sine, t: float) -> None:
    rates = stencil(lambda s: reference.jets(t + s), 0.02)
    assert reference.jets(t)[1:] == pytest.approx(rates[:-1], abs=1e-10)


@sines
def test_first_row_is_the_sine(reference: fjr.Sine) -> None:
    a, w, c, p = (np.asarray(getattr(reference, key)) for key in ("amplitude", "frequency", "offset", "phase"))
    assert reference.jets(0.9)[0] == pytest.approx(c + a * np.sin(w * 0.9 + p), abs=1e-15)


@sines
def test_shapes(reference: fjr.Sine) -> None:
    n = reference.n
    assert reference.jets(0.5).shape == (5, n)
    times = np.array([0.0, 0.5, 1.5])
    assert reference.jets(times).shape == (3, 5, n)
    assert np.array_equal(reference.jets(times), np.array([reference.jets(t) for t in times]))


def test_scalars_stand_for_every_joint() -> None:
    assert fjr.Sine(1.0, 1.0).n == 1
    mixed, spelled = (
        fjr.Sine((1.0, 0.5), 2.0, offset=0.1),
        fjr.Sine((1.0, 0.5), (2.0, 2.0), offset=(0.1, 0.1)),
    )
    assert mixed.n == 2
    assert np.array_equal(mixed.jets(0.7), spelled.jets(0.7))


def test_paper_reference_starts_at_zero_with_unit_velocity() -> None:
    assert fjr.Sine(1.0, 1.0).jets(0.0)[:, 0] == pytest.approx([0, 1, 0, -1, 0], abs=1e-15)
