# SPDX-License-Identifier: Apache-2.0
"""The certificate sample by sample as states come, with the model's forecast of each; bound to buffers, for 1 kHz."""

from __future__ import annotations

import numpy as np

from ..control.vdpbc.law import TrackingLaw
from ..numerics.casadi_function import bind
from ..numerics.checks import Array
from ..trajectories.reference import JETS
from .certificate import OUTPUTS, Balance
from .innovations import Intervals
from .one_step_prediction import Prediction

ROOM = 640  # intervals that are kept, at least half of it


class Forecast:
    """Takes states one after another and makes intervals of them; not for two threads at once.

    position, velocity (2n,), jets (5, n), u (n,): of the last state, with the effort that answered it. V, H [J],
    dissipation, dissipated [W], law, drive (n,): of it, as Balance.function gives them.
    """

    def __init__(self, law: TrackingLaw) -> None:
        n = law.robot.n
        self._robot, self._balance, self._prediction = law.robot, Balance(law), Prediction(law)
        self.position, self.velocity, self.jets, self.u = (
            np.zeros(2 * n),
            np.zeros(2 * n),
            np.zeros((JETS, n)),
            np.zeros(n),
        )
        sizes = {"u_law": n, "drive": n, "slope": 4 * n}
        self._found = {name: np.zeros(sizes.get(name, 1)) for name in OUTPUTS}
        self._dt, self._next_position, self._next_velocity = np.zeros(1), np.zeros(2 * n), np.zeros(2 * n)
        self._kept, self._older, self._latency = _room(n), np.zeros(n), 0.0
        self.use(law)
        self.forget()

    def use(self, law: TrackingLaw) -> None:
        """Another law, made by `with_gains`: intervals begin anew."""
        self._balance = self._balance.with_law(law)
        measured = (self.position, self.velocity, self.jets, law.gain_values)
        self._certify = bind(self._balance.function, measured, list(self._found.values()))
        held = (self.position, self.velocity, self.u, self._dt)
        self._predict = bind(self._prediction.function, held, (self._next_position, self._next_velocity))
        self._foretold = law.bound(self._next_position, self._next_velocity, self.jets)
        for evaluate in (self._certify, self._predict, self._foretold.evaluate):
            evaluate()
        self.forget()

    def forget(self) -> None:
        """The next state has no predecessor, and there are no intervals."""
        self.count, self._follows = 0, False

    def skip(self) -> None:
        """The next state has no predecessor."""
        self._follows = False

    @np.errstate(all="ignore")  # a diverging robot overflows; V says so
    def take(self, dt: float, position: Array, velocity: Array, jets: Array, u: Array, latency: float = 0.0) -> float:
        """The next state, dt [s] after the last, with its reference and the effort that answered it; V [J] before.

        latency [s]: how long after the state that was, 0 where nothing is known of it.
        """
        V, self._dt[0] = self.V, dt
        if self._follows:
            self._predict()
        law = self._found["u_law"].copy() if self._follows else self.u
        for own, given in ((self.position, position), (self.velocity, velocity), (self.jets, jets)):
            np.copyto(own, given)
        self._certify()
        if self._follows:
            self._foretold.evaluate()
            self._keep(dt, V, law)
        np.copyto(self._older, self.u if self._follows else u)
        np.copyto(self.u, u)
        self._latency, self._follows = latency, bool(np.isfinite(self.V))
        return V

    @property
    def V(self) -> float:
        """Storage [J] at the last state."""
        return float(self._found["V"][0])

    @property
    def H(self) -> float:
        """Energy [J] there."""
        return float(self._found["H"][0])

    @property
    @np.errstate(all="ignore")
    def dV(self) -> float:
        """The exact rate of V [W] there under the effort that answered."""
        found = self._found
        return float(found["drive"].dot(self.u - found["u_law"]) - found["dissipation"][0])

    @property
    @np.errstate(all="ignore")
    def supplied(self) -> float:
        """Power [W] that the effort that answered supplies there."""
        return float(self.velocity[self._robot.n :].dot(self._robot.B_m.dot(self.u)))

    @property
    def dissipated(self) -> float:
        """Power [W] that the robot's own dampings take there."""
        return float(self._found["dissipated"][0])

    def last(self, count: int) -> Intervals:
        """The last intervals (views, good until the next state), fewer where there are not so many."""
        return self._kept.rows(slice(max(0, self.count - count), self.count))

    def _keep(self, dt: float, V: float, law: Array) -> None:
        if self.count == ROOM:
            self._make_room()
        kept, i, n = self._kept, self.count, self._robot.n
        kept.dt[i], kept.V0[i], kept.V1[i], kept.foretold[i] = dt, V, self.V, self._foretold.V[0]
        kept.sent[i], kept.law[i], kept.older[i] = self.u, law, self._older
        kept.latency[i] = min(self._latency / dt, 1.0)
        np.subtract(self.position, self._next_position, out=kept.error[i, : 2 * n])
        np.subtract(self.velocity, self._next_velocity, out=kept.error[i, 2 * n :])
        kept.slope[i] = self._found["slope"]
        np.subtract(self.position[:n], self.jets[0], out=kept.tracking[i])
        self.count += 1

    def _make_room(self) -> None:
        half = self.last(ROOM // 2)
        for name, values in vars(half).items():
            getattr(self._kept, name)[: ROOM // 2] = values
        self.count = ROOM // 2


def _room(n: int) -> Intervals:
    one, nothing = np.zeros(ROOM), np.full((ROOM, n), np.nan)
    return Intervals(
        dt=one.copy(),
        V0=one.copy(),
        V1=one.copy(),
        foretold=one.copy(),
        sent=np.zeros((ROOM, n)),
        law=np.zeros((ROOM, n)),
        before=nothing,
        after=nothing.copy(),
        error=np.zeros((ROOM, 4 * n)),
        slope=np.zeros((ROOM, 4 * n)),
        answered=np.ones(ROOM, dtype=bool),
        older=np.zeros((ROOM, n)),
        latency=np.zeros(ROOM),
        tracking=np.zeros((ROOM, n)),
    )
