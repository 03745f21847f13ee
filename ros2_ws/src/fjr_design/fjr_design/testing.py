# SPDX-License-Identifier: Apache-2.0
"""Check a law or a plant of the user at random states: shapes, finite values, purity, and its certificate or energy.

Both inequalities, of V and of H, are checked by central differences along the closed loop (docs/own_law.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from fjr_core.errors import FjrError, ParameterError
from fjr_core.extensions.python_code import PythonLaw, PythonPlant
from fjr_core.law.interfaces import StaticLaw
from fjr_core.law.vdpbc import TrackingLaw
from fjr_core.model.configuration_sampling import bounds_of
from fjr_core.model.port_hamiltonian import Plant
from fjr_core.model.robot import Robot
from fjr_core.motions.reference import JETS
from fjr_core.numerics.checks import Array

__all__ = ["CheckError", "check_law", "check_plant"]

STEP = 1e-5  # step of central differences, relative to the direction
RELATIVE = 1e-6  # largest violation of an inequality, relative to its terms, that counts as rounding
SPRING = 0.1  # rad; deflections of the joints
EFFORT = 10.0  # N m; of the samples of a plant

Sample = tuple[Array, Array]
"""A state x (4n,), and reference jets (5, n) of a law or an effort u (n,) of a plant."""


class CheckError(FjrError, AssertionError):
    """A check found faults; `faults` has one sentence for each."""

    def __init__(self, title: str, faults: Sequence[str]) -> None:
        super().__init__("\n".join(f"{title}: {fault}" for fault in faults))
        self.faults = tuple(faults)


def check_law(law: Any, robot: Robot | None = None, states: int = 64, seed: int = 0) -> tuple[str, ...]:
    """Check a law at random states and references; return a sentence for each property that holds.

    law: an object as extensions.python_code.PythonLaw takes it, or a StaticLaw. robot: default law.robot.
    Checked: u (n,) is finite, and V of a law with a storage 0 or more; the result depends on the arguments only, which
    are not changed; hold_damping damps; dV/dt <= -2 rate V along the closed loop with the robot, if the law has a rate.
    Raises CheckError with one sentence for each fault, and ParameterError without a robot.
    """
    check = _Check(law, robot, "check_law(law, robot)")
    rng = np.random.default_rng(seed)
    x = _random_states(check.robot, states, rng)
    samples = list(zip(x, rng.uniform(-1.0, 1.0, (states, JETS, check.robot.n)), strict=True))

    def checked() -> None:
        static = law if isinstance(law, StaticLaw) else PythonLaw(law, check.robot)
        check.pure(samples, lambda *sample: _effort_and_storage(static, sample), slice(-1), f"u ({static.robot.n},)")
        if np.linalg.eigvalsh(static.hold_damping + static.hold_damping.T)[0] < 0:
            check.faults.append(f"hold_damping is {static.hold_damping.tolist()}; expected no negative eigenvalue")
        if not check.faults:
            _check_certificate(static, samples, check)

    return check.result(checked)


def check_plant(plant: Any, robot: Robot | None = None, states: int = 64, seed: int = 0) -> tuple[str, ...]:
    """Check a plant at random states and efforts; return a sentence for each property that holds.

    plant: an object as extensions.python_code.PythonPlant takes it, or a Plant. robot: default plant.robot.
    Checked: dx (4n,) is finite; it depends on the arguments only, which are not changed; its first 2n entries are the
    velocities of x; dH/dt <= u' B_m' dq_m if the plant has a hamiltonian: it creates no energy.
    Raises CheckError with one sentence for each fault, and ParameterError without a robot.
    """
    check = _Check(plant, robot, "check_plant(plant, robot)")
    rng, n = np.random.default_rng(seed), check.robot.n
    x = _random_states(check.robot, states, rng)
    samples = list(zip(x, rng.uniform(-EFFORT, EFFORT, (states, n)), strict=True))

    def checked() -> None:
        own = plant if isinstance(plant, Plant) else PythonPlant(plant, check.robot)
        rates = check.pure(samples, own.derivative, slice(None), f"dx ({4 * n},)")
        velocities = [np.concatenate(own.robot.velocities(x)) for x, _ in samples]
        errors = [np.max(np.abs(dx[: 2 * n] - v)) for dx, v in zip(rates, velocities, strict=True)]
        worst = int(np.argmax(errors))
        fault = (
            f"dx[:2n] differs by {errors[worst]:.3g} rad/s from the velocities of x at {check.where(samples[worst])}; "
            "expected (M_l^-1 p_l, M_m^-1 p_m) with the inertia of the robot"
        )
        check.add("" if errors[worst] <= RELATIVE else fault, "dx[:2n] are the velocities of x")
        H = getattr(own.own, "hamiltonian", None) if isinstance(own, PythonPlant) else check.robot.hamiltonian
        if H is not None and not check.faults:
            _check_power(own, H, samples, check)

    return check.result(checked)


class _Check:
    """Sentences of a check: what holds, and the faults."""

    def __init__(self, checked: Any, robot: Robot | None, expected: str) -> None:
        self.title = type(checked).__name__
        robot = robot or getattr(checked, "robot", None)
        if not isinstance(robot, Robot):
            raise ParameterError(f"{self.title} has no robot; expected {expected}")
        self.robot = robot
        self.holds: list[str] = []
        self.faults: list[str] = []

    def add(self, fault: str, holds: str) -> None:
        """Add the fault, or what holds if it is empty."""
        if fault:
            self.faults.append(fault)
        else:
            self.holds.append(holds)

    def pure(self, samples: Sequence[Sample], evaluate: Callable[..., Array], finite: slice, name: str) -> list[Array]:
        """Evaluate at all samples, and again in the opposite order; return the first results.

        finite: the entries of each result that have to be finite, which the sentences call by `name`.
        """
        once = [evaluate(*sample) for sample in samples]
        again = [evaluate(*sample) for sample in reversed(samples)][::-1]
        at = next((k for k, found in enumerate(once) if not np.isfinite(found[finite]).all()), None)
        where = "" if at is None else self.where(samples[at])
        fault = f"{name.partition(' ')[0]} is not finite at {where}; expected finite numbers" if where else ""
        self.add(fault, f"{name} is finite at {len(samples)} states")
        same = all(np.array_equal(first, second, equal_nan=True) for first, second in zip(once, again, strict=True))
        fault = "a second evaluation at the same state differs; expected a pure function, without memory"
        self.add("" if same else fault, "the result depends on the arguments only")
        return once

    def where(self, sample: Sample) -> str:
        """Return the link positions of a sample, for a sentence."""
        return f"q_l = {[float(f'{q:.4g}') for q in sample[0][: self.robot.n]]}"

    def result(self, check: Callable[[], None]) -> tuple[str, ...]:
        """Run the check; return what holds, or raise CheckError if there are faults."""
        try:
            check()
        except FjrError as error:
            self.faults.append(str(error))
        if self.faults:
            raise CheckError(self.title, self.faults)
        return tuple(self.holds)


def _check_certificate(law: StaticLaw, samples: Sequence[Sample], check: _Check) -> None:
    """Check V >= 0 and dV/dt <= -2 rate V along the closed loop of the law and its robot."""
    V = np.array([_effort_and_storage(law, sample)[-1] for sample in samples])
    if not law.has_storage if isinstance(law, PythonLaw) else np.isnan(V).all():
        return
    least = int(np.argmin(np.where(np.isnan(V), -np.inf, V)))
    fault = f"V is {V[least]:.4g} J at {check.where(samples[least])}; expected 0 or more"
    check.add("" if V[least] >= 0 else fault, "V is 0 or more")
    rate = _rate(law, samples)
    if rate is None or check.faults:
        return
    plant = Plant(law.robot)
    dV = np.array([_storage_rate(law, plant, sample) for sample in samples])
    bound = -2 * rate * V
    excess = dV - bound - RELATIVE * (np.abs(dV) + np.abs(bound))
    worst = int(np.argmax(excess))
    fault = (
        f"dV/dt is {dV[worst]:.4g} W at {check.where(samples[worst])}, where V is {V[worst]:.4g} J; "
        f"expected at most -2 rate V = {bound[worst]:.4g} W with the rate {rate:.4g} 1/s"
    )
    check.add("" if excess[worst] <= 0 else fault, f"V decays at least as exp(-2 rate t), rate {rate:.4g} 1/s")


def _rate(law: StaticLaw, samples: Sequence[Sample]) -> float | None:
    """Return the rate [1/s] that the law claims, None without one."""
    if isinstance(law, TrackingLaw):
        return law.rate(np.array([x[: law.robot.n] for x, _ in samples])).beta
    rate = getattr(law.own if isinstance(law, PythonLaw) else law, "rate", None)
    if rate is not None and not (isinstance(rate, (int, float)) and 0 < rate < np.inf):
        raise ParameterError(f"rate is {rate!r}; expected a positive number [1/s]")
    return rate


def _storage_rate(law: StaticLaw, plant: Plant, sample: Sample) -> float:
    """Return dV/dt [W] along the closed loop, with the reference continued by its derivatives."""
    x, jets = sample
    dx = plant.derivative(x, law.command(x, jets))
    djets = np.vstack([jets[1:], np.zeros(law.robot.n)])
    return _slope(lambda s: float(_effort_and_storage(law, (x + s * dx, jets + s * djets))[-1]))


def _effort_and_storage(law: StaticLaw, sample: Sample) -> Array:
    """Return (u, V) (n + 1,) at a sample; raises UserCodeError."""
    x, jets = sample
    u, V = law.measured_command(x[: 2 * law.robot.n], np.concatenate(law.robot.velocities(x)), jets)
    return np.append(u, V)


def _check_power(plant: Plant, H: Callable[[Array], float], samples: Sequence[Sample], check: _Check) -> None:
    """Check dH/dt <= u' B_m' dq_m, the power supplied by the motors."""
    gains, powers = [], []
    for x, u in samples:
        dx = plant.derivative(x, u)
        gains.append(_slope(lambda s, x=x, dx=dx: float(H(x + s * dx))))  # type: ignore[misc]
        powers.append(float(plant.robot.velocities(x)[1] @ plant.robot.B_m @ u))
    dH, supplied = np.array(gains), np.array(powers)
    scale = np.abs(dH) + np.abs(supplied) + max(abs(float(H(x))) for x, _ in samples)
    excess = dH - supplied - RELATIVE * scale
    worst = int(np.argmax(excess))
    fault = (
        f"dH/dt is {dH[worst]:.4g} W at {check.where(samples[worst])}, where the motors supply "
        f"{supplied[worst]:.4g} W; expected at most that"
    )
    check.add("" if excess[worst] <= 0 else fault, "dH/dt is at most the power of the motors")


def _random_states(robot: Robot, count: int, rng: np.random.Generator) -> Array:
    """Return states x (k, 4n): links within their limits, deflections up to SPRING, speeds up to 1 rad/s."""
    n = robot.n
    q_l = rng.uniform(*bounds_of(robot), (count, n))
    q_m, speeds = q_l + rng.uniform(-SPRING, SPRING, (count, n)), rng.uniform(-1.0, 1.0, (count, 2, n))
    return np.array([robot.state(q, motor, *v) for q, motor, v in zip(q_l, q_m, speeds, strict=True)])


def _slope(f: Callable[[float], float]) -> float:
    """Return df/ds at 0 by the central difference of order 4."""
    near, far = (f(h * STEP) - f(-h * STEP) for h in (1, 2))
    return (8 * near - far) / (12 * STEP)
