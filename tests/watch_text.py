# SPDX-License-Identifier: Apache-2.0
"""The display of `fjr watch` as plain text."""

from __future__ import annotations

import io

from rich.console import Console

from fjr_monitor.watch.state import View
from fjr_monitor.watch.terminal import WIDE, render


def text(view: View, width: int = WIDE) -> str:
    stream = io.StringIO()
    Console(file=stream, width=width, no_color=True, force_terminal=False).print(render(view, width))
    return stream.getvalue()
