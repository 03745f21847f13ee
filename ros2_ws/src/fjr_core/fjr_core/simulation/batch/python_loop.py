# SPDX-License-Identifier: Apache-2.0
"""Python equivalent of loop.c, for a law or plant in Python and machines without a C compiler: same results, slower."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...numerics.casadi_function import NumericFunction
from ...numerics.checks import Array
from . import counter_rng
from .outcomes import FIELDS
from .program import Program


def run(program: Program, c: Mapping[str, Any]) -> None:
    """Fill c["rows"] and, if present, c["trace"]; c: the values of struct batch in loop.c."""
    for i in range(len(c["rows"])):
        c["rows"][i] = _One(program, c, i).row()


class _One:
    """Simulation of one run."""

    def __init__(self, program: Program, c: Mapping[str, Any], i: int) -> None:
        self.c, self.i, self.n = c, i, program.robot.n
        kind = "full" if c["full"][i] else "plain"
        self.law, self.step, self.velocity, state = (
            NumericFunction(program.bindable[name])
            for name in ("law", f"{kind}_step", f"{kind}_velocity", f"{kind}_state")
        )
        self.parameters = c["parameters"][i]
        self.x = state(c["position"], c["velocity"], self.parameters)[0]
        self.memory = c["memory"].copy()
        self.sent: list[NDArray[Any]] = [np.zeros(self.n)]
        self.errors: list[NDArray[Any]] = []
        self.power: list[float] = []

    def row(self) -> Array:
        """Simulate the run and return its row of outcomes; see Outcomes."""
        lost = next((k for k in range(self.c["samples"] + 1) if not self._sample(k)), None)
        n, period, sent = self.n, self.c["period"], np.array(self.sent[1:]).reshape(-1, self.n)
        result: dict[str, Any] = {name: np.full(n, np.inf) for name in ("rms", "peak", "final")}
        result |= {"stable": lost is None, "lost_at": np.inf if lost is None else period * lost, "settling": np.inf}
        if lost is None:
            result |= self._tracking(np.array(self.errors))
        count = max(1, len(sent))
        result["effort_rms"] = np.sqrt(np.sum(sent**2, axis=0) / count)
        result["effort_peak"] = np.max(np.abs(sent), axis=0, initial=0.0)
        result["power"] = sum(self.power) / count
        return np.hstack([result[name] for name in FIELDS])

    def _tracking(self, errors: Array) -> dict[str, Any]:
        after, last = errors[self.c["first"] :], errors[self.c["last_second"] :]
        outside = np.flatnonzero((errors > self.c["band"]).any(axis=1))
        settled = 0 if not len(outside) else int(outside[-1]) + 1
        return {
            "rms": np.sqrt(np.mean(after**2, axis=0)),
            "peak": after.max(axis=0),
            "final": last.mean(axis=0),
            "settling": self.c["period"] * settled if settled < len(errors) else np.inf,
        }

    def _sample(self, k: int) -> bool:
        """Advance by one sample; return whether the run is still stable."""
        c, n = self.c, self.n
        error = np.abs(self.x[:n] - c["target"][k])
        self.errors.append(error)
        if not (np.all(error <= c["lost"]) and self.x @ self.x < np.inf):
            return False
        exact = self.velocity(self.x, self.parameters)[0]
        position, velocity = self._measured(k, self.x[: 2 * n].copy(), exact.copy())
        dt = c["period"] if k else 0.0
        wanted, self.memory = self.law(position, velocity, c["jets"][k], c["gains"], self.memory, self.sent[-1], dt)
        if not wanted @ wanted < np.inf:
            return False
        u = np.clip(wanted, -c["limit"][self.i], c["limit"][self.i])
        self.sent.append(u)
        self.power.append(abs(float(u @ exact[n:])))
        if c["trace"] is not None:
            c["trace"][self.i, k] = np.hstack([self.x, u])
        if k < c["samples"]:
            self._hold(k)
        return True

    def _measured(self, k: int, position: Array, velocity: Array) -> tuple[Array, Array]:
        position_noise, velocity_noise, resolution = self.c["sensing"][self.i]
        if position_noise > 0 or velocity_noise > 0:
            z = normals(int(self.c["seeds"][self.i]), k, self.n)
            position += position_noise * z[:, :2].T.ravel()
            velocity += velocity_noise * z[:, 2:].T.ravel()
        if resolution > 0:
            position = resolution * np.rint(position / resolution)
        return position, velocity

    def _hold(self, k: int) -> None:
        for (age, steps), dt in zip(self.c["segments"][self.i], self.c["dt"][self.i], strict=True):
            u = self.sent[k - age + 1] if k >= age else np.zeros(self.n)
            for _ in range(steps):
                self.x = self.step(self.x, u, self.parameters, dt)[0]


def normals(seed: int, sample: int, n: int) -> Array:
    """Return normal numbers (n, 4) of n joints at a sample: Philox4x64-10 and Box-Muller, see noise.c."""
    drawn = np.vstack([counter_rng.words((seed, 0), sample + (joint << 64), 1) for joint in range(n)])
    first, second = np.moveaxis(counter_rng.unit(drawn).reshape(n, 2, 2), 2, 0)
    radius, angle = np.sqrt(-2 * np.log(1 - first)), 2 * np.pi * second
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=2).reshape(n, 4)
