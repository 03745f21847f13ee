# SPDX-License-Identifier: Apache-2.0
"""Describe objects in one line, for their repr: numbers with four digits, long arrays by range or shape."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from decimal import ROUND_CEILING, ROUND_FLOOR, Context
from typing import Any

import numpy as np

from .checks import is_diagonal

LONGEST_LIST = 3
"""Longest vector whose entries are listed."""


def at_least(bound: float, digits: int = 4) -> str:
    """Return a lower bound as text of `digits` digits, rounded down unless it is that number but for 1e-12 of it."""
    rounded = Context(digits, ROUND_FLOOR).create_decimal_from_float(bound * (1 + math.copysign(1e-12, bound)))
    return f"{float(rounded):.{digits}g}"


def at_most(bound: float, digits: int = 3) -> str:
    """Return an upper bound as text of `digits` digits, rounded up unless it is that number but for 1e-12 of it."""
    rounded = Context(digits, ROUND_CEILING).create_decimal_from_float(bound * (1 - math.copysign(1e-12, bound)))
    return f"{float(rounded):.{digits}g}"


def brief(value: Any) -> str:
    """Return a value as short text without a line break.

    A vector with equal entries, and a diagonal matrix with equal entries, appear as one number; other vectors and
    diagonals with more than LONGEST_LIST entries as their range, other arrays by their shape.
    """
    if isinstance(value, (bool, np.bool_, str)) or value is None:
        return repr(value)
    if isinstance(value, (int, float, np.number)):
        return f"{value:.4g}"
    if isinstance(value, (list, tuple, np.ndarray)):
        try:
            return _brief_array(np.asarray(value, dtype=float))
        except (TypeError, ValueError):
            return f"{len(value)} items"
    if isinstance(value, Mapping):
        return f"{len(value)} items"
    return " ".join(repr(value).split())


def one_line(owner: Any) -> str:
    """Return the repr of a dataclass: its fields in brief, without those left at a default of None, 0 or inf.

    Assign it in the body of the class: `__repr__ = one_line`.
    """
    texts = []
    for each in fields(owner):
        text = brief(getattr(owner, each.name))
        is_off = (
            text in ("None", "0", "inf", "()") and not isinstance(each.default, str) and text == brief(each.default)
        )
        if each.repr and not is_off:
            texts.append(f"{each.name}={text}")
    return f"{type(owner).__name__}({', '.join(texts)})"


def joints(n: int) -> str:
    """Return a number of joints as text."""
    return f"{n} joint" if n == 1 else f"{n} joints"


def span(t: Any) -> str:
    """Return the range of instants (k,) [s] as text."""
    t = np.asarray(t)
    return f"{t[0]:.4g} to {t[-1]:.4g} s" if t.size else "no instants"


def _brief_array(array: Any) -> str:
    if not array.size:
        return "()"
    if array.ndim == 2 and array.shape[0] == array.shape[1] and is_diagonal(array):
        array = np.diag(array)
    if array.ndim > 1:
        return f"array {array.shape}"
    low, high = np.min(array), np.max(array)
    if array.ndim == 0 or low == high:
        return f"{low:.4g}"
    if array.size <= LONGEST_LIST:
        return f"[{', '.join(f'{entry:.4g}' for entry in array)}]"
    return f"[{low:.4g} .. {high:.4g}]"
