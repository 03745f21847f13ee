# SPDX-License-Identifier: Apache-2.0
"""Exit codes of the `fjr` command."""

from __future__ import annotations

from enum import IntEnum


class Exit(IntEnum):
    """Exit code of `fjr`. Of several runs in one command the first counts of FAILED, VIOLATED, LATE."""

    DONE = 0
    FAILED = 1
    NOT_UNDERSTOOD = 2
    VIOLATED = 3
    LATE = 4
    INTERRUPTED = 130  # 128 + SIGINT, the convention of shells


MEANINGS = {
    Exit.DONE: "done; of a run: finished, with a status other than those below",
    Exit.FAILED: "failed: an error, or the controller stopped during the run",
    Exit.NOT_UNDERSTOOD: "the command line, the scenario or another file is not valid",
    Exit.VIOLATED: "the run finished, and its status is `violated`",
    Exit.LATE: "the run finished, but the computer answered too late to judge the law; try --lockstep",
    Exit.INTERRUPTED: "ended by Ctrl-C or SIGTERM before it was done",
}
HELP = "exit codes:\n" + "\n".join(f"  {code:<4} {meaning.replace('`', '')}" for code, meaning in MEANINGS.items())
