# SPDX-License-Identifier: Apache-2.0
"""A recorded run as arrays: what the joints did, what the law's storage was, when messages went."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fjr_bringup.bag import Array, Bag, JointTable
from fjr_core.errors import FjrError
from fjr_core.scenario import Scenario
from fjr_core.vdpbc.rate import Rate
from fjr_msgs_py import names

STATES, ANSWERS = f"/{names.JOINT_STATES}", f"/{names.JOINT_COMMANDS}"
REFERENCE = names.REFERENCE.replace("~", f"/{names.CONTROLLER}")
VISITED = 200  # configurations of a run at which the rate is looked at


class DataError(FjrError):
    """A bag in which no run of the scenario is recorded."""


@dataclass(frozen=True)
class TrackingData:
    """k states from the first answered one on, n joints. Times in s since that state's stamp."""

    joints: tuple[str, ...]
    sample_period: float  # s
    beta: float  # rate [1/s]: V(t) <= V(0) exp(-2 beta t) in continuous time
    beta_is_proven: bool  # for every configuration; else beta is the least at configurations of the run
    effort_limit: Array  # (n,) N m, infinite where none is given
    t: Array  # (k,) stamps
    q_l: Array  # (k, n) rad
    q_ld: Array  # (k, n) rad, reference at the stamps
    u: Array  # (k, n) N m, command that answers each state, NaN where none came
    V: Array  # (k,) storage of the law at each recorded state, x_v = x
    sent: Array  # (k,) s, send time of each state since that of the first
    answered: Array  # (k,) s, send time of its command, NaN where none came
    reference_mismatch: float  # rad, recorded reference against the one computed here

    @property
    def error(self) -> Array:
        """q_l - q_ld (k, n) [rad]."""
        return self.q_l - self.q_ld

    @property
    def peak_effort(self) -> Array:
        """Largest |u| of each joint (n,) [N m]."""
        return np.asarray(np.nanmax(np.abs(self.u), axis=0))

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
        """From sending a state to sending its command (k,) [s], NaN where none was sent."""
        return self.answered - self.sent

    @property
    def deadline(self) -> Array:
        """When the next state was sent (k,) [s]; one sample period on for the last."""
        return np.append(self.sent[1:], self.sent[-1] + self.sample_period)


def tracking_data(bag: Bag, scenario: Scenario, duration: float) -> TrackingData:
    """The `duration` seconds of stamped time from the first answered state; raises DataError or BagError."""
    joints, n, limits = scenario.joints, scenario.robot.n, scenario.robot.limits
    both_sides = names.state_names(joints)
    commands = _first_of_each_stamp(bag.joints(ANSWERS, joints))
    start = commands.stamp[0]
    states = _first_of_each_stamp(_from_first_answer(bag.joints(STATES, both_sides), start, commands.publish_time[0]))
    inside = (states.stamp >= start) & ((states.stamp - start) * 1e-9 < duration - 1e-9)
    if not inside.any() or np.isnan(states.position[inside]).any() or np.isnan(states.velocity[inside]).any():
        raise DataError(f"{bag.path} holds no complete state of {', '.join(both_sides)} after the first command")
    stamp, position, velocity = states.stamp[inside], states.position[inside], states.velocity[inside]
    t = (stamp - start) * 1e-9
    jets = np.stack([scenario.reference.jets(instant) for instant in t])
    place, found = _answers(stamp, commands.stamp)
    sent = states.publish_time[inside]
    rate = _rate(scenario, position[:, :n])
    return TrackingData(
        joints=joints,
        sample_period=scenario.sample_period,
        beta=rate.beta,
        beta_is_proven=rate.proven and scenario.plant_is_the_model,
        effort_limit=np.full(n, np.inf) if limits is None else limits.effort,
        t=t,
        q_l=position[:, :n],
        q_ld=jets[:, 0],
        u=np.where(found[:, None], commands.effort[place], np.nan),
        V=_storage(scenario, position, velocity, jets),
        sent=(sent - sent[0]) * 1e-9,
        answered=np.where(found, (commands.publish_time[place] - sent[0]) * 1e-9, np.nan),
        reference_mismatch=_mismatch(bag.joints(REFERENCE, joints), stamp, jets[:, 0]),
    )


def _rate(scenario: Scenario, q_l: Array) -> Rate:
    """The rate that is proven, else the one at configurations that the links (k, n) went through."""
    rate = scenario.law.rate()
    visited = q_l[:: max(1, len(q_l) // VISITED)]
    return rate if rate.proven or not np.isfinite(visited).all() else scenario.law.rate(visited)


def _from_first_answer(states: JointTable, start: np.int64, answer: np.int64) -> JointTable:
    """Without the copies of the first state sent before anyone listened: the last one is the answered."""
    waiting = np.flatnonzero((states.stamp <= start) & (states.publish_time <= answer))
    return _rows(states, slice(waiting[-1] if waiting.size else 0, None))


def _rows(table: JointTable, rows: slice | NDArray[np.intp]) -> JointTable:
    return JointTable(
        stamp=table.stamp[rows],
        publish_time=table.publish_time[rows],
        position=table.position[rows],
        velocity=table.velocity[rows],
        effort=table.effort[rows],
    )


def _first_of_each_stamp(table: JointTable) -> JointTable:
    """One row per stamp in order of time: states may be sent again, a last zero effort repeats a stamp."""
    return _rows(table, np.unique(table.stamp, return_index=True)[1])


def _answers(stamps: NDArray[np.int64], commands: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Row of the command that answers each stamp, and whether there is one."""
    place = np.minimum(np.searchsorted(commands, stamps), len(commands) - 1)
    return place, commands[place] == stamps


def _storage(scenario: Scenario, position: Array, velocity: Array, jets: Array) -> Array:
    """V of the law at each state, from positions and velocities (k, 2n) and jets (k, 5, n)."""
    n, law, state = scenario.robot.n, scenario.law, scenario.robot.state
    storage = np.empty(len(position))
    for k, (q, dq) in enumerate(zip(position, velocity, strict=True)):
        x = state(q[:n], q[n:], dq[:n], dq[n:])
        storage[k] = law.command_and_storage(x, jets[k])[1]
    return storage


def _mismatch(reference: JointTable, stamps: NDArray[np.int64], q_ld: Array) -> float:
    """Largest difference [rad] between the recorded reference and the scenario's."""
    place, found = _answers(stamps, reference.stamp)
    return float(np.abs(reference.position[place] - q_ld)[found].max(initial=0.0))
