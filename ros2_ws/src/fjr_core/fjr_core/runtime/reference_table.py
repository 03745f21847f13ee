# SPDX-License-Identifier: Apache-2.0
"""Describe a reference by numbers and arrays: the fields of struct fjr_reference in step.h."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import singledispatch
from math import inf
from typing import Any

import numpy as np

from ..motions.piecewise_polynomial import PiecewisePolynomial, PolynomialReference
from ..motions.point_to_point import Circle, Hold, PointToPoint
from ..motions.reference import Reference, check_reference
from ..motions.sine import Sines
from ..motions.transition import TimeShifted, Transition
from ..numerics.checks import Array


@dataclass(frozen=True, eq=False)
class ReferenceTable:
    """Fields of struct fjr_reference; see step.h for their meaning.

    kind: name of the enumerator. position (n,) [rad]. end, shift, period, until [s]; radius [rad]. arrays: by the names
    of the fields, those of the polynomials included. function: the reference itself if it is not built in.
    """

    kind: str
    position: Array
    end: float
    arrays: dict[str, Array]
    shift: float = 0.0
    period: float = 0.0
    radius: float = 0.0
    until: float = inf
    then: ReferenceTable | None = None
    function: Reference | None = None

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.position)


def reference_table(reference: Reference) -> ReferenceTable:
    """Return the table of a reference; raises TrajectoryError for an object that is none.

    The class that defines `jets` decides: a subclass of a built-in reference with its own `jets` is a function.
    """
    check_reference(reference)
    owner = next((each for each in type(reference).__mro__ if "jets" in vars(each)), object)
    return _table.registry.get(owner, _table.registry[object])(reference)


@singledispatch
def _table(reference: Any) -> ReferenceTable:
    """Return the table of a reference of the user, which is evaluated in Python."""
    end = float(getattr(reference, "end", inf))
    return ReferenceTable("FJR_FUNCTION", np.zeros(reference.n), end, {}, function=reference)


@_table.register
def _(reference: Sines) -> ReferenceTable:
    arrays = dict(zip(("amplitude", "frequency", "phase"), reference.rows, strict=True))
    return ReferenceTable("FJR_SINES", np.asarray(reference.offset), reference.end, arrays)


@_table.register
def _(reference: Hold) -> ReferenceTable:
    return ReferenceTable("FJR_HOLD", np.asarray(reference.q), reference.end, {})


@_table.register
def _pieces(reference: PiecewisePolynomial) -> ReferenceTable:
    end = inf if reference.continues else float(reference.times[-1])
    return ReferenceTable("FJR_POLYNOMIALS", np.zeros(reference.n), end, _polynomials(reference))


@_table.register
def _(reference: PolynomialReference) -> ReferenceTable:
    return _pieces(reference.pieces)


@_table.register
def _(reference: PointToPoint) -> ReferenceTable:
    period = reference.period if reference.returns else 0.0
    return replace(_pieces(reference.pieces), end=reference.end, period=period)


@_table.register
def _(reference: Circle) -> ReferenceTable:
    arrays = _polynomials(reference.angle)
    return ReferenceTable("FJR_CIRCLE", np.asarray(reference.centre), reference.end, arrays, radius=reference.radius)


@_table.register
def _(reference: Transition) -> ReferenceTable:
    then, until = reference_table(reference.target), reference.transition_end
    return replace(_pieces(reference.segment), end=max(until, then.end + then.shift), until=until, then=then)


@_table.register
def _(reference: TimeShifted) -> ReferenceTable:
    table = reference_table(reference.reference)
    return replace(table, shift=table.shift + reference.t0)


def _polynomials(pieces: PiecewisePolynomial) -> dict[str, Array]:
    return dict(zip(("edge", "origin", "rate", "coefficients"), pieces.table, strict=True))
