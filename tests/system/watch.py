# SPDX-License-Identifier: Apache-2.0
"""Watch plant and controller for some seconds of stamped time; print the observations as JSON."""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from faults.watcher import EFFORTS, REFERENCE, STATES, Watcher
from time_limits import Limit

LIMIT = 40.0  # s on an idle machine


def main() -> int:
    """Run with the argument seconds of stamped time after the first command."""
    seconds = float(sys.argv[1])
    watcher = Watcher()
    limit = Limit(LIMIT)
    while not _heard(watcher, seconds):
        if limit.passed():
            print({topic: len(heard) for topic, heard in watcher.heard.items()}, file=sys.stderr)
            return 1
        time.sleep(0.01)
    print(json.dumps(_seen(watcher)))
    watcher.close()
    return 0


def _heard(watcher: Watcher, seconds: float) -> bool:
    watcher.look()
    heard = watcher.heard[REFERENCE]
    return bool(heard) and heard[-1].stamp - heard[0].stamp >= seconds * 1e9


def _seen(watcher: Watcher) -> dict[str, object]:
    """Return stamps [s] since the first command, errors |q_l - q_ld| [rad] there, efforts, and state stamps [ns]."""
    wanted = {heard.stamp: heard.message().position for heard in watcher.heard[REFERENCE]}
    states = {heard.stamp: heard.message().position for heard in watcher.heard[STATES]}
    stamps = sorted(set(wanted) & set(states))
    n = len(next(iter(wanted.values())))
    error = [float(np.max(np.abs(np.array(states[s][:n]) - np.array(wanted[s])))) for s in stamps]
    return {
        "time": [(s - stamps[0]) * 1e-9 for s in stamps],
        "error": error,
        "states": [s for s in sorted(states) if s >= stamps[0]],
        "efforts": [list(message.data) for message in watcher.messages(EFFORTS)],
    }


if __name__ == "__main__":
    sys.exit(main())
