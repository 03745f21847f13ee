# SPDX-License-Identifier: Apache-2.0
"""Numbers as a page writes them."""

from __future__ import annotations

import math

SUPERSCRIPT = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
DASH = "\N{EN DASH}"


def number(value: float | None, unit: str = "", digits: int = 3) -> str:
    """0.0123, 1234, 1.2 times a power of ten with superscripts; a dash for what is not known."""
    if value is None or not math.isfinite(value):
        return DASH
    size = abs(value)
    if 0 < size < 1e-3 or size >= 1e6:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        text = f"{mantissa}·10{str(int(exponent)).translate(SUPERSCRIPT)}"
    else:
        text = f"{value:.{digits}g}" if size < 10**digits else f"{value:.0f}"
    return f"{text} {unit}" if unit else text


def percent(fraction: float | None, digits: int = 2) -> str:
    """99.86 %; a dash for what is not known."""
    if fraction is None or not math.isfinite(fraction):
        return DASH
    return f"{100 * fraction:.{digits}f} %"


def milliseconds(microseconds: float | None) -> str:
    """0.28 ms."""
    return number(None if microseconds is None else microseconds * 1e-3, "ms")


def plural(count: int, one: str, many: str = "") -> str:
    """1 state, 2 states."""
    return f"{count} {one if count == 1 else many or one + 's'}"
