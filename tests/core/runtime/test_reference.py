# SPDX-License-Identifier: Apache-2.0
"""References in C give the jets of the Python references at every time, from tables in memory and as exported text.

reference.c is built as a library, with warnings as errors.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

import mpmath
import numpy as np
import pytest
from cffi import FFI
from hypothesis import given, settings
from hypothesis import strategies as some

import fjr_core as fjr
from design.exports.c_program import built
from fjr_core.motions.piecewise_polynomial import PiecewisePolynomial
from fjr_core.motions.reference import JETS, Reference
from fjr_core.motions.transition import TimeShifted, Transition
from fjr_core.numerics.jit import declarations
from fjr_core.runtime.library import HEADER, text
from fjr_core.runtime.reference import ReferenceStruct, reference_table
from fjr_design.exports.project import reference_code

STRICT = ("cc", "-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-ffp-contract=off")
EXPORTED = """
void many(const struct fjr_reference* r, int64_t k, const double* t, double* jets);
int segment(struct fjr_segment* s, const double* jets0, const double* jets1, double t0, double t1);
void along(const struct fjr_segment* s, int64_t k, const double* t, double* jets);
const struct fjr_reference* constant(int64_t i);
"""
WRAPPERS = """
void many(const struct fjr_reference* r, int64_t k, const double* t, double* jets) {
  for (int64_t i = 0; i < k; ++i) fjr_reference_jets(r, t[i], jets + i * FJR_JETS * FJR_N);
}
int segment(struct fjr_segment* s, const double* jets0, const double* jets1, double t0, double t1) {
  return make_segment(s, jets0, jets1, t0, t1);
}
void along(const struct fjr_segment* s, int64_t k, const double* t, double* jets) {
  for (int64_t i = 0; i < k; ++i) segment_jets(s, t[i], jets + i * FJR_JETS * FJR_N);
}
const struct fjr_reference* constant(int64_t i) { return constants[i]; }
"""


class Library(NamedTuple):
    """reference.c for n joints."""

    n: int
    ffi: FFI
    lib: Any

    def jets(self, reference: Reference, t: Any) -> np.ndarray:
        """Return the jets (k, 5, n) of a reference at times (k,)."""
        struct = ReferenceStruct(self.ffi, reference)
        jets = self.at(struct.pointer, t)
        struct.raise_failure()
        return jets

    def at(self, pointer: Any, t: Any) -> np.ndarray:
        """Return the jets (k, 5, n) of a struct fjr_reference at times (k,)."""
        return self._filled(self.lib.many, pointer, t)

    def segment(self, jets0: np.ndarray, jets1: np.ndarray, t0: float, t1: float) -> Any | None:
        """Return a struct fjr_segment, or None if it is not finite."""
        made = self.ffi.new("struct fjr_segment *")
        self.ffi.buffer(made)[:] = b"\xff" * self.ffi.sizeof(made[0])  # of an earlier segment, or NaN
        return made if self.lib.segment(made, self._doubles(jets0), self._doubles(jets1), t0, t1) else None

    def along(self, segment: Any, t: Any) -> np.ndarray:
        """Return the jets (k, 5, n) of a segment at times (k,)."""
        return self._filled(self.lib.along, segment, t)

    def _filled(self, function: Any, pointer: Any, t: Any) -> np.ndarray:
        jets = np.empty((len(t), JETS, self.n))
        function(pointer, len(t), self._doubles(t), self.ffi.from_buffer("double[]", jets))
        return jets

    def _doubles(self, array: Any) -> Any:
        return self.ffi.from_buffer("double[]", np.ascontiguousarray(array, dtype=float))


def library(n: int, constants: Sequence[str] = (), code: str = "") -> Library:
    """Return reference.c for n joints; constants: names of references in `code`, read by `constant`."""
    rows = ", ".join(f"&{name}" for name in constants) or "0"
    table = f"static const struct fjr_reference* const constants[] = {{{rows}}};"
    parts = text(HEADER), EXPORTED, text("reference.c"), code, table, WRAPPERS
    with tempfile.TemporaryDirectory() as folder:
        source, shared = Path(folder, "reference.c"), Path(folder, "reference.so")
        source.write_text("\n".join(parts), encoding="utf-8")
        built(STRICT, [source], shared, "-shared", "-fPIC", f"-DFJR_N={n}", "-DFJR_MEMORY=1")
        ffi = FFI()
        ffi.cdef(declarations(text(HEADER), {"FJR_N": n, "FJR_MEMORY": 1}) + EXPORTED)
        return Library(n, ffi, ffi.dlopen(str(shared)))


RNG = np.random.default_rng(0)
KNOTS = np.arange(6.0) ** 1.3
SPLINE = fjr.Spline(KNOTS, RNG.normal(size=(6, 2)))
SINE = fjr.Sine((0.5, 0.2), (2.0, -3.0), (0.4, -0.3), (0.1, 0.2))
CIRCLE = fjr.Circle((0.4, -0.3), 0.3, -2.0, 0.4, 1.7)
WAY = ((0.1, 0.2), (1.5, -0.4), 1.6)
JOINED = fjr.transition(SPLINE.jets(1.0), 1.0, SINE, 2.0)
POLYNOMIALS: dict[str, Reference] = {
    "spline": SPLINE,
    "moving end": fjr.Spline([1.0, 2.0], RNG.normal(size=(2, 2)), RNG.normal(size=(2, 2)), moving_end=True),
    "samples": fjr.SampledMotion(np.arange(90) / 30, np.sin(np.arange(180).reshape(90, 2) / 30), 1e-3),
    "point to point": fjr.PointToPoint(*WAY, 0.2),
    "to and fro": fjr.PointToPoint(*WAY, 0.2, True),
    "to and fro without dwell": fjr.PointToPoint(*WAY, 0.0, True),
    "pieces": PiecewisePolynomial(KNOTS, RNG.normal(size=(6, 5, 2))),
    "pieces that continue": PiecewisePolynomial(KNOTS, RNG.normal(size=(6, 5, 2)), continues=True),
    "hold": fjr.Hold((0.4, -0.3)),
    "shifted": fjr.time_shifted(SPLINE, 0.3),
    "shifted to and fro": fjr.time_shifted(fjr.PointToPoint(*WAY, 0.2, True), -0.7),
    "joined to a hold": fjr.transition(SINE.jets(1.0), 1.0, fjr.Hold((0.4, -0.3)), 0.8),
    "joined twice": fjr.transition(SINE.jets(2.0), 2.0, fjr.transition(SINE.jets(1.0), 1.0, SPLINE, 2.0), 0.5),
    "shifted, joined, shifted": fjr.time_shifted(
        fjr.transition(SINE.jets(1.0), 1.0, fjr.time_shifted(SPLINE, 0.3), 0.8), -0.4
    ),
}
BUILT_IN: dict[str, Reference] = {
    **POLYNOMIALS,
    "sine": SINE,
    "sine that stands": fjr.Sine((0.5, 0.2), (0.0, 3.0), 0.1, 0.3),
    "sums of sines": fjr.MultiSine([[0.5, 0.2], [0.1, 0.3]], [[2.0, 3.0], [1.0, 0.5]], [[0.1, 0.2], [0.3, 0.4]], 0.2),
    "circle": CIRCLE,
    "circle that stands": fjr.Circle((0.4, -0.3), 0.3, 0.0),
    "joined to a sine": JOINED,
    "joined to a circle": fjr.transition(SPLINE.jets(1.0), 1.0, fjr.time_shifted(CIRCLE, 1.2), 1.0),
}
FAR = [1e6, 123456789.25, 1e15, -1e6, -1e15]
each = pytest.mark.parametrize("name", BUILT_IN)


class OwnReference:
    """A reference of the user: a parabola."""

    n, end = 2, inf

    def jets(self, t: float) -> np.ndarray:
        return np.array([[t * t, t], [2 * t, 1.0], [2.0, 0.0], [0.0, 0.0], [0.0, 0.0]])


class ScaledSine(fjr.Sine):
    """A built-in reference with jets of its own."""

    def jets(self, t: float) -> np.ndarray:
        return 2.0 * super().jets(t)


@cache
def two_joints() -> Library:
    """Return the library for two joints with all built-in references as constants, in the order of BUILT_IN."""
    code = "\n".join(reference_code(reference, f"way_{i}") for i, reference in enumerate(BUILT_IN.values()))
    return library(2, [f"way_{i}" for i in range(len(BUILT_IN))], code)


@cache
def one_joint() -> Library:
    return library(1)


def times(reference: Reference) -> np.ndarray:
    """Return times before, within and after a reference, and its edges with their neighbours."""
    table, shift, edges = reference_table(reference), 0.0, [0.0, 1.6, 1.8, 3.4, 3.6]
    while table is not None:
        shift += table.shift
        edges += [shift, table.until + shift, *(table.arrays.get("edge", np.zeros(0)) + shift)]
        table = table.then
    edge = np.array([at for at in edges if np.isfinite(at)])
    return np.concatenate([np.linspace(-1.0, 9.0, 301), edge, np.nextafter(edge, inf), np.nextafter(edge, -inf), FAR])


@each
def test_jets_in_c_equal_those_of_python(name: str) -> None:
    """Those of polynomials bit by bit, and those of the exported text, compiled as C99 with warnings as errors."""
    c, reference = two_joints(), BUILT_IN[name]
    t = times(reference)
    expected, found = reference.jets(t), c.jets(reference, t)
    scale = 0.0 if name in POLYNOMIALS else 1e-14 * np.abs(expected).max(axis=(0, 2))[:, None]
    assert np.all(np.abs(found - expected) <= scale)
    np.testing.assert_array_equal(c.at(c.lib.constant(list(BUILT_IN).index(name)), t), found)


@each
def test_end_and_shift_are_those_of_the_reference(name: str) -> None:
    reference = BUILT_IN[name]
    owner = ReferenceStruct(two_joints().ffi, reference)
    struct = owner.pointer
    if not isinstance(reference, PiecewisePolynomial):
        assert struct.end + struct.shift == pytest.approx(reference.end, rel=1e-15)
    if np.isfinite(struct.end):
        last = two_joints().at(struct, np.nextafter(struct.end, inf) + struct.shift + np.array([0.0, 1.0, 1e6]))
        np.testing.assert_array_equal(last[:, 1:], 0.0)
        np.testing.assert_array_equal(last[1:], last[:-1])


@given(data=some.data())
@settings(max_examples=60, deadline=None)
def test_any_piecewise_polynomial_is_equal_bit_by_bit_around_its_knots(data: some.DataObject) -> None:
    steps = data.draw(some.lists(some.floats(1e-3, 1e3), min_size=1, max_size=5), "steps")
    knots = np.cumsum([data.draw(some.floats(-1e3, 1e3), "start"), *steps])
    numbers = some.lists(some.floats(-10, 10), min_size=5 * len(knots), max_size=5 * len(knots))
    jets = np.array(data.draw(numbers, "jets")).reshape(-1, 5, 1)
    pieces = PiecewisePolynomial(knots, jets, continues=data.draw(some.booleans(), "continues"))
    within = data.draw(some.lists(some.floats(-2e3, 8e3), max_size=20), "times")
    t = np.concatenate([knots, np.nextafter(knots, inf), np.nextafter(knots, -inf), pieces.table[0], within])
    np.testing.assert_array_equal(one_joint().jets(pieces, t), pieces.jets(t))


durations, starts = some.floats(1e-2, 1e2), some.floats(-1e2, 1e2)
TWO_JETS = RNG.normal(size=(2, JETS, 1))
any_two_jets = some.lists(some.floats(-10, 10), min_size=2 * JETS, max_size=2 * JETS).map(
    lambda numbers: np.array(numbers).reshape(2, JETS, 1)
)


def size(jets: np.ndarray, h: float) -> np.ndarray:
    """Return the size (5, 1) of the terms in each row of a segment of h [s] with jets (2, 5, 1) at its ends."""
    powers = float(h) ** np.arange(JETS)[:, None]
    return (np.abs(jets).max(axis=0) * powers).max() / powers * 10.0 ** np.arange(JETS)[:, None]


@given(jets=any_two_jets, t0=starts, duration=durations)
@settings(max_examples=100, deadline=None)
def test_a_segment_has_the_given_jets_at_both_ends_and_is_constant_outside(
    jets: np.ndarray, t0: float, duration: float
) -> None:
    c, t1 = one_joint(), t0 + duration
    made = c.segment(*jets, t0, t1)
    first, last = c.along(made, [t0, t1])
    np.testing.assert_allclose(first, jets[0], rtol=1e-14, atol=1e-300)
    np.testing.assert_allclose(last, jets[1], rtol=1e-14, atol=1e-300)
    before, after = c.along(made, [np.nextafter(t0, -inf), np.nextafter(t1, inf)])
    assert (before[0], after[0]) == (jets[0, 0], jets[1, 0])
    assert not before[1:].any()
    assert not after[1:].any()


def hermite(jets: np.ndarray, h: float) -> list:
    """Return the ascending coefficients of the polynomial with jets (2, 5) at t = 0 and h, in 60 digits."""
    powers, rows = range(2 * JETS), []
    for t in (mpmath.mpf(0), mpmath.mpf(h)):
        for k in range(JETS):
            rows.append([mpmath.ff(p, k) * (t ** (p - k)) if p >= k else mpmath.mpf(0) for p in powers])
    return list(mpmath.lu_solve(mpmath.matrix(rows), mpmath.matrix(jets.ravel().tolist())))


@pytest.mark.parametrize("h", [0.25, 2.0, 16.0])
def test_a_segment_is_the_polynomial_of_degree_nine_of_sixty_digits(h: float) -> None:
    """Joint by joint: the second one moves twice as far."""
    c, t = two_joints(), h * np.linspace(0.0, 1.0, 33)
    found = c.along(c.segment(*(TWO_JETS * [1.0, 2.0]), 0.0, h), t)
    with mpmath.workdps(60):
        position = hermite(TWO_JETS, h)
        rows = [
            [mpmath.ff(p, k) * a if (p := i + k) < 2 * JETS else mpmath.mpf(0) for i, a in enumerate(position[k:])]
            for k in range(JETS)
        ]
        exact = [[float(mpmath.polyval(row, mpmath.mpf(float(at)), asc=True)) for row in rows] for at in t]
    assert np.all(np.abs(found - np.multiply.outer(exact, [1.0, 2.0])) <= 2e-13 * size(TWO_JETS, h))


def test_a_segment_is_refused_where_python_refuses_it_or_its_jets_are_not_finite() -> None:
    for t0, t1 in ((0.0, 0.0), (1.0, 0.0), (0.0, 1e-100), (1e9, np.nextafter(1e9, inf)), (0.0, 2.0)):
        finite = PiecewisePolynomial(np.array([t0, t1]), TWO_JETS).finite
        assert (one_joint().segment(*TWO_JETS, t0, t1) is not None) == finite
    for place in np.ndindex(2, JETS):
        for wrong in (np.nan, inf):
            jets = np.ones((2, JETS, 1))
            jets[place] = wrong
            assert one_joint().segment(*jets, 0.0, 1.0) is None


def test_sines_and_circles_are_for_any_number_of_joints() -> None:
    three, t = library(3), np.linspace(-1.0, 5.0, 40)
    for reference in (fjr.Circle((0.1, 0.2, 0.3), 0.4, 1.5), fjr.Sine((0.5, 0.2, 0.1), 2.0, 0.3)):
        np.testing.assert_allclose(three.jets(reference, t), reference.jets(t), rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(one_joint().jets(fjr.Sine(1.0, 1.0), t), fjr.Sine(1.0, 1.0).jets(t), atol=1e-15)


@pytest.mark.parametrize("reference", [OwnReference(), ScaledSine((0.5, 0.2), 2.0)])
def test_a_reference_of_the_user_is_evaluated_in_python(reference: Reference) -> None:
    t = np.linspace(-1.0, 5.0, 11)
    np.testing.assert_array_equal(two_joints().jets(reference, t), [reference.jets(float(at)) for at in t])
    joined = TimeShifted(Transition(JOINED.segment, reference), 0.5)
    expected = [joined.jets(float(at)) for at in t]
    np.testing.assert_allclose(two_joints().jets(joined, t), expected, rtol=1e-12, atol=1e-12)
    inherited = type("NamedSine", (fjr.Sine,), {})
    assert [reference_table(kind(1.0, 1.0)).kind for kind in (inherited, ScaledSine)] == ["FJR_SINES", "FJR_FUNCTION"]


class BrokenReference(OwnReference):
    """A reference that fails from 1 s on."""

    def __init__(self, failure: Callable[[], object]) -> None:
        self.failure = failure

    def jets(self, t: float) -> np.ndarray:
        return super().jets(t) if t < 1.0 else self.failure()


FAILURES: dict[str, Callable[[], object]] = {
    "raises ZeroDivisionError": lambda: 1 / 0,
    r"has shape \(5, 3\); expected \(5, 2\)": lambda: np.zeros((5, 3)),
    "is 'far'; expected numbers": lambda: "far",
}


@pytest.mark.parametrize("words", FAILURES)
def test_a_reference_that_fails_is_nan_and_its_error_is_raised_once(
    words: str, capfd: pytest.CaptureFixture[str]
) -> None:
    c, struct = two_joints(), ReferenceStruct(two_joints().ffi, BrokenReference(FAILURES[words]))
    good, bad = c.at(struct.pointer, [0.5, 1.5])
    assert np.isfinite(good).all()
    assert np.isnan(bad).all()
    with pytest.raises(fjr.UserCodeError, match=f"jets of BrokenReference {words}"):
        struct.raise_failure()
    struct.raise_failure()
    assert capfd.readouterr() == ("", "")  # no traceback


REFUSED: dict[str, Any] = {
    "the reference has 1 joints; expected 2": fjr.Sine(1.0, 1.0),
    "the reference has 3 joints; expected 2": TimeShifted(fjr.Hold((0.1, 0.2, 0.3)), 1.0),
}


def test_what_is_no_reference_of_the_arm_or_cannot_be_exported_is_refused_in_one_sentence() -> None:
    for words, reference in REFUSED.items():
        with pytest.raises(fjr.TrajectoryError, match=words):
            ReferenceStruct(two_joints().ffi, reference)
    for own in (OwnReference(), TimeShifted(Transition(JOINED.segment, OwnReference()), 0.5)):
        with pytest.raises(fjr.TrajectoryError, match="a reference OwnReference cannot be exported to C; expected one"):
            reference_code(own, "way")
