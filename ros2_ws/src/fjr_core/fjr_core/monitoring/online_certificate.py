# SPDX-License-Identifier: Apache-2.0
"""Evaluate the certificate and the innovations online, one state at a time; bound to buffers for loops at 1 kHz."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..control.vdpbc.law import TrackingLaw
from ..numerics.casadi_function import bind
from ..numerics.checks import Array
from ..trajectories.reference import JETS
from .certificate import OUTPUTS, Certificate
from .innovations import Innovations
from .one_step_prediction import Prediction

_FIELDS = {name: name for name in ("dt", "V0", "predicted", "sent", "law", "older", "error", "slope")} | {"V1": "V"}
"""Fields of Innovations, with the names of `append`."""
CAPACITY = 640  # intervals; at least the latest half is kept


class OnlineCertificate:
    """Certificate of the latest state and innovations of the latest intervals; not thread-safe.

    position, velocity (2n,) [rad, rad/s], jets (5, n), u (n,) [N m]: latest state, reference and command.
    """

    def __init__(self, law: TrackingLaw) -> None:
        n = law.robot.n
        self._robot, self._balance, self._prediction = law.robot, Certificate(law), Prediction(law)
        self.position, self.velocity = np.zeros(2 * n), np.zeros(2 * n)
        self.jets, self.u = np.zeros((JETS, n)), np.zeros(n)
        sizes = {"u_law": n, "drive": n, "slope": 4 * n}
        self._found = {name: np.zeros(sizes.get(name, 1)) for name in OUTPUTS}
        self._dt, self._next_position, self._next_velocity = np.zeros(1), np.zeros(2 * n), np.zeros(2 * n)
        self._kept, self._older, self._latency = _buffers(n), np.zeros(n), 0.0
        self.use(law)
        self.forget()

    def use(self, law: TrackingLaw) -> None:
        """Use a law made by `with_gains` and discard the intervals."""
        self._balance = self._balance.with_law(law)
        measured = (self.position, self.velocity, self.jets, law.gain_values)
        self._certify = bind(self._balance.function, measured, list(self._found.values()))
        held = (self.position, self.velocity, self.u, self._dt)
        self._predict = bind(self._prediction.function, held, (self._next_position, self._next_velocity))
        self._predicted = law.bound(self._next_position, self._next_velocity, self.jets)
        for evaluate in (self._certify, self._predict, self._predicted.evaluate):
            evaluate()
        self.forget()

    def forget(self) -> None:
        """Discard the intervals; the next state has no predecessor."""
        self.count, self._follows = 0, False

    def skip(self) -> None:
        """Let the next state have no predecessor."""
        self._follows = False

    @np.errstate(all="ignore")  # a diverging robot overflows; V says so
    def take(self, dt: float, position: Array, velocity: Array, jets: Array, u: Array, latency: float = 0.0) -> float:
        """Take the next state, dt [s] after the last, with its reference and command; return V [J] of the last state.

        position, velocity (2n,), jets (5, n), u (n,) [N m]. latency [s]: delay of the command; 0: not known.
        """
        V, self._dt[0] = self.V, dt
        if self._follows:
            self._predict()
        law = self._found["u_law"].copy() if self._follows else self.u
        for own, given in ((self.position, position), (self.velocity, velocity), (self.jets, jets)):
            np.copyto(own, given)
        self._certify()
        if self._follows:
            self._predicted.evaluate()
            self._keep(dt, V, law)
        np.copyto(self._older, self.u if self._follows else u)
        np.copyto(self.u, u)
        self._latency, self._follows = latency, bool(np.isfinite(self.V))
        return V

    def append(self, found: NDArray[Any], command: NDArray[Any], latency: Array) -> int:
        """Append states whose certificates and innovations were evaluated elsewhere, by the rules of `take`.

        found, command (k,), at most CAPACITY / 2: arrays with named fields. found: follows (0: no predecessor), dt, V0,
        V, predicted, sent, law, older, error, slope of the interval that ends at the state. command: position,
        jets (5 n,). latency (k,) [s]: of these commands. Return the number of new intervals.
        """
        new, n = np.flatnonzero(found["follows"]), self._robot.n
        if self.count + len(new) > CAPACITY:
            self._drop_oldest()
        kept, rows, intervals = self._kept, slice(self.count, self.count + len(new)), found[new]
        for name, field in _FIELDS.items():
            getattr(kept, name)[rows] = intervals[field]
        before = np.append(self._latency, latency[:-1])[new]
        kept.latency[rows] = np.minimum(before / kept.dt[rows], 1.0)
        kept.tracking[rows] = command["position"][new, :n] - command["jets"][new, :n]
        np.copyto(self.position, command["position"][-1])
        np.copyto(self.jets, command["jets"][-1].reshape(self.jets.shape))
        self._latency, self.count = float(latency[-1]), self.count + len(new)
        return len(new)

    @property
    def functions(self) -> tuple[Any, Any]:
        """Return the CasADi functions of certificate and prediction."""
        return self._balance.function, self._prediction.function

    @property
    def V(self) -> float:
        """Storage [J] at the latest state."""
        return float(self._found["V"][0])

    @property
    def H(self) -> float:
        """Energy [J] of the robot at the latest state."""
        return float(self._found["H"][0])

    @property
    @np.errstate(all="ignore")
    def dV(self) -> float:
        """Exact rate of V [W] at the latest state under its command."""
        found = self._found
        return float(found["drive"].dot(self.u - found["u_law"]) - found["dissipation"][0])

    @property
    @np.errstate(all="ignore")
    def supplied(self) -> float:
        """Power [W] supplied by the command at the latest state."""
        return float(self.velocity[self._robot.n :].dot(self._robot.B_m.dot(self.u)))

    @property
    def dissipated(self) -> float:
        """Power [W] dissipated by the damping of the robot at the latest state."""
        return float(self._found["dissipated"][0])

    def last(self, count: int, before: int = 0) -> Innovations:
        """Return at most the last `count` intervals, without the `before` latest ones; valid until the next state."""
        end = self.count - before
        return self._kept.rows(slice(max(0, end - count), end))

    def _keep(self, dt: float, V: float, law: Array) -> None:
        if self.count == CAPACITY:
            self._drop_oldest()
        kept, i, n = self._kept, self.count, self._robot.n
        kept.dt[i], kept.V0[i], kept.V1[i], kept.predicted[i] = dt, V, self.V, self._predicted.V[0]
        kept.sent[i], kept.law[i], kept.older[i] = self.u, law, self._older
        kept.latency[i] = min(self._latency / dt, 1.0)
        np.subtract(self.position, self._next_position, out=kept.error[i, : 2 * n])
        np.subtract(self.velocity, self._next_velocity, out=kept.error[i, 2 * n :])
        kept.slope[i] = self._found["slope"]
        np.subtract(self.position[:n], self.jets[0], out=kept.tracking[i])
        self.count += 1

    def _drop_oldest(self) -> None:
        half = self.last(CAPACITY // 2)
        for name, values in vars(half).items():
            getattr(self._kept, name)[: CAPACITY // 2] = values
        self.count = CAPACITY // 2


def _buffers(n: int) -> Innovations:
    """Return zeroed innovations of CAPACITY intervals without measured efforts, all answered."""
    sizes = dict.fromkeys(("sent", "law", "older", "tracking", "before", "after"), n) | {"error": 4 * n, "slope": 4 * n}
    shapes = {f.name: (CAPACITY, sizes[f.name]) if f.name in sizes else (CAPACITY,) for f in fields(Innovations)}
    values = {name: np.zeros(shape) for name, shape in shapes.items()}
    unmeasured = {name: np.full((CAPACITY, n), np.nan) for name in ("before", "after")}
    return Innovations(**{**values, **unmeasured, "answered": np.ones(CAPACITY, dtype=bool)})
