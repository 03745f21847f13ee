# SPDX-License-Identifier: Apache-2.0
"""Format numbers for pages, tables and messages."""

from __future__ import annotations

import math

SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
DASH = "\N{EN DASH}"


def number(value: float | None, unit: str = "", digits: int = 3) -> str:
    """Return 0.0123, 1234, or 1.2 times a power of ten in superscripts; a dash for None or a value not finite."""
    if value is None or not math.isfinite(value):
        return DASH
    size = abs(value)
    if 0 < size < 1e-3 or size >= 1e6:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        text = f"{mantissa}·10{str(int(exponent)).translate(SUPERSCRIPT)}"
    else:
        text = f"{value:.{digits}g}" if size < 10**digits else f"{value:.0f}"
    return f"{text} {unit}" if unit else text


def interval(low: float, high: float, most: int = 8) -> str:
    """Return an interval with as many digits as tell its ends apart, 3 to `most`."""
    for digits in range(3, most + 1):
        ends = number(low, digits=digits), number(high, digits=digits)
        if ends[0] != ends[1]:
            break
    return f"{ends[0]} to {ends[1]}"


def percent(fraction: float | None, digits: int = 2) -> str:
    """Return a fraction in percent, as 99.86 %; a dash for None or a value not finite."""
    if fraction is None or not math.isfinite(fraction):
        return DASH
    return f"{100 * fraction:.{digits}f} %"


def sentence(text: str) -> str:
    """Return a clause as a sentence: with a capital and a full stop."""
    return f"{text[:1].upper()}{text[1:]}."


def milliseconds(microseconds: float | None) -> str:
    """Return microseconds as milliseconds, as 0.28 ms."""
    return number(None if microseconds is None else microseconds * 1e-3, "ms")


def plural(count: int, one: str, many: str = "") -> str:
    """Return a count with its noun, as 1 state or 2 states."""
    return f"{count} {one if count == 1 else many or one + 's'}"
