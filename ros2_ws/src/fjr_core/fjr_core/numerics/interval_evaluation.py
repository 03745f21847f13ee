# SPDX-License-Identifier: Apache-2.0
"""Enclose the values of a CasADi function on boxes: interval arithmetic with outward rounding.

Every operation rounds its lower bound down and its upper bound up by one unit in the last place, which covers the
rounding of IEEE arithmetic; sine and cosine by SLACK. R. E. Moore, R. B. Kearfott, M. J. Cloud, Introduction to
Interval Analysis, SIAM, 2009, theorem 5.1: the result contains the function value of every point of the box.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np

from .checks import Array

SLACK = 1e-15
"""More than the error of sine and cosine of a library, 4 units in the last place of numbers up to 1."""
HALF_TURN = 1e-12
"""Relative distance from a multiple of pi at which sine and cosine are taken to reach their extremum."""


class Box(NamedTuple):
    """Lower and upper bounds, arrays of equal shape."""

    lower: Array
    upper: Array

    @classmethod
    def around(cls, middle: Array, radius: Array) -> Box:
        """Return the box middle +- radius, rounded outwards."""
        return _outwards(np.asarray(middle - radius), np.asarray(middle + radius))

    @property
    def magnitude(self) -> Array:
        """Largest absolute values."""
        return np.asarray(np.maximum(np.abs(self.lower), np.abs(self.upper)))

    def distance(self, point: Array) -> Array:
        """Return the largest distances of numbers in the box from a point."""
        return np.asarray(np.nextafter(np.maximum(self.upper - point, point - self.lower), np.inf))


def enclosure(function: ca.Function, *arguments: Box) -> list[Box]:
    """Return boxes (size, k) that contain the outputs of an SX function on k boxes of its arguments (size, k) each.

    Matrices are in column-major order. Raises ZeroDivisionError if a divisor may vanish, NotImplementedError for an
    operation that is not implemented.
    """
    program, k = _program(function), arguments[0].lower.shape[1]
    work: dict[int, Box] = {}
    shapes = [(function.numel_out(i), k) for i in range(function.n_out())]
    results = [Box(np.zeros(shape), np.zeros(shape)) for shape in shapes]
    for code, read, written, value in program:
        if code == ca.OP_CONST:
            work[written[0]] = Box(np.float64(value), np.float64(value))  # type: ignore[arg-type]
        elif code == ca.OP_INPUT:
            bounds = arguments[read[0]]
            work[written[0]] = Box(bounds.lower[read[1]], bounds.upper[read[1]])
        elif code == ca.OP_OUTPUT:
            result = results[written[0]]
            result.lower[written[1]], result.upper[written[1]] = work[read[0]]
        elif code in OPERATIONS:
            work[written[0]] = OPERATIONS[code](*(work[i] for i in read))
        else:
            raise NotImplementedError(
                f"operation {code} of {function.name()}; expected an arithmetic one, sine or cosine"
            )
    return results


Instruction = tuple[int, list[int], list[int], float]


@lru_cache(maxsize=8)
def _program(function: ca.Function) -> list[Instruction]:
    """Return (operation, arguments, results, constant) of each instruction of a function with dense outputs."""
    program = []
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        value = function.instruction_constant(k) if code == ca.OP_CONST else 0.0
        program.append((code, function.instruction_input(k), function.instruction_output(k), value))
    return program


def _outwards(lower: Array, upper: Array) -> Box:
    return Box(np.nextafter(lower, -np.inf), np.nextafter(upper, np.inf))


def _sum(a: Box, b: Box) -> Box:
    return _outwards(a.lower + b.lower, a.upper + b.upper)


def _negative(a: Box) -> Box:
    return Box(-a.upper, -a.lower)


def _product(a: Box, b: Box) -> Box:
    products = a.lower * b.lower, a.lower * b.upper, a.upper * b.lower, a.upper * b.upper
    low, high = (extreme(extreme(*products[:2]), extreme(*products[2:])) for extreme in (np.minimum, np.maximum))
    return _outwards(low, high)


def _square(a: Box) -> Box:
    least = np.maximum(np.maximum(a.lower, -a.upper), 0.0)
    return _outwards(least * least, a.magnitude * a.magnitude)


def _inverse(a: Box) -> Box:
    if not np.all((a.lower > 0) | (a.upper < 0)):
        raise ZeroDivisionError("an interval that contains zero")
    return _outwards(1 / a.upper, 1 / a.lower)


def _cosine(a: Box) -> Box:
    first = np.ceil(a.lower / np.pi * (1 - HALF_TURN * np.sign(a.lower)) - HALF_TURN)
    count = np.floor(a.upper / np.pi * (1 + HALF_TURN * np.sign(a.upper)) + HALF_TURN) - first + 1
    ends, even = (np.cos(a.lower), np.cos(a.upper)), first % 2 == 0
    least = np.where((count >= 2) | ((count == 1) & ~even), -1.0, np.minimum(*ends) - SLACK)
    most = np.where((count >= 2) | ((count == 1) & even), 1.0, np.maximum(*ends) + SLACK)
    return Box(least, most)


QUARTER = Box(np.nextafter(np.float64(np.pi / 2), 0), np.nextafter(np.float64(np.pi / 2), 2))

OPERATIONS: dict[int, Callable[..., Box]] = {
    ca.OP_ADD: _sum,
    ca.OP_SUB: lambda a, b: _sum(a, _negative(b)),
    ca.OP_MUL: _product,
    ca.OP_DIV: lambda a, b: _product(a, _inverse(b)),
    ca.OP_NEG: _negative,
    ca.OP_TWICE: lambda a: Box(2 * a.lower, 2 * a.upper),
    ca.OP_SQ: _square,
    ca.OP_INV: _inverse,
    ca.OP_COS: _cosine,
    ca.OP_SIN: lambda a: _cosine(_sum(a, _negative(QUARTER))),
}
