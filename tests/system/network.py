# SPDX-License-Identifier: Apache-2.0
"""Two network namespaces joined by a veth pair, each like a separate computer."""

from __future__ import annotations

import json
import os
import subprocess
from contextlib import suppress

from system.executables import Executable

TIME_LIMIT = 120.0  # s


class RefusedError(Exception):
    """Reason why namespaces are not available."""


class Network:
    """Context manager with the namespaces `left` and `right`. Raises RefusedError."""

    def __init__(self) -> None:
        self.left, self.right = (f"fjr-{side}-{os.getpid()}" for side in ("left", "right"))
        self._started: list[Executable] = []

    def __enter__(self) -> Network:
        try:
            self._build()
        except RefusedError:
            self._remove()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        for each in self._started:
            each.kill()
        self._remove()

    def start(self, namespace: str, command: list[str]) -> Executable:
        """Start a command in a namespace."""
        words = ["ip", "netns", "exec", namespace, *command]
        self._started.append(Executable(words, ROS_AUTOMATIC_DISCOVERY_RANGE="SUBNET"))
        return self._started[-1]

    def words(self) -> str:
        """Return the output of all started processes."""
        return "\n".join(each.said_so_far() for each in self._started)

    def sent(self, namespace: str) -> int:
        """Return the number of packets sent from a namespace."""
        shown = ip("-n", namespace, "-s", "-j", "link", "show", "dev", "veth")
        return int(json.loads(shown)[0]["stats64"]["tx"]["packets"])

    def impair(self, delay: str, loss: str) -> None:
        """Delay and lose packets in both directions with `tc netem`; raises RefusedError."""
        for namespace in (self.left, self.right):
            netem = ("qdisc", "add", "dev", "veth", "root", "netem", "delay", delay, "loss", loss)
            _run("tc", "-n", namespace, *netem)

    def _build(self) -> None:
        ip("netns", "add", self.left)
        ip("netns", "add", self.right)
        ip("link", "add", "veth", "netns", self.left, "type", "veth", "peer", "name", "veth", "netns", self.right)
        for number, namespace in enumerate((self.left, self.right), start=1):
            ip("-n", namespace, "address", "add", f"10.77.0.{number}/24", "dev", "veth")
            for device in ("lo", "veth"):
                ip("-n", namespace, "link", "set", device, "up")
            ip("-n", namespace, "route", "add", "default", "dev", "veth")  # multicast, which discovery uses, needs one

    def _remove(self) -> None:
        for namespace in (self.left, self.right):
            with suppress(RefusedError):
                ip("netns", "del", namespace)


def ip(*arguments: str) -> str:
    """Run `ip`; raises RefusedError with its error message."""
    return _run("ip", *arguments)


def _run(*command: str) -> str:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=TIME_LIMIT)
    except FileNotFoundError:
        raise RefusedError(f"`{command[0]}` is not installed") from None
    if done.returncode:
        raise RefusedError(f"`{' '.join(command)}`: {done.stderr.strip()}")
    return done.stdout
