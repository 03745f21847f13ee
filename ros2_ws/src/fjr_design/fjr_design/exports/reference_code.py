# SPDX-License-Identifier: Apache-2.0
"""Write a reference as C text: constant arrays and an initialised struct fjr_reference (fjr_core/runtime/step.h)."""

from __future__ import annotations

from collections.abc import Iterator

from fjr_core.errors import TrajectoryError
from fjr_core.motions.reference import Reference
from fjr_core.runtime.reference import ReferenceTable, reference_table

from .c_code import number, numbers

KNOWN = "Sine, MultiSine, PointToPoint, Circle, Hold, Spline, SampledMotion, joined or shifted"


def reference_code(reference: Reference, name: str) -> str:
    """Return C definitions that end with `static const struct fjr_reference <name>`; they need step.h and math.h.

    All other definitions have names that start with <name>_. Raises TrajectoryError for a reference that is not built
    in.
    """
    return "\n".join(_definitions(reference_table(reference), name))


def _definitions(table: ReferenceTable, name: str) -> Iterator[str]:
    """Yield the definitions of a table, those to which it refers first."""
    if table.function is not None:
        kind = type(table.function).__name__
        raise TrajectoryError(f"a reference {kind} cannot be exported to C; expected one of {KNOWN}")
    if table.then is not None:
        yield from _definitions(table.then, f"{name}_then")
    for field, array in table.arrays.items():
        yield f"static const double {name}_{field}[{array.size}] = {{\n    {numbers(array)}}};"
    fields = ",\n".join(f"    .{field} = {value}" for field, value in _fields(table, name))
    yield f"static const struct fjr_reference {name} = {{\n{fields}}};\n"


def _fields(table: ReferenceTable, name: str) -> Iterator[tuple[str, str]]:
    """Yield the fields that are not zero, as C."""
    yield "kind", table.kind
    for field in ("shift", "end", "period", "radius"):
        if value := float(getattr(table, field)):
            yield field, number(value)
    yield "position", f"{{{numbers(table.position)}}}"
    arrays = {field: f"{name}_{field}" for field in table.arrays}
    if "amplitude" in arrays:
        yield "terms", str(len(table.arrays["amplitude"]))
        yield from arrays.items()
    elif arrays:
        yield "polynomials", f"{{{', '.join([str(len(table.arrays['edge'])), *arrays.values()])}}}"
    if table.then is not None:
        yield "until", number(float(table.until))
        yield "then", f"&{name}_then"
