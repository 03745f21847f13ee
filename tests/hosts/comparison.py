# SPDX-License-Identifier: Apache-2.0
"""Feed every host of the control step with the same inputs and count the efforts that differ."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.logging import LoggingSeverity, get_logger_effective_level, set_logger_level

from fjr_core.config.scenario import Scenario
from hosts.efforts import (
    EXECUTORS,
    Efforts,
    NodeHost,
    Replay,
    c_program,
    controller_program,
    program_efforts,
    reference_replay,
    study_efforts,
)
from hosts.inputs import Kind, Sequence

ROS2_CONTROL = "ros2_control"
HOSTS = (*EXECUTORS, "study", "C", ROS2_CONTROL)
"""Hosts of the control step: nodes in rclpy and with a native thread, study, exported C, exported controller."""
Build = Callable[[Scenario, Path], Path]


@dataclass(frozen=True)
class Compared:
    """States of a sequence, and for each host to which it can be given how many efforts it sent and how many differ."""

    name: str
    states: int
    sent: dict[str, int]
    different: dict[str, int]

    @property
    def equal(self) -> bool:
        """True if no effort differs."""
        return not any(self.different.values())


class Comparison:
    """All hosts; programs are built once for each parameter file.

    Use as a context: nodes and files are removed at its end, and until then nodes log nothing.
    """

    def __enter__(self) -> Comparison:
        self._folder = tempfile.TemporaryDirectory(prefix="fjr-hosts-")
        self._context = Context()
        rclpy.init(args=[], context=self._context)
        self._level = get_logger_effective_level("")
        set_logger_level("", LoggingSeverity.FATAL)  # of the whole process
        self._programs: dict[tuple[str, str], Path] = {}
        return self

    def __exit__(self, *_: object) -> None:
        set_logger_level("", self._level)
        self._context.try_shutdown()
        self._folder.cleanup()

    def compared(self, sequence: Sequence, study: Efforts | None = None) -> Compared:
        """Feed all hosts; study (k, n): efforts of a study whose samples the sequence has."""
        expected = reference_replay(sequence)
        found = {host: self._node_efforts(host, sequence, expected) for host in EXECUTORS}
        found["study"] = study_efforts(sequence) if study is None else study
        found["C"] = self._program_efforts(c_program, sequence)
        different = {host: differences(efforts, expected.efforts) for host, efforts in found.items()}
        if not sequence.has_requests:
            fewer = reference_replay(sequence, repeats=False)
            found[ROS2_CONTROL] = self._program_efforts(controller_program, sequence)
            different[ROS2_CONTROL] = differences(found[ROS2_CONTROL], fewer.efforts)
        sent = {host: len(efforts) for host, efforts in found.items()}
        return Compared(sequence.name, sequence.states, sent, different)

    def _node_efforts(self, host: str, sequence: Sequence, expected: Replay) -> Efforts:
        node = NodeHost(self._context, host, sequence, Path(self._folder.name, "parameters.yaml"))
        try:
            return node.efforts(expected.counts)
        finally:
            node.close()

    def _program_efforts(self, build: Build, sequence: Sequence) -> Efforts:
        key = build.__name__, sequence.document
        if key not in self._programs:
            self._programs[key] = build(sequence.scenario, Path(self._folder.name, str(len(self._programs))))
        return program_efforts(self._programs[key], sequence)


def differences(found: Efforts, expected: Efforts) -> int:
    """Return how many efforts (k, n) differ in a bit, with those that are missing or too many."""
    common = min(len(found), len(expected))
    bits = [np.ascontiguousarray(each[:common]).view(np.int64) for each in (found, expected)]
    return int((bits[0] != bits[1]).any(axis=1).sum()) + abs(len(found) - len(expected))


def with_states(sequence: Sequence, states: int) -> Sequence:
    """Return a sequence with as many rounds as give this number of states."""
    each = sum(one.kind is Kind.STATE for one in sequence.inputs)
    return replace(sequence, rounds=-(-states // each))
