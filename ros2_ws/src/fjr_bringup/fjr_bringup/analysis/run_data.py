# SPDX-License-Identifier: Apache-2.0
"""A recorded run as arrays: joint motion, storage function of the law, energy of the robot, send times.

Only positions, velocities, efforts and times are read from the bag; all else is computed from the scenario.
Unrecorded signals are NaN, and `notes` list them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from fjr_bringup.analysis.commands import recorded_commands
from fjr_bringup.analysis.controller_stop import ControllerStop, controller_stop
from fjr_bringup.analysis.reference import recorded_reference
from fjr_bringup.analysis.states import STATES, States, recorded_states, with_velocities, without_jumps
from fjr_bringup.recording.reader import Array, Bag, Times
from fjr_core.config.safety import safety
from fjr_core.config.scenario import Scenario
from fjr_core.control.vdpbc.convergence_rate import NO_RATE, Rate
from fjr_core.control.vdpbc.law import TrackingLaw
from fjr_core.errors import FjrError
from fjr_core.monitoring.certificate import Balance
from fjr_core.robot.joint_units import REVOLUTE, Units

VISITED = 200  # configurations of a run at which the rate is looked at
TAIL = 1.0  # s; states after the last command that are dropped without a note
OTHER_RATE = 0.05  # relative; beyond this difference the measured sample period replaces the scenario's


class DataError(FjrError):
    """A bag in which no run of the scenario is recorded."""


@dataclass(frozen=True)
class TrackingData:
    """k states from the first answered one on, n joints. Times in s since that state's stamp; NaN: not known."""

    joints: tuple[str, ...]
    sample_period: float  # s
    lockstep: bool  # the simulated plant waits for the answer to each state: nothing is late, whatever the clock says
    beta: float  # rate [1/s]: V(t) <= V(0) exp(-2 beta t) in continuous time
    beta_is_proven: bool  # for every configuration; else beta is the least at configurations of the run
    effort_limit: Array  # (n,) N m, infinite where none is given
    t: Array  # (k,) stamps
    position: Array  # (k, 2n) rad, links then motors
    velocity: Array  # (k, 2n) rad/s
    jets: Array  # (k, 5, n) reference at the stamps, q_ld .. d4q_ld
    u: Array  # (k, n) N m, command that answers each state, NaN where none came
    torque: Array  # (k, n) N m, measured at the motors
    V: Array  # (k,) J, storage of the law at each recorded state, x_v = x
    dV: Array  # (k - 1,) W, its rate over each step as the model has it with the effort sent, held
    H: Array  # (k,) J, energy of the robot
    dissipated: Array  # (k,) W, by the damping of links and motors
    sent: Array  # (k,) s, send time of each state since that of the first
    answered: Array  # (k,) s, send time of its command, NaN where none came
    reference_mismatch: float  # rad, recorded reference against the one computed here
    notes: tuple[str, ...] = field(default=())  # what is missing or made up for, a sentence each
    velocities_measured: bool = True  # False: estimated by an observer
    stop: ControllerStop | None = None  # the controller's first stop, None: it never stopped
    units: tuple[Units, ...] = ()  # of each joint; revolute ones by default. Prismatic joints have m and N below

    def __post_init__(self) -> None:
        object.__setattr__(self, "units", self.units or (REVOLUTE,) * len(self.joints))

    @property
    def q_l(self) -> Array:
        """Link positions (k, n) [rad]."""
        return self.position[:, : len(self.joints)]

    @property
    def q_ld(self) -> Array:
        """Reference (k, n) [rad]."""
        return np.asarray(self.jets[:, 0])

    @property
    def error(self) -> Array:
        """q_l - q_ld (k, n) [rad]."""
        return self.q_l - self.q_ld

    @property
    def peak_effort(self) -> Array:
        """Largest |u| of each joint (n,) [N m]; NaN where no effort was recorded."""
        return np.asarray(np.fmax.reduce(np.abs(self.u), axis=0))

    @property
    def bound(self) -> Array:
        """V(0) exp(-2 beta t), (k,)."""
        return self.V[0] * np.exp(-2.0 * self.beta * self.t)

    @property
    def relative_storage(self) -> Array:
        """V / V(0), (k,); V itself where the run starts without error."""
        return self.V / (self.V[0] or 1.0)

    @property
    def latency(self) -> Array:
        """Time from sending a state to sending its command (k,) [s]; NaN without a command."""
        return self.answered - self.sent

    @property
    def deadline(self) -> Array:
        """Send time of the next state (k,) [s]; one period after the last state, infinite in lock-step."""
        return np.append(self.sent[1:], np.inf if self.lockstep else self.sent[-1] + self.sample_period)


def tracking_data(bag: Bag, scenario: Scenario, duration: float) -> TrackingData:
    """Return `duration` [s] of stamped time from the first state with a command; raise DataError or BagError.

    An infinite duration ends with the last state that has a command.
    """
    n = scenario.robot.n
    states, u, answered = _answered_states(bag, scenario, duration)
    t, sent = (states.stamp - states.stamp[0]) * 1e-9, states.publish_time
    measured = states.velocity
    states = with_velocities(states, u, scenario)
    tracked = recorded_reference(bag, scenario, states.stamp, t)
    balance = Balance(_certified(scenario))
    found = balance.along(states.position, states.velocity, tracked.jets, u)
    dV = _held_rate(balance, states, tracked.jets, u, found.dV)
    no_storage = np.nan if balance.law is not scenario.law else 1.0
    rate, (period, odd) = _rate(scenario, states.position[:, :n]), _sample_period(scenario, t)
    torn = () if bag.complete else ("the bag was not closed: shown is what was written until then",)
    return TrackingData(
        joints=scenario.joints,
        sample_period=period,
        lockstep=bool(scenario.plant_values["lockstep"]),
        beta=rate.beta,
        beta_is_proven=rate.proven and scenario.plant_is_the_model,
        effort_limit=_effort_limit(scenario),
        t=t,
        position=states.position,
        velocity=states.velocity,
        jets=tracked.jets,
        u=u,
        torque=states.torque,
        V=no_storage * found.V,
        dV=no_storage * dV,
        H=found.H,
        dissipated=found.dissipated,
        sent=(sent - sent[0]) * 1e-9,
        answered=np.where(answered >= 0, (answered - sent[0]) * 1e-9, np.nan),
        reference_mismatch=tracked.mismatch,
        notes=(*torn, *states.notes, *tracked.notes, *odd),
        stop=controller_stop(bag, sent, t),
        units=scenario.robot.units,
        velocities_measured=states.velocity is measured,
    )


def _answered_states(bag: Bag, scenario: Scenario, duration: float) -> tuple[States, Array, Times]:
    """Return the states from the first with a command on, commands (k, n) [N m] and their send times (k,) [ns]."""
    states, jumps = without_jumps(recorded_states(bag, scenario))
    if not len(states.stamp):
        raise DataError(f"{bag.path} holds no complete state on {STATES}")
    commands = recorded_commands(bag, states, scenario.joints)
    rows = _from_first_answer(states, commands.sent)
    rows = rows[(states.stamp[rows] - states.stamp[rows[0]]) * 1e-9 < duration - 1e-9]
    rows, end_notes = (rows, ()) if np.isfinite(duration) else _to_last_answer(rows, states, commands.sent)
    notes = (*states.notes, *jumps, *commands.notes, *end_notes)
    return replace(states.rows(rows), notes=notes), commands.u[rows], commands.sent[rows]


def _from_first_answer(states: States, sent: Times) -> NDArray[np.intp]:
    """Return the first row of each stamp, from the last copy of the first state with a command on."""
    answered = np.flatnonzero(sent >= 0)
    begin = 0
    if answered.size:
        start, answer = states.stamp[answered[0]], sent[answered[0]]
        waiting = np.flatnonzero((states.stamp <= start) & (states.publish_time <= answer))
        begin = int(waiting[-1]) if waiting.size else int(answered[0])
    rows = begin + np.unique(states.stamp[begin:], return_index=True)[1]
    return np.asarray(rows[states.stamp[rows] >= states.stamp[begin]])


def _to_last_answer(rows: NDArray[np.intp], states: States, sent: Times) -> tuple[NDArray[np.intp], tuple[str, ...]]:
    """Drop the rows after the last state with a command; return a note if they last longer than TAIL."""
    answered = np.flatnonzero(sent[rows] >= 0)
    last = int(answered[-1]) if answered.size else len(rows) - 1
    tail = (states.stamp[rows[-1]] - states.stamp[rows[last]]) * 1e-9
    end = (states.stamp[rows[last]] - states.stamp[rows[0]]) * 1e-9
    notes = (f"no state after {end:.3f} s is answered: the last {tail:.3g} s are not shown",) if tail > TAIL else ()
    return rows[: last + 1], notes


def _effort_limit(scenario: Scenario) -> Array:
    """Return the smaller of controller and robot effort limits (n,) [N m]; infinite without a limit."""
    robot = scenario.robot
    own = np.minimum(np.full(robot.n, np.inf), np.asarray(safety(scenario.controller_values, robot).effort))
    return own if robot.limits is None else np.asarray(np.minimum(own, robot.limits.effort))


def _held_rate(balance: Balance, states: States, jets: Array, u: Array, dV: Array) -> Array:
    """dV/dt (k - 1,) over each step, by the trapezoidal rule: dV (k,) at its begin, and at its end with the same u."""
    if len(u) < 2:
        return np.zeros(0)
    end = balance.along(states.position[1:], states.velocity[1:], jets[1:], u[:-1])
    return np.asarray((dV[:-1] + end.dV) / 2)


def _sample_period(scenario: Scenario, t: Array) -> tuple[float, tuple[str, ...]]:
    """Return the sample period [s]: the scenario's, or the measured one with a note if it differs."""
    nominal = scenario.sample_period
    seen = float(np.median(np.diff(t))) if len(t) > 1 else nominal
    if abs(seen - nominal) <= OTHER_RATE * nominal:
        return nominal, ()
    return seen, (f"states came every {seen * 1e3:.4g} ms; the scenario's robot sends them every {nominal * 1e3:g} ms",)


def _certified(scenario: Scenario) -> TrackingLaw:
    """The scenario's law; of another one than v-dPBC what stands in for it, for the energies of the robot."""
    law = scenario.law
    return law if isinstance(law, TrackingLaw) else TrackingLaw(scenario.robot, scenario.gains)


def _rate(scenario: Scenario, q_l: Array) -> Rate:
    """Return the convergence rate of v-dPBC: proven, else sampled at visited configurations q_l (k, n)."""
    if not isinstance(scenario.law, TrackingLaw):
        return NO_RATE
    rate = scenario.law.rate()
    visited = q_l[:: max(1, len(q_l) // VISITED)]
    return rate if rate.proven or not np.isfinite(visited).all() else scenario.law.rate(visited)
