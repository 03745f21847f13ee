# SPDX-License-Identifier: Apache-2.0
"""References for C: as a table of plain arrays, and as struct fjr_reference of step.h."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf
from typing import Any

import numpy as np

from ..errors import FjrError, TrajectoryError, UserCodeError
from ..extensions.python_code import checked
from ..files.importing import described
from ..motions.piecewise_polynomial import PolynomialReference
from ..motions.point_to_point import Circle
from ..motions.reference import JETS, Reference, check_reference
from ..motions.sine import Sines
from ..motions.transition import TimeShifted, Transition
from ..numerics.checks import Array

_NUMBERS = ("shift", "end", "period", "radius", "until")
_SINES = ("amplitude", "frequency", "phase")
_POLYNOMIALS = ("edge", "origin", "rate", "coefficients")


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


def reference_table(reference: Any) -> ReferenceTable:
    """Return the table of a reference; raises TrajectoryError for an object that is none.

    The class that defines `jets` decides: a subclass of a built-in reference with its own `jets` is a function, which
    is evaluated in Python.
    """
    check_reference(reference)
    owner = next((each for each in type(reference).__mro__ if "jets" in vars(each)), object)
    if owner is Sines:
        arrays = dict(zip(_SINES, reference.rows, strict=True))
        return ReferenceTable("FJR_SINES", np.asarray(reference.offset), reference.end, arrays)
    if owner is Circle:
        arrays = dict(zip(_POLYNOMIALS, reference.angle.table, strict=True))
        centre = np.asarray(reference.centre)
        return ReferenceTable("FJR_CIRCLE", centre, reference.end, arrays, radius=reference.radius)
    if owner is PolynomialReference:
        arrays = dict(zip(_POLYNOMIALS, reference.table, strict=True))
        return ReferenceTable("FJR_POLYNOMIALS", np.zeros(reference.n), reference.end, arrays, period=reference.period)
    if owner is Transition:
        then, until = reference_table(reference.target), reference.transition_end
        return replace(
            reference_table(reference.segment), end=max(until, then.end + then.shift), until=until, then=then
        )
    if owner is TimeShifted:
        table = reference_table(reference.reference)
        return replace(table, shift=table.shift + reference.t0)
    end = float(getattr(reference, "end", inf))
    return ReferenceTable("FJR_FUNCTION", np.zeros(reference.n), end, {}, function=reference)


class ReferenceStruct:
    """A reference as struct fjr_reference, with all that it points to; valid as long as this object lives.

    ffi: cffi's FFI that knows step.h. pointer: struct fjr_reference *, not to be changed.
    A reference that is not built in is called in Python. If it raises an exception, or its jets have another shape, the
    jets are nan and `raise_failure` raises UserCodeError.
    Raises TrajectoryError for an object that is no reference and for another number of joints than FJR_N.
    """

    def __init__(self, ffi: Any, reference: Reference) -> None:
        self._ffi, self._owned = ffi, []  # type: Any, list[Any]
        self._failure: BaseException | None = None
        self.pointer = self._struct(reference_table(reference))

    def raise_failure(self) -> None:
        """Raise the first error of the user's reference since the last call, if there is one."""
        failure, self._failure = self._failure, None
        if failure is not None:
            raise failure

    def _struct(self, table: ReferenceTable) -> Any:
        struct = self._kept(self._ffi.new("struct fjr_reference *"))
        joints = len(struct.position)
        if len(table.position) != joints:
            raise TrajectoryError(f"the reference has {len(table.position)} joints; expected {joints}")
        struct.kind = self._ffi.typeof("enum fjr_reference_kind").relements[table.kind]
        struct.position = table.position.tolist()
        for name in _NUMBERS:
            setattr(struct, name, getattr(table, name))
        self._point(struct, _SINES, table)
        self._point(struct.polynomials, _POLYNOMIALS, table)
        struct.terms = len(table.arrays.get("amplitude", ()))
        struct.polynomials.edges = len(table.arrays.get("edge", ()))
        if table.then is not None:
            struct.then = self._struct(table.then)
        if table.function is not None:
            struct.jets = self._kept(self._callback(table.function, (JETS, joints)))
        return struct

    def _point(self, struct: Any, names: tuple[str, ...], table: ReferenceTable) -> None:
        """Let the fields of these names point to the arrays that the table has."""
        for name in names:
            if name in table.arrays:
                array: Array = np.ascontiguousarray(table.arrays[name], dtype=float)
                setattr(struct, name, self._kept(self._ffi.from_buffer("double[]", array)))

    def _callback(self, reference: Reference, shape: tuple[int, int]) -> Any:
        """Return the C function that calls a reference of the user."""

        def jets(_context: Any, t: float, result: Any) -> None:
            found = np.frombuffer(self._ffi.buffer(result, 8 * shape[0] * shape[1])).reshape(shape)
            try:
                found[:] = checked(f"jets of {type(reference).__name__}", reference.jets(t), shape)
            except BaseException as error:  # nothing may pass through C, not even Ctrl-C
                found.fill(np.nan)
                if isinstance(error, Exception) and not isinstance(error, FjrError):
                    title = type(reference).__name__
                    error = UserCodeError(f"jets of {title} raises {described(error)}; expected a value")
                self._failure = self._failure or error

        return self._ffi.callback("void(void *, double, double *)", jets)

    def _kept(self, owned: Any) -> Any:
        self._owned.append(owned)
        return owned
