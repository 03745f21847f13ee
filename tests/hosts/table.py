# SPDX-License-Identifier: Apache-2.0
"""Format the table of docs/tables/hosts.md between its markers."""

from __future__ import annotations

from hosts.comparison import HOSTS, Compared

BEGIN = "<!-- hosts: written by python -m tests.hosts -->"
END = "<!-- end of hosts -->"
TITLES = {"rclpy": "node, rclpy", "native": "node, native thread", "campaign": "study", "C": "exported C"}


def head() -> str:
    """Return the first two lines of the table as Markdown."""
    titles = " | ".join(TITLES.get(host, host) for host in HOSTS)
    return f"| states of | states | {titles} |\n| --- | ---: |{' ---: |' * len(HOSTS)}"


def line(row: Compared) -> str:
    """Return the line of a sequence: its states, and the efforts that differ, of those that each host sent."""
    cells = (f"{row.different[host]} of {row.sent[host]:,}" if host in row.sent else "none" for host in HOSTS)
    return f"| {row.name} | {row.states:,} | {' | '.join(cells)} |"


def written(document: str, text: str) -> str:
    """Return the document with `text` between its markers."""
    before, rest = document.split(BEGIN)
    return f"{before}{BEGIN}\n{text}\n{END}{rest.split(END)[1]}"
