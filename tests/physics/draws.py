# SPDX-License-Identifier: Apache-2.0
"""Random planar arms of one to three joints that follow random motions, and robot files with wrong springs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from .arm import Arm, G, Motion, Others, simulated
from .laws import Friction, Spring, coulomb, linear
from .sensors import Samples, Sensors, sampled

Array = NDArray[np.float64]
STIFFNESS_ERROR, INERTIA_ERROR = 0.5, 0.3  # standard deviations of the logarithm in the robot file
BAND, PEAK = 12.0, 0.6  # rad/s of the position loop; rad of the motion
SINES = 4
CHORDS = 20  # deflections between which secants are taken, a fifth of their range apart at least


@dataclass(frozen=True)
class Case:
    """Physics of a row of the table. varied: the arm with further bodies; jitter [s]: the delay varies as much.

    lag [s]: of the torques. others: further torques of the arm. table: on a table that swings at 15 Hz.
    cause: words that name what the model lacks, "": nothing that would change K.
    """

    friction: Friction = field(default_factory=lambda: coulomb(0.01))
    spring: Spring = field(default_factory=linear)
    sensors: Sensors = field(default_factory=Sensors)
    varied: Callable[[Arm], Arm] = lambda arm: arm
    jitter: float = 0.0
    largest_skew: float = 3e-3  # s
    aside: float = 0.8  # rad; largest angle between the middle of the motion and hanging down
    duration: float = 6.0  # s
    dt: float = 2e-3  # s
    stated_mass: float = 1.0  # factor of the robot file on masses and inertias of the links
    cause: str = ""
    lag: float = 0.0
    others: Others | None = None
    table: bool = False


@dataclass(frozen=True, eq=False)
class Draws:
    """Arms (d, n) and samples. delay (d,), skew (d, n) [s]; stiffness, motor_inertia (d, n): of the robot files."""

    case: Case
    arm: Arm
    delay: Array
    skew: Array
    stiffness: Array
    motor_inertia: Array
    motion: Motion
    records: list[Samples]

    def truth(self, i: int) -> dict[str, Array]:
        """Return the parameters (n,) of draw i by the names of `fjr identify`."""
        arm, n = self.arm, self.skew.shape[1]
        values = {
            "joint_stiffness": arm.stiffness,
            "motor_inertia": arm.motor_inertia,
            "link_damping": arm.link_damping,
            "motor_damping": arm.motor_damping,
            "link_coulomb_friction": arm.link_friction,
            "motor_coulomb_friction": arm.motor_friction,
            "offset": arm.offset,
            "effort_delay": np.repeat(self.delay[:, None] + self.case.lag + self.case.jitter / 2, n, axis=1),
            "actuator_lag": np.full_like(self.skew, self.case.lag),
            "gear_ratio_error": np.full_like(self.skew, self.case.sensors.motor.gain / self.case.sensors.link.gain - 1),
            "link_skew": self.skew,
        }
        friction, none = arm.friction, np.zeros(self.skew.shape)
        if friction.turning is not None:
            values["friction_smoothing_velocity"] = none + friction.turning
            values |= {"link_load_friction": none + friction.share, "motor_load_friction": none + friction.share}
        if friction.stribeck:
            values |= {
                f"{side}_static_friction": (1 + friction.excess) * values[f"{side}_coulomb_friction"]
                for side in ("link", "motor")
            }
            values["stribeck_velocity"] = none + friction.stribeck
        return {name: np.asarray(value[i]) for name, value in values.items()}

    def secants(self, i: int) -> Array:
        """Return the least and the largest stiffness (n, 2) between two deflections that draw i drove."""
        spring, ranges = self.arm.spring, []
        for j, deflection in enumerate(self.deflections(i)):
            ends = np.quantile(deflection, (0.01, 0.99))
            zeta, (a, b) = np.linspace(*ends, CHORDS), np.triu_indices(CHORDS, CHORDS // 5)
            tau = spring.torque(self.arm.stiffness[i, j], zeta)
            slopes = (tau[b] - tau[a]) / (zeta[b] - zeta[a])
            ranges.append((slopes.min(), spring.stiffest * slopes.max()))
        return np.array(ranges)

    def deflections(self, i: int) -> Array:
        """Return the deflections (n, k) that draw i drove, as measured, without skew and offset."""
        samples = self.records[i]
        late = [np.interp(samples.t, samples.t + skew, q) for skew, q in zip(self.skew[i], samples.q_l.T, strict=True)]
        return np.asarray((samples.q_m - self.arm.offset[i]).T - late)

    def changes_sign(self, i: int, share: float) -> NDArray[np.bool_]:
        """Return whether at least this share of the torques (n,) of draw i has either sign."""
        ends = np.quantile(self.deflections(i), (share, 1 - share), axis=1)
        low, high = (self.arm.spring.torque(self.arm.stiffness[i], end) for end in ends)
        return np.asarray((low < 0) & (high > 0))

    def urdf(self, i: int) -> str:
        """Return the URDF of draw i without its tip mass and tilt; joints turn about y, links hang at 0."""
        arm, parts, height = self.arm, ['<robot name="chain"><link name="base"/>'], 0.0
        for j in range(self.skew.shape[1]):
            mass, inertia = (self.case.stated_mass * values[i, j] for values in (arm.mass, arm.inertia))
            parts.append(
                f'<link name="link{j}"><inertial><origin xyz="0 0 {-arm.com[i, j]}"/><mass value="{mass}"/>'
                f'<inertia ixx="{inertia}" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{inertia}"/></inertial></link>'
                f'<joint name="joint{j}" type="continuous"><parent link="{f"link{j - 1}" if j else "base"}"/>'
                f'<child link="link{j}"/><origin xyz="0 0 {height}"/><axis xyz="0 1 0"/></joint>'
            )
            height = -arm.length[i, j]
        return "".join([*parts, "</robot>"])


def drawn(case: Case, joints: int, count: int, seed: int) -> Draws:
    """Return `count` draws of arms with this number of joints."""
    random, shape = np.random.default_rng((seed, joints)), (count, joints)
    arm = case.varied(_arm(random, shape, case))
    delay = random.uniform(5e-4, 4e-3, count)
    skew = random.uniform(-case.largest_skew, case.largest_skew, shape)
    motion = _motion(random, arm, delay, case)
    worse = (np.exp(width * random.standard_normal(shape)) for width in (STIFFNESS_ERROR, INERTIA_ERROR))
    stiffness, inertia = (np.clip(factor, 0.4, 2.5) for factor in worse)
    records = sampled(motion, case.dt, skew, case.sensors, seed)
    return Draws(case, arm, delay, skew, stiffness * arm.stiffness, inertia * arm.motor_inertia, motion, records)


def _arm(random: np.random.Generator, shape: tuple[int, int], case: Case) -> Arm:
    """Return arms whose springs swing at 7 to 18 Hz and whose friction is a part of their weight."""
    count, n = shape
    length, mass = random.uniform(0.2, 0.4, shape), random.uniform(0.8, 2.5, shape)
    none = np.zeros(shape)
    inertia = mass * length**2 * random.uniform(0.05, 0.12, shape)
    arm = Arm(mass, length * random.uniform(0.35, 0.6, shape), length, inertia, *[none] * 7)
    links = np.diagonal(arm.link_inertia(none), axis1=-2, axis2=-1)
    rotor = links * random.uniform(0.2, 0.8, shape)
    stiffness = (2 * np.pi * random.uniform(7.0, 18.0, shape)) ** 2 * links * rotor / (links + rotor)
    critical = 2 * np.sqrt(stiffness * rotor)
    weight = G * np.cumsum(arm.arms[1][:, ::-1], axis=1)[:, ::-1]
    return replace(
        arm,
        stiffness=stiffness,
        motor_inertia=rotor,
        link_damping=critical * random.uniform(0.005, 0.02, shape),
        motor_damping=critical * random.uniform(0.005, 0.02, shape),
        link_friction=weight * random.uniform(0.02, 0.08, shape),
        motor_friction=weight * random.uniform(0.02, 0.08, shape),
        offset=random.uniform(-5e-3, 5e-3, shape),
        friction=case.friction,
        spring=case.spring,
        tip_mass=np.zeros(count),
        tilt=np.zeros(count),
        cable=none,
        lag=case.lag,
        others=case.others,
    )


def on_table(arm: Arm) -> Arm:
    """Return the arm on a table as its first joint, which turns about an axis 0.6 m above at 15 Hz against a spring."""
    d, n = arm.mass.shape
    table = {"mass": 30.0, "com": 0.3, "length": 0.6, "inertia": 0.9, "motor_inertia": 1e9, "link_damping": 0.0}
    names = [name for name, each in vars(arm).items() if isinstance(each, np.ndarray) and each.shape == (d, n)]
    whole = {name: np.insert(getattr(arm, name), 0, table.get(name, 0.0), axis=1) for name in names}
    arm = replace(arm, **whole)
    inertia = arm.link_inertia(np.zeros((d, n + 1)))[:, 0, 0]
    arm.stiffness[:, 0] = (2 * np.pi * 15.0) ** 2 * inertia
    arm.link_damping[:, 0] = 0.02 * 2 * np.sqrt(arm.stiffness[:, 0] * inertia)
    return arm


def _motion(random: np.random.Generator, arm: Arm, delay: Array, case: Case) -> Motion:
    """Return the motion under a position loop with the weight fed forward, along random sums of sines."""
    count, n = arm.mass.shape
    number = int(round(case.duration / case.dt)) + 16
    sines = (SINES, count, n)
    frequency, phase = 2 * np.pi * random.uniform(0.2, 1.8, sines), random.uniform(0, 2 * np.pi, sines)
    amplitude, middle = (
        PEAK / SINES * random.uniform(0.4, 1.0, sines),
        random.uniform(-case.aside, case.aside, (count, n)),
    )
    late = delay + case.jitter * random.random((number + 1, count))
    t = case.dt * np.arange(number + 1)[:, None] + np.minimum(late, 0.9 * case.dt + delay)
    angle = frequency[None] * (case.dt * np.arange(number))[:, None, None, None] + phase
    q = middle + np.sum(amplitude * np.sin(angle), axis=1)
    v = np.sum(amplitude * frequency * np.cos(angle), axis=1)
    total = arm.motor_inertia + np.diagonal(arm.link_inertia(np.zeros((count, n))), axis1=-2, axis2=-1)
    weight = arm.link_torque(q, np.zeros_like(q))

    def control(k: Array, i: Array, x: Array) -> Array:
        error, rate = q[k, i] - x[:, 1], v[k, i] - x[:, 3]
        return np.asarray(weight[k, i] + total[i] * (BAND**2 * error + 2 * BAND * rate))

    x = np.zeros((count, arm.rows, n))
    x[:, 0], x[:, 1], x[:, 2], x[:, 3] = q[0], q[0], v[0], v[0]
    x[:, 1] += weight[0] / arm.stiffness + arm.offset
    if arm.rows > 7:
        x[:, 7] = weight[0]
    if not case.table:
        return simulated(arm, x, t, control)
    held = lambda k, i, x: np.insert(control(k, i, x[:, :, 1:]), 0, 0.0, axis=1)  # noqa: E731
    motion = simulated(on_table(arm), np.insert(x, 0, 0.0, axis=2), t, held)
    return Motion(motion.t, motion.x[..., 1:], motion.u[..., 1:])
