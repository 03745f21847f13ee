# SPDX-License-Identifier: Apache-2.0
"""Rewrite the C code that CasADi generates: say where a product and a sum are one operation, split long functions.

CasADi writes an SX function as one block of assignments, one operation each. Compilers contract a product and a sum to
a fused multiply-add where they like and the processor can, so that results differ between them, or not at all. Here
the code says `fma` itself: C rounds it once, on every processor, in hardware or in the C library. Equal operations,
also with the operands of a sum or product exchanged, are computed once.

The time of a compiler's register allocation grows faster than linearly with the length of a block. A long function
therefore becomes a sequence of calls of short ones; values that a later part reads are kept in an array.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

LONGEST = 500  # operations per part; also the longest function that stays whole

_FUNCTION = re.compile(r"^static int (\w+)\(([^)]*)\) \{\n(.*?)^\}\n", re.MULTILINE | re.DOTALL)
_STATEMENT = re.compile(r"  (?:(a\d+)=(.*)|(if \(res\[\d+\]!=0\) res\[\d+\]\[\d+\]=)(a\d+));")
_VARIABLE = re.compile(r"\ba\d+\b")
_NUMBER = re.compile(r"-?[\d.]+(?:e[+-]\d+)?")
_PRODUCT, _SUM, _DIFFERENCE, _QUOTIENT = (f"({{}}{operator}{{}})" for operator in "*+-/")
_FACTORS = re.compile(r"\(([^()*]+)\*({})\)")
_REWRITTEN = {"casadi_sq({})": _PRODUCT, "(2.*{})": _SUM}  # of one operand, twice
_ARRAYS = "const casadi_real** restrict arg, casadi_real** restrict res, casadi_real* restrict b"


class _Operation(NamedTuple):
    """An expression or result in C with {} for each operand; operands are numbers of earlier operations."""

    text: str
    operands: tuple[int, ...]

    @property
    def is_result(self) -> bool:
        return self.text.startswith("if ")


def fused(code: str, longest: int | None = None) -> str:
    """Return the C code with fused multiply-adds in all straight-line functions; a function of any other form is kept.

    A sum or difference of which an operand is a product becomes an fma; of two products it is the one that fewer
    operations read, then the second. longest: operations of a part (`LONGEST`), for a compiler that knows GNU C; None:
    functions stay whole.
    """
    return _FUNCTION.sub(lambda match: _rewritten(match[1], match[2], match[3], longest) or match[0], code)


def _rewritten(name: str, parameters: str, body: str, longest: int | None) -> str | None:
    """Return the C code of a straight-line function; None for any other function."""
    operations = _operations(body)
    if operations is None:
        return None
    operations = _contracted(operations)
    order = _needed(operations)
    if longest is None or len(order) <= longest:
        lines = [_line(operations, k) for k in order]
        return "\n".join([f"static int {name}({parameters}) {{", *lines, "  return 0;", "}", ""])
    return _in_parts(name, parameters, operations, [order[i : i + longest] for i in range(0, len(order), longest)])


def _operations(body: str) -> list[_Operation] | None:
    """Return the operations of a straight-line function, equal ones once; None for any other function."""
    found: list[_Operation] = []
    numbers: dict[_Operation, int] = {}  # of operations, with sorted operands if they commute
    values: dict[str, int] = {}  # of variables
    lines = [line for line in body.splitlines() if not line.startswith("  casadi_real a")]
    if not lines or lines.pop() != "  return 0;":
        return None
    for line in lines:
        match = _STATEMENT.fullmatch(line)
        if match is None:
            return None
        target, expression, result, value = match.groups()
        if result:
            found.append(_Operation(result + "{}", (values[value],)))
            continue
        operands = tuple(values[variable] for variable in _VARIABLE.findall(expression))
        made = _simplified(_Operation(_VARIABLE.sub("{}", expression), operands), found)
        commuted = _Operation(made.text, tuple(sorted(made.operands))) if made.text in (_PRODUCT, _SUM) else made
        if commuted not in numbers:
            numbers[commuted] = len(found)
            found.append(made)
        values[target] = numbers[commuted]
    return found


def _simplified(operation: _Operation, found: Sequence[_Operation]) -> _Operation:
    """Return the operation as a product or sum if it is one with the same result."""
    text, operands = operation
    if text in _REWRITTEN:
        return _Operation(_REWRITTEN[text], operands * 2)
    if text == _QUOTIENT and _NUMBER.fullmatch(divisor := found[operands[1]].text):
        share, exponent = math.frexp(float(divisor))
        if share == 0.5 and abs(exponent) < 1000:  # a power of two
            return _Operation(f"({1 / float(divisor)!r}*{{}})", operands[:1])
    return operation


def _contracted(operations: Sequence[_Operation]) -> list[_Operation]:
    """Return the operations with fma for sums and differences of which an operand is a product."""
    readers = Counter(operand for operation in operations for operand in operation.operands)
    found = []
    for operation in operations:
        products = [k for k in reversed(operation.operands) if _FACTORS.fullmatch(operations[k].text)]
        if operation.text in (_SUM, _DIFFERENCE) and products and len(set(operation.operands)) == 2:
            product = min(products, key=lambda k: readers[k])
            first, second = operation.operands
            other = first if product == second else second
            signs = ("", "") if operation.text == _SUM else ("-", "") if product == second else ("", "-")
            fma = _FACTORS.sub(rf"fma({signs[0]}\1,\2,{signs[1]}{{}})", operations[product].text)
            operation = _Operation(fma, (*operations[product].operands, other))
        found.append(operation)
    return found


def _needed(operations: Sequence[_Operation]) -> list[int]:
    """Return the numbers of the operations on which a result depends, in their order."""
    needed: set[int] = set()
    for k in reversed(range(len(operations))):
        if operations[k].is_result or k in needed:
            needed.update((k, *operations[k].operands))
    return sorted(needed)


def _line(operations: Sequence[_Operation], k: int) -> str:
    """Return the statement of an operation; its value is the constant t<k>."""
    text = operations[k].text.format(*(f"t{operand}" for operand in operations[k].operands))
    return f"  {text};" if operations[k].is_result else f"  const casadi_real t{k}={text};"


def _in_parts(name: str, parameters: str, operations: Sequence[_Operation], parts: Sequence[Sequence[int]]) -> str:
    """Return the C code of a function in parts.

    A value that a later part reads has a place in the array b, from which that part loads it before its first use.
    Inputs and constants have none: they are read again.
    """
    last = {operand: i for i, part in enumerate(parts) for k in part for operand in operations[k].operands}
    places: dict[int, int] = {}
    lines = []
    for i, part in enumerate(parts):
        known: set[int] = set()
        lines.append(f"static __attribute__((noinline)) void {name}_part{i}({_ARRAYS}) {{")
        for k in part:
            for operand in operations[k].operands:
                if operand not in known:
                    known.add(operand)
                    load = f"  const casadi_real t{operand}=b[{places[operand]}];" if operand in places else ""
                    lines.append(load or _line(operations, operand))
            if operations[k].operands:  # others are written where they are read
                known.add(k)
                lines.append(_line(operations, k))
                if last.get(k, i) > i:
                    places[k] = len(places)
                    lines.append(f"  b[{places[k]}]=t{k};")
        lines.append("}")
    calls = [f"  {name}_part{i}(arg, res, b);" for i in range(len(parts))]
    lines += [
        f"static int {name}({parameters}) {{",
        f"  casadi_real b[{max(1, len(places))}];",
        *calls,
        "  return 0;",
        "}",
    ]
    return "\n".join([*lines, ""])
