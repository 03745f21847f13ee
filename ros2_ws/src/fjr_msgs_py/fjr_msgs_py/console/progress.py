# SPDX-License-Identifier: Apache-2.0
"""Show progress on stderr: a bar on a terminal, lines elsewhere; no step is silent for longer than BEAT."""

from __future__ import annotations

import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

BEAT = 2.0  # s


def progress_bar(line: str, form: str, **options: Any) -> Any:
    """Return tqdm's bar of this format on a terminal; elsewhere print the line, and the bar shows nothing."""
    from tqdm import tqdm

    terminal = sys.stderr.isatty()
    if not terminal:
        note(line)
    width = shutil.get_terminal_size().columns  # 80 if the terminal has no size; tqdm would draw nothing
    return tqdm(bar_format=form, disable=not terminal, file=sys.stderr, ncols=width, **options)


def note(line: str) -> None:
    """Print a line on stderr."""
    print(line, file=sys.stderr, flush=True)


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
