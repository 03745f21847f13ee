# SPDX-License-Identifier: Apache-2.0
"""Evaluate CasADi functions on intervals by walking their instructions: the expressions that run, enclosed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from fjr_core.errors import StateError
from fjr_core.numerics.intervals import Interval, cosine, sine

ONE, TWO = Interval.exact(1.0), Interval.exact(2.0)
OPERATIONS: dict[int, Callable[..., Interval]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a * b,
    ca.OP_DIV: lambda a, b: a / b,
    ca.OP_NEG: lambda a: -a,
    ca.OP_SQ: lambda a: a * a,
    ca.OP_TWICE: lambda a: a * TWO,
    ca.OP_INV: lambda a: ONE / a,
    ca.OP_SIN: sine,
    ca.OP_COS: cosine,
}
Step = tuple[int, Callable[..., Interval], tuple[int, ...]]


class IntervalFunction:
    """An SX function that is evaluated on many boxes at once.

    Arguments and results are Intervals (nonzeros, k) for k boxes; nonzeros are in column-major order. A result contains
    every value of the function, in exact arithmetic, for arguments in the box. Raises StateError for an operation that
    is not in OPERATIONS, and ZeroDivisionError for a divisor that contains zero.
    """

    def __init__(self, function: ca.Function) -> None:
        self.function = function
        self._constants: list[tuple[int, Interval]] = []
        self._inputs: list[tuple[int, int, int]] = []
        self._outputs: list[tuple[int, int, int]] = []
        self._steps: list[Step] = []
        names = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}
        registers: dict[int, int] = {}  # of the function, to values that are assigned once
        for k in range(function.n_instructions()):
            operation = function.instruction_id(k)
            results, operands = function.instruction_output(k), function.instruction_input(k)
            if operation == ca.OP_OUTPUT:
                self._outputs.append((results[0], results[1], registers[operands[0]]))
            elif operation == ca.OP_CONST:
                self._constants.append((k, Interval.exact(function.instruction_constant(k))))
            elif operation == ca.OP_INPUT:
                self._inputs.append((k, operands[0], operands[1]))
            elif operation in OPERATIONS:
                self._steps.append((k, OPERATIONS[operation], tuple(registers[i] for i in operands)))
            else:
                raise StateError(f"{function.name()} contains {names[operation]}; expected {_known(names)}")
            if operation != ca.OP_OUTPUT:
                registers[results[0]] = k
        self._last = _last_uses(self._steps, self._outputs)

    def __call__(self, *arguments: Interval) -> list[Interval]:
        """Return the results, Intervals (nonzeros, k) each."""
        values: dict[int, Interval] = dict(self._constants)
        values |= {k: arguments[argument][element] for k, argument, element in self._inputs}
        for (k, operation, operands), finished in zip(self._steps, self._last, strict=True):
            values[k] = operation(*(values[i] for i in operands))
            for i in finished:
                del values[i]
        shape: Any = arguments[0].mid.shape[1:]
        results = [
            Interval(np.zeros((self.function.nnz_out(i), *shape)), np.zeros((self.function.nnz_out(i), *shape)))
            for i in range(self.function.n_out())
        ]
        for output, element, k in self._outputs:
            results[output].mid[element], results[output].rad[element] = values[k].mid, values[k].rad
        return results


def _last_uses(steps: list[Step], outputs: list[tuple[int, int, int]]) -> list[tuple[int, ...]]:
    """Return, for each step, the values that no later step and no output reads."""
    needed = {k for _, _, k in outputs}
    found: list[tuple[int, ...]] = []
    for k, _, operands in reversed(steps):
        found.append(tuple({k, *operands} - needed))
        needed |= {k, *operands}
    return found[::-1]


def _known(names: dict[int, str]) -> str:
    return ", ".join(sorted(names[operation] for operation in OPERATIONS))
