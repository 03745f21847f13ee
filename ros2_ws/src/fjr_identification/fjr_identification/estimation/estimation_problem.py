# SPDX-License-Identifier: Apache-2.0
"""Set up the optimisation: free parameters, start values, segments, integration steps and the least noise."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from fjr_core.errors import StateError
from fjr_core.model.robot import Robot
from fjr_core.numerics.checks import Array
from fjr_core.urdf.typical_joints import least_free_inertia

from .elastic_arm import ElasticArm, correctable, packed
from .motion_record import FilteredMotion, MotionRecord, filtered, inner, smoothed
from .multiple_shooting import Problem, cut, measured_signals
from .parameters import HARDENING, KINDS, PAYLOAD, POSITION_TORQUE, IdentifyOptions, ParameterCoordinates, Prior, size
from .shooting import MOST_PARTS, HeldEffort, Shooting

PERIODS, SHORTEST, LONGEST = 6, 0.4, 1.0  # of the slowest resonance in a segment; its least and largest length [s]
ACCURATE = 0.25
"""Angle [rad] of the fastest resonance in an integration step; Runge-Kutta 4 lowers its frequency by angle^4 / 120."""
RESONANT_PARTS = 11  # of these, for a resonance
WIDE, FAST = 0.05, 1.0  # rad, rad/s; least widths of the prior of initial states
LEAST_DEFLECTION = 1e-3  # rad; of the torque that is taken as the scale of a joint without effort
HARMONICS = {"1": 3.0, "2": 0.1}
"""Widths of the prior of a torque of the position, in efforts; a small second one lets it extrapolate."""
UNSEEN = 0.1  # of the noise; displacement in a segment by steps of integration that miss a turn of friction
MOST_POSES = 20  # samples of a record at which resonances are computed


@dataclass(frozen=True, eq=False)
class Estimation:
    """Records, robot, prior and options, and the optimisation problem that follows from them."""

    records: list[MotionRecord]
    robot: Robot
    prior: Prior
    options: IdentifyOptions

    @cached_property
    def coordinates(self) -> ParameterCoordinates:
        """Return the coordinates of all free parameters."""
        free, widths = free_parameters(self.records, self.robot, self.options), self.widths
        return ParameterCoordinates(free, self.prior, np.array([widths[name][i] for name, i in free], dtype=float))

    @property
    def widths(self) -> dict[str, Array]:
        """Return the prior's standard deviations by name, of the logarithm for positive parameters."""
        n, values = self.robot.n, self.prior
        measured = np.max([np.sqrt(np.mean((r.u @ self.robot.B_m.T) ** 2, axis=0)) for r in self.records], axis=0)
        effort = np.maximum(measured, LEAST_DEFLECTION * values["joint_stiffness"])
        damping = 0.1 * np.sqrt(values["joint_stiffness"] * values["motor_inertia"])
        widths: dict[str, Array] = {
            name: np.full(size(name, n), kind.width) for name, kind in KINDS.items() if kind.width is not None
        }
        widths |= dict.fromkeys(("link_damping", "motor_damping"), damping)
        widths[HARDENING] = values["joint_stiffness"] ** 3 / effort**2
        widths |= {name: 0.3 * effort for name, kind in KINDS.items() if kind.unit == "N m" and kind.width is None}
        widths |= {name: HARMONICS[name[-1]] * effort for name in POSITION_TORQUE}
        return {**widths, "payload_mass": np.array([10.0])}

    @cached_property
    def motions(self) -> list[FilteredMotion]:
        """Return the filtered motion of each record."""
        arm, values = self.arm(self.coordinates), self.prior
        return [filtered(record, arm, values) for record in self.records]

    def arm(self, coordinates: ParameterCoordinates) -> ElasticArm:
        """Return the arm with derivatives by the free parameters."""
        return ElasticArm(self.robot, coordinates.dynamic, self._added_inertia)

    @cached_property
    def poses(self) -> Array:
        """Return some measured positions (k, n) along all records."""
        positions = []
        for record in self.records:
            q = np.where(np.isfinite(record.q_l), record.q_l, record.q_m)
            positions.append(q[:: max(1, len(q) // MOST_POSES)])
        return np.vstack(positions)

    @cached_property
    def _added_inertia(self) -> tuple[float, ...]:
        """Return the inertia [kg m^2] that lowers the resonance of each link to the fastest one that is integrated."""
        least = least_free_inertia([self.robot.M_l(q) for q in self.poses])
        fastest = ACCURATE * RESONANT_PARTS / max(record.dt for record in self.records)
        needed = 2 * self.prior["joint_stiffness"] / fastest**2
        return tuple(float(f"{value:.2g}") for value in np.where(needed > least, needed, 0.0))

    def segment_length(self, start: Mapping[str, Array]) -> float:
        """Return the length [s] of the segments that follows from start values."""
        return self._length(_rates(self.arm(self.coordinates), self.poses, start)[0])

    def _length(self, slowest: float) -> float:
        return float(np.clip(PERIODS * 2 * np.pi / slowest, SHORTEST, LONGEST))

    def problem(self, start: Mapping[str, Array], held: Collection[int] = ()) -> Problem:
        """Return the segments of the records with the model; their length and steps follow from the start values.

        held: entries of z that are not free.
        """
        coordinates = replace(self.coordinates, held=frozenset(held))
        arm = self.arm(coordinates)
        slowest, fastest, mobility = _rates(arm, self.poses, start)
        if np.any(start[HARDENING]):
            largest = np.max([np.max(np.abs(m.q_m - m.q_l - start["offset"]), axis=0) for m in self.motions], axis=0)
            tangent = start["joint_stiffness"] + 3 * start[HARDENING] * largest**2
            fastest = _rates(arm, self.poses, {**start, "joint_stiffness": tangent})[1]
        accuracy = UNSEEN * np.tile(_noise(self.records), 2) / self._length(slowest)
        segments, filtered_states = [], []
        for record, motion in zip(self.records, self.motions, strict=True):
            steps = int(np.clip(np.ceil(record.dt * fastest), 1, MOST_PARTS))
            effort = HeldEffort(record.u @ self.robot.B_m.T, record.dt, steps, mobility, accuracy)
            pieces = cut(record, effort, self._length(slowest))
            segments += pieces
            filtered_states += [motion.state(piece.first - piece.pad) for piece in pieces]
        signals = measured_signals(self.records)
        floor = np.array([_least_noise(self.records, *signal) for signal in signals])
        deflection = np.max([np.max(np.abs(m.q_m - m.q_l), axis=0) for m in self.motions], axis=0)
        speed = np.max([np.max(np.abs(m.v_m), axis=0) for m in self.motions], axis=0)
        width = np.concatenate([np.tile(WIDE + 2 * deflection, 2), np.tile(FAST + 2 * speed, 2)])
        states = np.array(filtered_states)
        shooting = Shooting(arm, coordinates.delays)
        return Problem(segments, shooting, coordinates, signals, floor, states, width, self.options.threads)


def free_parameters(
    records: Sequence[MotionRecord], robot: Robot, options: IdentifyOptions
) -> tuple[tuple[str, int], ...]:
    """Return (name, index) of what can be free with what is measured: a skew needs two signals of its joint."""
    joints = records[0].joints
    measured = set(measured_signals(records))
    if options.position_torque and options.position_torque not in joints:
        raise StateError(
            f"position_torque is of joint {options.position_torque!r}; expected one of {', '.join(joints)}"
        )
    if options.link_inertia and not correctable(robot.links):
        raise StateError(
            "link_inertia is of a robot that is no chain of bodies; expected one from a URDF, joints from base to tip"
        )
    if robot.torsion is not None:
        raise StateError("torsion is a table, which is not fitted; expected none, or a cubic stiffness instead")
    hardens = robot.cubic is not None or HARDENING in options.names
    if hardens and any(signal == "torque" for signal, _ in measured):
        raise StateError("cubic_stiffness is of records with joint torque sensors; expected motor positions instead")
    unknown = [joint for joint in options.joints if joint not in joints]
    if unknown:
        raise StateError(f"joint {unknown[0]!r} is to be identified; expected some of {', '.join(joints)}")
    free = []
    for name in options.names:
        for j in range(size(name, robot.n)):
            other = name in POSITION_TORQUE and joints[j] != options.position_torque
            other |= name not in PAYLOAD and bool(options.joints) and joints[j] not in options.joints
            no_link = name in ("link_skew", "gear_ratio_error") and not {("q_l", j), ("q_m", j)} <= measured
            no_torque = name == "torque_skew" and ("torque", j) not in measured
            if not (other or no_link or no_torque):
                free.append((name, j))
    return tuple(free)


def _rates(arm: ElasticArm, poses: Array, p: Mapping[str, Array]) -> tuple[float, float, Array]:
    """Return the slowest resonance [rad/s], the integration steps per second of the fastest one, and the mobility (2n,)
    [1 / (kg m^2)] of links and motors.
    """
    K, B, values = np.diag(p["joint_stiffness"]), p["motor_inertia"], packed(arm, p)
    slowest, fastest, mobility = np.inf, 0.0, np.zeros(len(B))
    for q in poses:
        inverse = np.linalg.inv(arm.link_inertia(q, values).full())
        resonances = np.sqrt(np.linalg.eigvals(K @ (inverse + np.diag(1 / B))).real)
        slowest, fastest = min(slowest, resonances.min()), max(fastest, resonances.max())
        mobility = np.maximum(mobility, np.diag(inverse))
    return slowest, fastest / ACCURATE, np.concatenate([mobility, 1 / B])


def _noise(records: Sequence[MotionRecord]) -> Array:
    """Return what the filter leaves of positions (n,), root mean square: the least of all records and both sides."""
    left = [inner(q - smoothed(q, r.dt), r.dt) for r in records for q in (r.q_l, r.q_m)]
    with np.errstate(all="ignore"):
        return np.asarray(np.fmin.reduce([np.sqrt(np.mean(rest**2, axis=0)) for rest in left]))


def _least_noise(records: Sequence[MotionRecord], signal: str, joint: int) -> float:
    """Return the noise of the steps in which a signal is measured, or of its floating-point numbers."""
    columns = [getattr(record, signal)[:, joint] for record in records]
    measured = [column[np.isfinite(column)] for column in columns]
    steps = np.abs(np.concatenate([np.diff(column) for column in measured]))
    largest = max(float(np.max(np.abs(column), initial=0.0)) for column in measured)
    digits = 1e-9 * max(largest, 1e-3)
    step = float(np.min(steps[steps > digits], initial=np.inf))
    return max(step / np.sqrt(12), digits) if np.isfinite(step) else digits
