# SPDX-License-Identifier: Apache-2.0
"""Show progress on stderr: a bar on a terminal, one line elsewhere."""

from __future__ import annotations

import sys
from typing import Any

from tqdm import tqdm


def progress_bar(line: str, form: str, **options: Any) -> tqdm[Any]:
    """Return tqdm's bar of this format on a terminal; elsewhere print the line, and the bar shows nothing."""
    terminal = sys.stderr.isatty()
    if not terminal:
        print(line, file=sys.stderr, flush=True)
    return tqdm(bar_format=form, disable=not terminal, file=sys.stderr, **options)
