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
from fjr_bringup.recording.topic import BagError
from fjr_core.config.safety import safety
from fjr_core.config.scenario import Scenario
from fjr_core.control.vdpbc.convergence_rate import NO_RATE, Rate
from fjr_core.control.vdpbc.law import TrackingLaw
from fjr_core.monitoring.certificate import Certificate, CertificateSeries
from fjr_core.monitoring.record import Record
from fjr_core.robot.joint_units import REVOLUTE, Units
from fjr_core.verification.inertia_bounds import Domain, few_boxes, is_provable

FARTHEST = 1e4  # rad or m; a run that goes beyond has lost its robot, and bounds may overflow
VISITED = 200  # configurations of a run at which the rate is evaluated
TAIL = 1.0  # s; states after the last command that are dropped without a note
OTHER_RATE = 0.05  # relative; beyond this difference the measured sample period replaces the scenario's


@dataclass(frozen=True, kw_only=True)
class RunData(Record):
    """Record of a run (k states from the first answered one on, n joints) with the certificate along it.

    Times in s since the stamp of that state; NaN: not known.
    """

    sent: Array  # (k,) s, send time of each state since that of the first
    answered: Array  # (k,) s, send time of its command, NaN: none
    certificate: CertificateSeries  # along the states; V, dV NaN for another law than v-dPBC
    joints: tuple[str, ...]
    beta: float  # rate [1/s]: V(t) <= V(0) exp(-2 beta t) in continuous time
    beta_is_proven: bool  # for every configuration, or those of the run; else beta is the least at some of the run
    torque: Array  # (k, n) N m, measured at the motors
    dV: Array  # (k - 1,) W, mean rate of V over each step by the model, the sent effort held
    reference_mismatch: float  # rad, recorded reference against the one computed here
    notes: tuple[str, ...] = field(default=())  # one sentence for each missing or substituted signal
    velocities_measured: bool = True  # False: estimated by an observer
    stop: ControllerStop | None = None  # the controller's first stop, None: it never stopped
    units: tuple[Units, ...] = ()  # of each joint; revolute ones by default. Prismatic joints have m and N below

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "units", self.units or (REVOLUTE,) * len(self.joints))

    @property
    def V(self) -> Array:
        """Storage of the law (k,) [J] at each state, x_v = x."""
        return self.certificate.V

    @property
    def H(self) -> Array:
        """Energy of the robot (k,) [J]."""
        return self.certificate.H

    @property
    def dissipated(self) -> Array:
        """Power dissipated by links and motors (k,) [W]."""
        return self.certificate.dissipated

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


def run_data(bag: Bag, scenario: Scenario, duration: float) -> RunData:
    """Return `duration` [s] of stamped time from the first state with a command; raise BagError.

    An infinite duration ends with the last state that has a command.
    """
    n = scenario.robot.n
    states, u, answered = _answered_states(bag, scenario, duration)
    t, sent = (states.stamp - states.stamp[0]) * 1e-9, states.publish_time
    measured = states.velocity
    states = with_velocities(states, u, scenario)
    tracked = recorded_reference(bag, scenario, states.stamp, t)
    certificate, known = _certificate(scenario, states, tracked.jets, u), bool(np.isfinite(states.torque).any())
    rate, (period, odd) = _rate(scenario, states.position[:, :n]), _sample_period(scenario, t)
    torn = () if bag.complete else ("the bag was not closed: shown is what was written until then",)
    return RunData(
        certificate=certificate,
        dV=certificate.held_rate(u),
        u_applied=states.torque @ np.linalg.inv(scenario.robot.B_m).T if known else None,
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
        sent=(sent - sent[0]) * 1e-9,
        answered=np.where(answered >= 0, (answered - sent[0]) * 1e-9, np.nan),
        reference_mismatch=tracked.mismatch,
        notes=(*torn, *states.notes, *tracked.notes, *odd),
        stop=controller_stop(bag, sent, states.stamp, t),
        units=scenario.robot.units,
        velocities_measured=states.velocity is measured,
    )


def _answered_states(bag: Bag, scenario: Scenario, duration: float) -> tuple[States, Array, Times]:
    """Return the states from the first with a command on, commands (k, n) [N m] and their send times (k,) [ns]."""
    states, jumps = without_jumps(recorded_states(bag, scenario))
    if not len(states.stamp):
        raise BagError(f"{bag.path} holds no complete state on {STATES}")
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


def _sample_period(scenario: Scenario, t: Array) -> tuple[float, tuple[str, ...]]:
    """Return the sample period [s]: the scenario's, or the measured one with a note if it differs."""
    nominal = scenario.sample_period
    seen = float(np.median(np.diff(t))) if len(t) > 1 else nominal
    if abs(seen - nominal) <= OTHER_RATE * nominal:
        return nominal, ()
    return seen, (f"states came every {seen * 1e3:.4g} ms; the scenario's robot sends them every {nominal * 1e3:g} ms",)


def _certificate(scenario: Scenario, states: States, jets: Array, u: Array) -> CertificateSeries:
    """Return the certificate along the states; of another law than v-dPBC only what the robot alone determines."""
    law = scenario.certified_law
    if law is not None:
        return Certificate(law).along(states.position, states.velocity, jets, u)
    found = Certificate(TrackingLaw(scenario.robot, scenario.gains)).along(states.position, states.velocity, jets, u)
    return replace(found, V=np.nan * found.V, dV=np.nan * found.dV)


def _rate(scenario: Scenario, q_l: Array) -> Rate:
    """Return the convergence rate of v-dPBC: proven, else sampled at visited configurations q_l (k, n).

    For an arm of a URDF the proof holds on the smallest box that contains all visited positions and the largest step
    between two of them.
    """
    law = scenario.certified_law
    if law is None:
        return NO_RATE
    rate = law.rate()
    if rate.proven or not np.isfinite(q_l).all():
        return rate
    if not is_provable(scenario.robot) or np.max(np.abs(q_l), initial=0.0) > FARTHEST:
        return law.rate(q_l[:: max(1, len(q_l) // VISITED)])
    step = np.max(np.abs(np.diff(q_l, axis=0)), axis=0, initial=0.0)
    domain = Domain(q_l.min(axis=0) - step, q_l.max(axis=0) + step)
    return law.proven_rate(domain, most_boxes=few_boxes(scenario.robot))
