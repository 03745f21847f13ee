# SPDX-License-Identifier: Apache-2.0
"""Records of sampled loops with faults of sensors, efforts and robot, and the certificate in C of such loops."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from typing import Any

import numpy as np

import fjr_core as fjr
from fjr_core.monitoring.certificate import Certificate, Prediction
from fjr_core.motions.reference import Reference
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import record_type
from fjr_core.runtime.events import NEVER
from fjr_core.runtime.library import CertificateStruct, step_library
from fjr_monitor.diagnosis.online_diagnosis import LatestIntervals
from fjr_monitor.diagnosis.record import Record
from fjr_monitor.diagnosis.thresholds import LONGEST_JUDGED

PERIOD = 1e-3
LARGEST = 1e3  # rad; a robot beyond this position has diverged
Sensed = Callable[[Array, Array], tuple[Array, Array]]


def recorded(
    law: fjr.TrackingLaw,
    reference: Reference,
    x: Array,
    samples: int,
    robot: fjr.Robot | None = None,
    sensed: Sensed = lambda q, dq: (q, dq),
    commanded: Callable[[Array], Array] = lambda u: u,
    acting: Callable[[Array], Array] = lambda u: u,
    limit: float = np.inf,
    steps: int = 2,
) -> Record:
    """Return the record of a loop from the state x on, or until its robot has diverged.

    robot: the plant; None: the model of the law. sensed: what is measured of positions and velocities. commanded,
    acting: what is sent of the effort of the law, and what acts of it. limit [N m]: known effort limit. steps: of the
    integrator in a sample.
    """
    real = robot or law.robot
    plant, rows = fjr.Plant(real), []
    for k in range(samples):
        if not np.abs(x).max() < LARGEST:
            break
        q, dq = sensed(x[: 2 * real.n], np.concatenate(real.velocities(x)))
        jets = reference.jets(k * PERIOD)
        u = commanded(law.measured_command(q, dq, jets)[0])
        rows.append((k * PERIOD, q, dq, jets, u))
        acts = acting(u)
        try:
            for _ in range(steps):
                x = plant.step(x, acts, PERIOD / steps)
        except fjr.StateError:
            break
    t, position, velocity, jets, u = map(np.array, zip(*rows, strict=True))
    return Record(t, position, velocity, jets, u, None, None, None, PERIOD, np.full(real.n, limit))


INNER = PERIOD / 4
"""Time [s] between the instants from which an effort may act, as in the simulated robot."""
KNOWN = 0.07e-3  # s, from a state to its command by the send times


def in_real_time(
    law: fjr.TrackingLaw,
    reference: Reference,
    x: Array,
    samples: int,
    robot: fjr.Robot | None = None,
    lost: Collection[int] = (),
    begins: Callable[[int], int] = lambda k: 2,
    unheard: Collection[int] = (),
    noise: float = 0.0,
) -> Iterator[tuple[int, Array, Array, Array, Array]]:
    """Yield number, positions, velocities, jets and effort of each state of a loop on a late computer, from x on.

    robot: the plant; None: the model of the law. lost: samples without a state, through which the older effort acts.
    begins: after how many INNER steps the effort of a state acts, or from the last lost sample after it on. unheard:
    samples whose commands never reach the robot. noise [rad/s]: standard deviation of that of the velocities.
    """
    plant, older, rng = fjr.Plant(robot or law.robot), None, np.random.default_rng(1)
    for k in (k for k in range(samples) if k not in lost):
        q, dq, jets = x[: len(x) // 2], np.concatenate(plant.robot.velocities(x)), reference.jets(k * PERIOD)
        dq = dq + noise * rng.standard_normal(len(dq))
        u = law.measured_command(q, dq, jets)[0]
        yield k, q, dq, jets, u
        last = next(j for j in range(k, samples + 1) if j + 1 not in lost)
        older = u if older is None else older
        u = older if k in unheard else u
        for step in range(4 * (last + 1 - k)):
            x = plant.step(x, older if step < 4 * (last - k) + begins(k) else u, INNER)
        older = u


def record_in_real_time(law: fjr.TrackingLaw, *given: Any, **more: Any) -> Record:
    """Return the record of `in_real_time`, with the latency KNOWN."""
    k, *rows = zip(*in_real_time(law, *given, **more), strict=True)
    position, velocity, jets, u = map(np.array, rows)
    t, endless = PERIOD * np.array(k), np.full(law.robot.n, np.inf)
    return Record(t, position, velocity, jets, u, None, t, t + KNOWN, PERIOD, endless)


class Certified(LatestIntervals):
    """Intervals certified by fjr_certify of step.h, one state after the other, as in the hosts."""

    def __init__(self, law: fjr.TrackingLaw) -> None:
        library = step_library(law.robot.n)
        super().__init__(law.robot.n, library)
        certificate, prediction = Certificate(law).function, Prediction(law).function
        functions = {"certify": certificate, "predict": prediction, "law": law.function}
        ffi, self._lib = library.ffi, library.lib
        self.struct = CertificateStruct(ffi, functions, law, LONGEST_JUDGED)
        self.struct.pointer.gains = self.struct.keep(law)
        kinds = {name: f"struct fjr_{name}" for name in ("certified", "command")}
        self._records = {name: np.zeros(1, record_type(ffi, ffi.typeof(kind))) for name, kind in kinds.items()}
        self._pointers = {
            name: ffi.from_buffer(f"{kinds[name]}[]", made.view(np.uint8)) for name, made in self._records.items()
        }
        self.restart()

    def restart(self) -> None:
        """Let the next state have no predecessor, and start the bound on V again."""
        self._lib.fjr_certificate_restart(self.struct.pointer)

    def certify(
        self,
        stamp: int,
        *state: Array,
        bound_start: int | None = None,
        restarted: bool = False,
    ) -> Any:
        """Return struct fjr_certified of the state: position, velocity, jets and u at a stamp [ns]."""
        for name, values in zip(("position", "velocity", "jets", "u"), state, strict=True):
            self._records["command"][name][0] = np.ravel(values)
        command, found = self._pointers["command"][0], self._pointers["certified"]
        command.bound_start, command.restarted = NEVER if bound_start is None else bound_start, restarted
        assert self._lib.fjr_certify(self.struct.pointer, self._pointers["command"], stamp, found)
        return found[0]

    def take(self, stamp: int, *state: Array, latency: float = 0.0) -> Any:
        """Certify the next state and append it; latency [s]: delay of its command, 0: not known."""
        found = self.certify(stamp, *state)
        self.append(**self._records, latency=np.array([latency]))
        return found
