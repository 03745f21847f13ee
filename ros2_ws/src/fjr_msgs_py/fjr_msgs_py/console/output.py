# SPDX-License-Identifier: Apache-2.0
"""What a command prints: its result as text or JSON, numbers for readers, progress on stderr."""

from __future__ import annotations

import json
import math
import re
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from textwrap import wrap
from typing import Any


@dataclass(frozen=True)
class Result:
    """text: printed by default; values: printed as JSON instead if asked for; code: exit code."""

    text: str
    values: Mapping[str, Any]
    code: int = 0

    def show(self, as_json: bool) -> int:
        """Print the text, or one JSON document; return the exit code."""
        print(json_text(self.values, indent=2) if as_json else printable(self.text), flush=True)
        return self.code


def json_text(values: Any, indent: int | None = None) -> str:
    """Return values as JSON: paths as text, arrays as lists, numbers that are not finite as null."""
    return json.dumps(finite(values), indent=indent, default=str, allow_nan=False)


def finite(value: Any) -> Any:
    """Return the value with None for numbers that are not finite, and arrays and tuples as lists."""
    if hasattr(value, "tolist"):  # NumPy's arrays and numbers
        value = value.tolist()
    if isinstance(value, Mapping):
        return {key: finite(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def printable(text: str) -> str:
    """Return the text with ? for control characters, by which names in a bag or message would steer the terminal."""
    return re.sub(r"[^\n\t\x20-\x7e\xa0-\U0010ffff]", "?", text)


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
        text = f"{value:.{digits}g}" if size < 10**digits - 0.5 else f"{value:.0f}"
    return f"{text} {unit}" if unit else text


def interval(low: float, high: float) -> str:
    """Return an interval with as many digits as its ends need to differ, 3 to 8."""
    texts = [[number(end, digits=digits) for end in (low, high)] for digits in range(3, 9)]
    return " to ".join(next((ends for ends in texts if ends[0] != ends[1]), texts[-1]))


def percent(fraction: float | None, digits: int = 2) -> str:
    """Return a fraction in percent, as 99.86 %, or > 99.99 % if only 1 reads 100.00 %; a dash as in `number`."""
    if fraction is None or not math.isfinite(fraction):
        return DASH
    text, least = f"{100 * fraction:.{digits}f}", 10.0**-digits
    if 0 < fraction < 1 and float(text) in (0.0, 100.0):
        text = f"< {least:.{digits}f}" if fraction < 0.5 else f"> {100 - least:.{digits}f}"
    return f"{text} %"


def milli(value: float | None, unit: str, digits: int = 3) -> str:
    """Return a value in thousandths of its unit, as 0.28 ms or 6.8 mrad."""
    return number(None if value is None else 1e3 * value, f"m{unit}", digits)


def plural(count: int, one: str, many: str = "") -> str:
    """Return a count with its noun, as 1 state or 2 states."""
    return f"{count} {one if count == 1 else many or one + 's'}"


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table; columns that a terminal has no room for follow below, beside the first one."""
    room, begin, lines = shutil.get_terminal_size((sys.maxsize, 0)).columns, 1, []
    widths = [max(map(len, column)) + 2 for column in zip(*rows, strict=True)]
    while begin < len(widths):
        fitting = (end for end in range(len(widths), begin, -1) if widths[0] + sum(widths[begin:end]) <= room + 2)
        end = next(fitting, begin + 1)
        for row in rows:
            *cells, last = (row[i].ljust(widths[i]) for i in (0, *range(begin, end)))
            indent = " " * min(sum(map(len, cells)), room // 2)
            lines += wrap("".join([*cells, last]), room, subsequent_indent=indent, break_long_words=False) or [""]
        begin = end
    return lines


BEAT = 2.0  # s


def progress_bar(line: str, form: str, **options: Any) -> Any:
    """Return tqdm's bar of this format on a terminal; elsewhere print the line, and the bar shows nothing."""
    from tqdm import tqdm

    terminal = sys.stderr.isatty()
    if not terminal:
        note(line)
    options["ncols"] = shutil.get_terminal_size().columns  # 80 if the terminal has no size; tqdm would draw nothing
    return tqdm(bar_format=form, disable=not terminal, file=sys.stderr, **options)


def note(line: str) -> None:
    """Print a line on stderr."""
    print(printable(line), file=sys.stderr, flush=True)


def tell(sentence: str) -> None:
    """Print a sentence of fjr on stderr."""
    note(f"fjr: {sentence}")


@contextmanager
def phase(text: str) -> Iterator[None]:
    """Announce a step on stderr; while it lasts, print every BEAT how long it has taken."""
    start = time.monotonic()
    note(text)
    with heartbeat(lambda: f"{text}: {time.monotonic() - start:.0f} s"):
        yield


@contextmanager
def heartbeat(line: Callable[[], str]) -> Iterator[None]:
    """Print a line on stderr every BEAT until the block ends."""
    ended = threading.Event()

    def beat() -> None:
        while not ended.wait(BEAT):
            note(line())

    thread = threading.Thread(target=beat, name="heartbeat", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
