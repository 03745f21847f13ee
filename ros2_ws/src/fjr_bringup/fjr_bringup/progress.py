# SPDX-License-Identifier: Apache-2.0
"""Show progress on stderr: a bar on a terminal, one line elsewhere."""

from __future__ import annotations

import sys

from tqdm import tqdm


class Progress:
    """Progress of a run in seconds of stamped time, out of `total`; a context manager."""

    def __init__(self, name: str, total: float) -> None:
        terminal = sys.stderr.isatty()
        if not terminal:
            print(f"{name}: running for {total:g} s of stamped time", file=sys.stderr, flush=True)
        form = "{desc}: {percentage:3.0f}% |{bar}| {n:.1f}/{total:.1f} s"
        self._bar = tqdm(total=total, desc=name, bar_format=form, disable=not terminal, file=sys.stderr)

    def at(self, seconds: float) -> None:
        """Show that the run has reached `seconds`."""
        self._bar.update(min(seconds, self._bar.total or seconds) - self._bar.n)

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()
