# SPDX-License-Identifier: Apache-2.0
"""Feed all hosts of the control step with the same samples and write docs/tables/hosts.md: `python -m tests.hosts`.

    python -m tests.hosts [--samples 100000] [WORD ...]

The workspace must be sourced. With words, only scenarios and fault rows whose name contains one of them, and the table
is only printed.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(TESTS))

import conftest  # noqa: E402, F401 (a ROS domain of its own)
from bench.figures import markdown, put  # noqa: E402
from faults.fault_rows import ROWS  # noqa: E402
from fjr_msgs_py.scenarios import installed  # noqa: E402
from hosts import recording  # noqa: E402
from hosts.comparison import HOSTS, Compared, Comparison, with_states  # noqa: E402
from hosts.inputs import Sequence  # noqa: E402

SAMPLES = 100_000
TITLES = {"rclpy": "node, rclpy", "native": "node, native thread", "C": "exported C"}
HEAD = ("states of", "states", *(TITLES.get(host, host) for host in HOSTS))


def main(words: list[str]) -> int:
    """Return the exit code: 0 if no effort differs."""
    parser = argparse.ArgumentParser(prog="python -m tests.hosts", description="Compare the hosts of the control step.")
    parser.add_argument("--samples", type=int, default=SAMPLES, help=f"states of each sequence (default: {SAMPLES})")
    parser.add_argument("words", nargs="*", metavar="WORD", help="only sequences whose name contains one of these")
    arguments = parser.parse_args(words)
    done: list[Compared] = []
    print(*markdown(HEAD, [], right=HEAD[1:]), sep="\n")
    with Comparison() as comparison:
        for name, run in _runs(comparison, arguments.samples).items():
            if not arguments.words or any(word in name for word in arguments.words):
                done.append(run())
                print(markdown(HEAD, [cells(done[-1])])[-1], flush=True)
    if not arguments.words:
        put("hosts.md", "hosts", markdown(HEAD, map(cells, done), right=HEAD[1:]))
    return 0 if all(row.equal for row in done) else 1


def _runs(comparison: Comparison, samples: int) -> dict[str, Callable[[], Compared]]:
    """Return the comparisons by the names of scenarios and fault rows."""

    def of_scenario(name: str) -> Compared:
        return comparison.compared(*recording.of_scenario(name, samples))

    def of_sequence(record: Callable[[], Sequence]) -> Compared:
        return comparison.compared(with_states(record(), samples))

    scenarios = {name: partial(of_scenario, name) for name in installed("scenarios")}
    rows = {row.name: partial(of_sequence, partial(recording.of_row, row)) for row in ROWS}
    made = {recording.MISWIRED: recording.of_wrong_wiring, recording.REQUESTS: recording.of_requests}
    return {**scenarios, **rows, **{name: partial(of_sequence, record) for name, record in made.items()}}


def cells(row: Compared) -> tuple[str, ...]:
    """Return the cells of a sequence: its states, and the efforts that differ, of those that each host sent."""
    of_hosts = (f"{row.different[host]} of {row.sent[host]:,}" if host in row.sent else "none" for host in HOSTS)
    return row.name, f"{row.states:,}", *of_hosts


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
