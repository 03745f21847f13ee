# SPDX-License-Identifier: Apache-2.0
"""False alarms and delay of the contact alarm on arm7, beside a momentum observer with fixed thresholds.

    python -m bench.contact_alarm --hours 1 --seed 1 FOLDER     simulate, a file an hour
    python -m bench.contact_alarm FOLDER                        write the tables of docs/tables/contact.md

Every minute a robot is drawn that differs from the model by the stated errors, and a pose and sines about it. The links
follow them; the springs carry what the drawn robot needs, by a recursion that the observer does not use. Encoders and
velocities are noisy. At the times AT, 20 N in a random direction act on the tip for TRIAL. Fixed thresholds are the
largest estimates of all minutes, the least that give no alarm in them, and those that give one alarm an hour.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import stats

from bench.figures import markdown, put
from fjr_core.config.controller import contact_observer
from fjr_core.config.scenario import Scenario
from fjr_core.model.newton_euler import ChainAt, Mass, mass_of
from fjr_core.monitoring.contact import STICKING
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import compiled
from fjr_core.numerics.symbolic import dense_function, symbols
from fjr_core.runtime.library import step_library
from fjr_msgs_py.scenarios import library

SCENARIO, FORCE = "arm7", 20.0  # N
MINUTE, TRIAL, AT = 60_000, 300, (2_000, 10_000, 59_000)  # samples at 1 kHz
POSITION_NOISE, VELOCITY_NOISE = 5e-6, 5e-4  # rad, rad/s
SWING = 0.3  # rad, of each of two sines
REACHES = (0.3, 0.5, 0.7)  # m, of the tip from the axis of joint 1, between the rows of the table
PEERS = {"equal": "fixed, no alarm in these hours", "hourly": "fixed, an alarm an hour"}


class Minute(NamedTuple):
    """What a minute shows, or with one more axis what several show. alarms: without contact.

    largest (n,) [N m]: estimates without contact. pose (3, n) [rad]: at the times AT. threshold (3, n) [N m]: there.
    delay (3,) [samples]: until the alarm. torque (3, TRIAL, n) [N m]: estimates under the push.
    """

    alarms: Any
    largest: Array
    pose: Array
    threshold: Array
    delay: Array
    torque: Array


class Study:
    """The alarm of the scenario, run on drawn robots."""

    def __init__(self) -> None:
        scenario: Scenario = library.as_run(library.find(SCENARIO), {})[1]
        self.robot, self.n = scenario.robot, scenario.robot.n
        self.observer = contact_observer(scenario.controller_values, self.robot)
        self.library = step_library(self.n)
        self.needed = compiled(self._needed())

    def _needed(self) -> ca.Function:
        """Return (q, dq, ddq, factors) -> torques of bodies with scaled masses, and J' of the tip by columns."""
        n, links = self.n, self.robot.links
        s = symbols(q=n, dq=n, ddq=n, factors=n)
        factors = ca.vertsplit(s["factors"])
        masses = [Mass(f * m.m, f * m.h, f * m.J) for f, m in zip(factors, map(mass_of, links.bodies), strict=True)]
        assert links.end_effector is not None
        chain = ChainAt(links.bodies, masses, links.end_effector.gravity, s["q"])
        torque = chain.inertial_torque(s["dq"], s["dq"], s["ddq"]) + chain.gravity_torque()
        tip = ca.jacobian(links.end_effector.position(s["q"], ca.SX.zeros(3)), s["q"])
        return dense_function("needed", s, {"torque": torque, "tip": ca.vec(tip.T)}, cse=True)

    def minute(self, rng: np.random.Generator) -> Minute:
        """Run a minute of a drawn robot."""
        n, robot = self.n, self.robot
        t = np.arange(MINUTE + 1, dtype=np.float64)[:, None] * 1e-3
        q, dq, ddq = self._motion(rng, t)
        errors: Array = (self.observer.errors.deviations * rng.normal(size=5 * n)).reshape(5, n)
        mass, stiffness, damping, friction, constant = errors
        factors = np.tile((1 + mass)[:, None], len(t))
        torque, tip = (each.full().T for each in self.needed.map(len(t))(q.T, dq.T, ddq.T, factors))
        torque += (1 + damping) * np.diag(robot.D_l) * dq + friction * np.tanh(dq / STICKING) - constant
        position, velocity = np.empty((len(t), 2 * n)), np.zeros((len(t), 2 * n))
        K = (1 + stiffness) * np.diag(robot.K)
        position[:, :n], position[:, n:], velocity[:, :n] = q, q + torque / K, dq
        position += POSITION_NOISE * rng.normal(size=position.shape)
        velocity += VELOCITY_NOISE * rng.normal(size=velocity.shape)
        watch, runs, largest, alarms = Watch(self), [], np.zeros(n), 0
        for begin, at in pairwise((0, *AT, len(t))):
            free, seen = watch.along(position[begin:at], velocity[begin:at], begin)
            largest, alarms = np.maximum(largest, np.abs(free).max(axis=0)), alarms + seen
            if at == len(t):
                break
            force = rng.normal(size=3)
            jacobian = tip[at : at + TRIAL].reshape(-1, 3, n).transpose(0, 2, 1)
            push = jacobian @ (FORCE * force / np.linalg.norm(force))
            pushed = position[at : at + TRIAL].copy()
            pushed[:, n:] -= push / K
            runs.append(watch.tried(pushed, velocity[at : at + TRIAL], at))
        threshold, delay, traces = (np.array(each) for each in zip(*runs, strict=True))
        return Minute(alarms, largest, q[list(AT)], threshold, delay, traces)

    def _motion(self, rng: np.random.Generator, t: Array) -> tuple[Array, Array, Array]:
        """Return positions, velocities and accelerations (k, n) of two sines a joint about a random pose."""
        n, limits = self.n, self.robot.limits
        assert limits is not None
        q = rng.uniform(0.7 * limits.lower, 0.7 * limits.upper)[None]
        dq = ddq = np.zeros((1, n))
        for _ in range(2):
            w, phase = 2 * np.pi * rng.uniform(0.1, 0.8, n), rng.uniform(0, 2 * np.pi, n)
            angle = w * t + phase
            q, dq, ddq = q + SWING * np.sin(angle), dq + SWING * w * np.cos(angle), ddq - SWING * w**2 * np.sin(angle)
        return q, dq, ddq


class Watch:
    """The alarm in C for one robot."""

    def __init__(self, study: Study) -> None:
        ffi, n = study.library.ffi, study.n
        self._watch, self._ffi = study.library.lib.fjr_watch_torque, ffi
        self._held = study.observer.struct(ffi)
        self._o, self._c = self._held.pointer, ffi.new("struct fjr_contact*")
        size = n * (1 + self._o.errors)
        self._r = np.frombuffer(ffi.buffer(self._o.kept, 24 * size))[2 * size : 2 * size + n]
        self._threshold = np.frombuffer(ffi.buffer(self._o.compared))[n:]

    def along(self, position: Array, velocity: Array, first: int) -> tuple[Array, int]:
        """Return the estimates (k, n) [N m] at k samples from the number `first` on, and the alarms."""
        k, two = position.shape
        given = [self._ffi.from_buffer("double[]", np.ascontiguousarray(each)) for each in (position, velocity)]
        found, alarms, acting = np.empty((k, two // 2)), 0, self._c.acting
        for i in range(k):
            self._watch(self._o, self._c, given[0] + two * i, given[1] + two * i, (first + i) * 1_000_000)
            found[i] = self._r
            if self._c.acting != acting:
                acting = self._c.acting
                alarms += acting
        return found, alarms

    def tried(self, position: Array, velocity: Array, first: int) -> tuple[Array, int, Array]:
        """Return threshold (n,), delay [samples] and estimates (k, n) of a trial, and forget it."""
        parts = [self._ffi.buffer(self._o), self._ffi.buffer(self._c)]
        parts += [self._ffi.buffer(each) for each in self._held.arrays.values()]
        kept = [bytes(part) for part in parts]
        found, delay, threshold = [], len(position), self._threshold.copy()
        for i in range(len(position)):
            found.append(self.along(position[i : i + 1], velocity[i : i + 1], first + i)[0][0])
            if self._c.acting and delay == len(position):
                delay = i + 1
        for part, before in zip(parts, kept, strict=True):
            part[:] = before
        return threshold, delay, np.array(found)


def simulate(folder: Path, hours: int, seed: int) -> None:
    """Simulate the hours that the folder lacks of a seed."""
    study = Study()
    folder.mkdir(parents=True, exist_ok=True)
    for hour in range(hours):
        file = folder / f"{seed}-{hour}.npz"
        if file.exists():
            continue
        minutes = [study.minute(np.random.default_rng([seed, hour, k])) for k in range(60)]
        columns: dict[str, Any] = dict(zip(Minute._fields, map(np.array, zip(*minutes, strict=True)), strict=True))
        np.savez_compressed(file, **columns)
        print(f"{file.name}: {sum(each.alarms for each in minutes)} alarms", flush=True)


def tables(folder: Path) -> Iterator[str]:
    """Yield the lines of the tables of all hours in the folder."""
    files = [np.load(file) for file in sorted(folder.glob("*.npz"))]
    found = Minute(*(np.concatenate([each[name] for each in files]) for name in Minute._fields))
    hours, alarms, own, largest = len(files), int(found.alarms.sum()), found.delay, found.largest
    n = largest.shape[1]
    fixed = {"equal": largest.max(axis=0), "hourly": np.quantile(largest, 1 - 1 / (60 * n), axis=0)}
    late = {name: _first(np.abs(found.torque) > thresholds) for name, thresholds in fixed.items()}
    most = stats.chi2.ppf(0.95, 2 * alarms + 2) / 2 / hours * 24
    counted = f"**{alarms} false alarms in {hours} h** ({len(own)} robots)"
    yield f"{counted}: at most {most:.2g} in 24 h with 95 % confidence."

    delays = []
    for k, at in enumerate(AT):
        delays.append((f"{at * 1e-3:g}", "stated errors", *_delay(own[:, k]), ""))
        for name, samples in late.items():
            twice = _share(samples[:, k] >= 2 * own[:, k])
            delays.append((f"{at * 1e-3:g}", PEERS[name], *_delay(samples[:, k]), twice))
    yield f'\n{FORCE:g} N in a random direction at the tip; delays in ms, "missed" if longer than {TRIAL} ms:\n'
    columns = ["s after the start", "thresholds", "median", "95 %", "missed", "at least twice as late"]
    yield from markdown(columns, delays, right={*columns} - {"thresholds"})

    reach, by_reach = _reach(found.pose[:, -1]), []
    for low, high in pairwise((0.0, *REACHES, np.inf)):
        rows = (reach >= low) & (reach < high)
        thresholds = _row(np.median(found.threshold[rows, -1], axis=0))
        medians = (_ms(np.median(each[rows, -1])) for each in (own, *late.values()))
        place = f"{low:g} to {high:g} m" if high < np.inf else f"{low:g} m and more"
        by_reach.append((place, str(rows.sum()), *thresholds, *medians))
    by_reach += [(PEERS[name], "", *_row(each), "", "", "") for name, each in fixed.items()]
    distances = "by the distance of the tip from the axis of joint 1"
    yield f"\nMedian thresholds [N m] after {AT[-1] // 1000} s, {distances}, and median delays [ms]:\n"
    columns = ["reach", "robots", *(f"joint {j + 1}" for j in range(n)), "stated errors", "fixed", "fixed, 1/h"]
    yield from markdown(columns, by_reach, right=columns[1:])


def _first(beyond: NDArray[Any]) -> NDArray[Any]:
    """Return the number of the first of TRIAL samples (.., TRIAL, n) at which a joint is beyond, TRIAL for none."""
    seen = beyond.any(axis=-1)
    return np.where(seen.any(axis=-1), seen.argmax(axis=-1) + 1, TRIAL)


def _row(values: Array) -> list[str]:
    return [f"{each:.2f}" for each in values]


def _delay(samples: Array) -> tuple[str, str, str]:
    """Return median and 95 % quantile, and how often there was no alarm."""
    median, most = np.quantile(samples, (0.5, 0.95), method="inverted_cdf")
    return _ms(median), _ms(most), _share(samples >= TRIAL)


def _ms(delay: float) -> str:
    return f"{delay:g}" if delay < TRIAL else f"over {TRIAL}"


def _share(cases: NDArray[Any]) -> str:
    return f"{100 * np.mean(cases):.1f} %"


def _reach(poses: Array) -> Array:
    """Return the distances (k,) [m] of the tip from the axis of the first joint."""
    tip = Study().robot.links.end_effector
    assert tip is not None
    return np.array([float(np.hypot(*tip.position(q, np.zeros(3)).full()[:2, 0])) for q in poses])


def main() -> None:
    """Simulate hours, or write the table of those that there are."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--hours", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    if given.hours:
        simulate(given.folder, given.hours, given.seed)
    else:
        put("contact.md", "contact", tables(given.folder))


if __name__ == "__main__":
    main()
