# SPDX-License-Identifier: Apache-2.0
"""False alarms and delay of the contact alarm, beside a momentum observer with fixed thresholds.

    python -m bench.contact_alarm --scenario arm7 --hours 1 --seed 1 FOLDER     simulate, a file an hour
    python -m bench.contact_alarm --bits 14 --hours 1 FOLDER    the same with encoders of 14 bits; prints its figures
    python -m bench.contact_alarm FOLDER                        write the tables of docs/tables/contact.md

Every minute a robot is drawn that differs from the model by the stated errors, and a pose and sines about it. The links
follow them; the springs carry what the drawn robot needs, by a recursion that the observer does not use. Encoders and
velocities are noisy, the time between two states varies, and some states are late. From the states AT on, 20 N in a
random direction act on the tip for TRIAL states. Fixed thresholds are the largest estimates of all minutes, the least
that give no alarm in them, and those that give one alarm an hour.
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
from fjr_core.monitoring.external_torque import STICKING, TorqueObserverStruct
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import compiled
from fjr_core.numerics.symbolic import bind, dense_function, symbols
from fjr_core.runtime.library import step_library
from fjr_msgs_py.scenarios import library

SCENARIO, FORCE = "arm7", 20.0  # of the tables of delays; N
SCENARIOS = (SCENARIO, "two_link")
MINUTE, TRIAL, AT = 60_000, 300, (2_000, 10_000, 59_000)  # states, 1 ms apart
JITTER, LATE, LATEST = 0.2, 1e-3, 0.1  # deviation of the time between two, as a share; share that is late; s
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
    """The alarm of a scenario, run on drawn robots; bits: of the encoders per turn, 0: exact ones."""

    def __init__(self, name: str, bits: int = 0) -> None:
        self.step = 2 * np.pi / 2**bits if bits else 0.0
        scenario: Scenario = library.as_run(library.find(name), {})[1]
        self.robot, self.n = scenario.robot, scenario.robot.n
        self.observer = contact_observer(scenario.controller_values, self.robot)
        self.library, k = step_library(self.n), MINUTE + 1
        self._arguments = [np.empty((k, self.n)) for _ in range(4)]
        self._results = [np.empty((k, self.n)), np.empty((k, 3 * self.n))]
        self._evaluate = bind(compiled(self._needed()).map(k), self._arguments, self._results)

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
        """Run a minute of a drawn robot, longer by what its states are late."""
        n, robot, (q, dq, _, factors), (torque, tip) = self.n, self.robot, self._arguments, self._results
        apart = 1e-3 * (1 + JITTER * rng.uniform(-1, 1, len(q)))
        late = rng.random(len(q)) < LATE
        apart[late] = rng.uniform(1e-3, LATEST, late.sum())
        stamps = np.round(1e9 * np.cumsum(apart)).astype(np.int64)
        self._move(rng, 1e-9 * stamps.astype(float)[:, None])
        errors: Array = (self.observer.errors.deviations * rng.normal(size=5 * n)).reshape(5, n)
        mass, stiffness, damping, friction, constant = errors
        factors[:] = 1 + mass
        self._evaluate()
        torque += (1 + damping) * np.diag(robot.D_l) * dq + friction * np.tanh(dq / STICKING) - constant
        position, velocity = np.empty((len(q), 2 * n)), np.zeros((len(q), 2 * n))
        K = (1 + stiffness) * np.diag(robot.K)
        position[:, :n], position[:, n:] = q, q + torque / K
        position += POSITION_NOISE * rng.normal(size=position.shape)
        velocity[:, :n] = dq + VELOCITY_NOISE * rng.normal(size=dq.shape)
        watch, runs, largest, alarms = Watch(self), [], np.zeros(n), 0
        for begin, at in pairwise((0, *AT, len(q))):
            free, acting = watch.along(stamps[begin:at], position[begin:at], velocity[begin:at])
            largest = np.maximum(largest, np.abs(free).max(axis=0))
            alarms += int((np.diff(acting) > 0).sum())
            if at == len(q):
                break
            force, trial = rng.normal(size=3), slice(at, at + TRIAL)
            push = tip[trial].reshape(-1, 3, n).transpose(0, 2, 1) @ (FORCE * force / np.linalg.norm(force))
            pushed = position[trial].copy()
            pushed[:, n:] -= push / K
            runs.append(watch.tried(stamps[trial], pushed, velocity[trial]))
        threshold, delay, traces = (np.array(each) for each in zip(*runs, strict=True))
        return Minute(alarms, largest, q[list(AT)], threshold, delay, traces)

    def _move(self, rng: np.random.Generator, t: Array) -> None:
        """Move each joint by two sines about a random pose, at times (k, 1) [s]."""
        (q, dq, ddq), limits = self._arguments[:3], self.robot.limits
        lower, upper = (-np.pi, np.pi) if limits is None else (limits.lower, limits.upper)
        q[:], dq[:], ddq[:] = rng.uniform(0.7 * lower, 0.7 * upper, self.n), 0.0, 0.0
        for _ in range(2):
            w, phase = 2 * np.pi * rng.uniform(0.1, 0.8, self.n), rng.uniform(0, 2 * np.pi, self.n)
            angle = w * t + phase
            sine = SWING * np.sin(angle)
            q += sine
            dq += SWING * w * np.cos(angle)
            ddq -= w**2 * sine


class Watch:
    """The alarm in C for one robot."""

    def __init__(self, study: Study) -> None:
        ffi, n = study.library.ffi, study.n
        self._step = study.step
        self._ffi, self._watch = ffi, study.library.lib.fjr_watch_torque
        self._held = TorqueObserverStruct(ffi, study.observer)
        self._o, self._c = self._held.pointer, ffi.new("struct fjr_contact*")
        self._threshold = np.frombuffer(ffi.buffer(self._o.compared))[n:]
        self._estimates = np.frombuffer(ffi.buffer(self._o.kept + 2 * n * (1 + self._o.errors), 8 * n))

    def along(self, stamps: NDArray[np.int64], position: Array, velocity: Array) -> tuple[Array, NDArray[np.int32]]:
        """Return the estimates (k, n) [N m] at k states, and whether there is contact (k + 1,), first before them."""
        k, width = position.shape
        if self._step:
            position = np.round(position / self._step) * self._step
        found, acting = np.empty((k, width // 2)), np.full(k + 1, self._c.acting, dtype=np.int32)
        positions, velocities = (self._ffi.from_buffer("double[]", values) for values in (position, velocity))
        for i, stamp in enumerate(stamps.tolist()):
            self._watch(self._o, self._c, positions + width * i, velocities + width * i, stamp)
            found[i], acting[i + 1] = self._estimates, self._c.acting
        return found, acting

    def tried(self, stamps: NDArray[np.int64], position: Array, velocity: Array) -> tuple[Array, int, Array]:
        """Return threshold (n,), delay [states] and estimates (k, n) of a trial, and forget it."""
        parts = [self._ffi.buffer(self._o), self._ffi.buffer(self._c)]
        parts += [self._ffi.buffer(each) for each in self._held.arrays.values()]
        kept, threshold = [bytes(part) for part in parts], self._threshold.copy()
        found, acting = self.along(stamps, position, velocity)
        for part, before in zip(parts, kept, strict=True):
            part[:] = before
        return threshold, int(_first(acting[1:, None] > 0)), found


def simulate(folder: Path, scenario: str, hours: int, seed: int, bits: int = 0) -> None:
    """Simulate the hours of a scenario that the folder lacks of a seed."""
    study, name = Study(scenario, bits), f"{bits}bit-{scenario}" if bits else scenario
    folder.mkdir(parents=True, exist_ok=True)
    for hour in range(hours):
        file = folder / f"{name}-{seed}-{hour}.npz"
        if file.exists():
            continue
        minutes = [study.minute(np.random.default_rng([seed, hour, k])) for k in range(60)]
        columns: dict[str, Any] = dict(zip(Minute._fields, map(np.array, zip(*minutes, strict=True)), strict=True))
        np.savez_compressed(file, **columns)
        threshold, delay = (np.median([each[-1] for each in columns[name]], axis=0) for name in ("threshold", "delay"))
        said = f"thresholds {' '.join(_row(threshold))} N m, 20 N seen after {_ms(delay)} ms"
        print(f"{file.name}: {sum(columns['alarms'])} alarms, {said}", flush=True)


def tables(folder: Path) -> Iterator[str]:
    """Yield the lines of the tables of all hours in the folder."""
    files = sorted(folder.glob("*.npz"))
    alarms = [(file.name.split("-")[0], int(np.load(file)["alarms"].sum())) for file in files]
    counted = []
    for which in (*sorted({scenario for scenario, _ in alarms}), "all"):
        of_hours = [number for scenario, number in alarms if which in (scenario, "all")]
        hours, number = len(of_hours), sum(of_hours)
        most = stats.chi2.ppf(0.95, 2 * number + 2) / 2 / hours * 24
        counted.append((which, f"{hours:,}", f"{60 * hours:,}", str(number), f"{most:.2g}"))
    columns = ["scenario", "hours", "robots", "false alarms", "in 24 h at most, with 95 % confidence"]
    yield from markdown(columns, counted, right=columns[1:])

    files = [file for file in files if file.name.startswith(f"{SCENARIO}-")]
    parts = [[np.load(file)[name] for file in files] for name in ("largest", "pose", "threshold", "delay")]
    largest, pose, threshold, own = map(np.concatenate, parts)
    n = largest.shape[1]
    fixed = {"equal": largest.max(axis=0), "hourly": np.quantile(largest, 1 - 1 / (60 * n), axis=0)}
    first = [[_first(np.abs(np.load(file)["torque"]) > thresholds) for file in files] for thresholds in fixed.values()]
    late = dict(zip(fixed, map(np.concatenate, first), strict=True))
    delays = []
    for k, at in enumerate(AT):
        delays.append((f"{at * 1e-3:g}", "stated errors", *_delay(own[:, k]), ""))
        for name, samples in late.items():
            twice = _share(samples[:, k] >= 2 * own[:, k])
            delays.append((f"{at * 1e-3:g}", PEERS[name], *_delay(samples[:, k]), twice))
    pushed = f"{FORCE:g} N in a random direction at the tip of `{SCENARIO}`"
    yield f'\n{pushed}; delays in states of 1 ms, "missed" if longer than {TRIAL}:\n'
    columns = ["s after the start", "thresholds", "median", "95 %", "missed", "at least twice as late"]
    yield from markdown(columns, delays, right={*columns} - {"thresholds"})

    reach, by_reach = _reach(pose[:, -1]), []
    for low, high in pairwise((0.0, *REACHES, np.inf)):
        rows = (reach >= low) & (reach < high)
        thresholds = _row(np.median(threshold[rows, -1], axis=0))
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
    tip = Study(SCENARIO).robot.links.end_effector
    assert tip is not None
    return np.array([float(np.hypot(*tip.position(q, np.zeros(3)).full()[:2, 0])) for q in poses])


def main() -> None:
    """Simulate hours, or write the table of those that there are."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--scenario", choices=SCENARIOS, default=SCENARIO)
    parser.add_argument("--hours", type=int, default=0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--bits", type=int, default=0)
    given = parser.parse_args()
    if given.hours:
        simulate(given.folder, given.scenario, given.hours, given.seed, given.bits)
    elif not any(given.folder.glob(f"{SCENARIO}-*.npz")):
        parser.error(f"{given.folder} has no hours of {SCENARIO}; expected some, by --hours")
    else:
        put("contact.md", "contact", tables(given.folder))


if __name__ == "__main__":
    main()
