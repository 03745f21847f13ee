# SPDX-License-Identifier: Apache-2.0
"""Check a plant: shapes, finite derivatives, purity, kinematics, and its power balance, at random states."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ..errors import FjrError, ParameterError
from ..extensions.python_code import PythonPlant
from ..model.port_hamiltonian import Plant
from ..model.robot import Robot
from ..numerics.checks import Array
from .findings import RELATIVE, Findings, random_states, rounded, slope

EFFORT = 10.0  # N m
Sample = tuple[Array, Array]
"""A state x (4n,) and an effort u (n,)."""


def check_plant(plant: Any, robot: Robot | None = None, states: int = 64, seed: int = 0) -> tuple[str, ...]:
    """Check a plant at random states and efforts; return a sentence for each property that holds.

    plant: an object with the members of robot.python_plant.OwnPlant, or a Plant. robot: default plant.robot.
    Checked: dx (4n,) is finite; it depends on the arguments only, which are not changed; its first 2n entries are the
    velocities of x; dH/dt <= u' B_m' dq_m if the plant has a hamiltonian: it creates no energy.
    Raises CheckError with one sentence for each fault, and ParameterError without a robot.
    """
    robot = robot or getattr(plant, "robot", None)
    if not isinstance(robot, Robot):
        raise ParameterError(f"{type(plant).__name__} has no robot; expected check_plant(plant, robot)")
    findings = Findings(type(plant).__name__)
    rng = np.random.default_rng(seed)
    samples = list(zip(random_states(robot, states, rng), rng.uniform(-EFFORT, EFFORT, (states, robot.n)), strict=True))
    try:
        checked = plant if isinstance(plant, Plant) else PythonPlant(plant, robot)
        _check_values(checked, samples, findings)
        H = _energy(plant, robot)
        if H is not None and not findings.faults:
            _check_power(checked, H, samples, findings)
    except FjrError as error:
        findings.faults.append(str(error))
    return findings.result()


def _check_values(plant: Plant, samples: Sequence[Sample], findings: Findings) -> None:
    once = [plant.derivative(*sample) for sample in samples]
    again = [plant.derivative(*sample) for sample in reversed(samples)][::-1]
    bad = next((sample for sample, dx in zip(samples, once, strict=True) if not np.isfinite(dx).all()), None)
    fault = f"dx is not finite at {_where(plant, bad)}; expected finite numbers" if bad is not None else ""
    findings.add(fault, f"dx ({4 * plant.robot.n},) is finite at {len(samples)} states")
    findings.add_repetition(once, again)
    n = plant.robot.n
    errors = [
        np.max(np.abs(dx[: 2 * n] - np.concatenate(plant.robot.velocities(x))))
        for (x, _), dx in zip(samples, once, strict=True)
    ]
    worst = int(np.argmax(errors))
    fault = (
        f"dx[:2n] differs by {errors[worst]:.3g} rad/s from the velocities of x at {_where(plant, samples[worst])}; "
        "expected (M_l^-1 p_l, M_m^-1 p_m) with the inertia of the robot"
    )
    findings.add("" if errors[worst] <= RELATIVE else fault, "dx[:2n] are the velocities of x")


def _energy(plant: Any, robot: Robot) -> Callable[[Array], float] | None:
    """Return the energy H(x) [J] of the plant, None without one."""
    if isinstance(plant, Plant) and not isinstance(plant, PythonPlant):
        return robot.hamiltonian
    return getattr(plant.own if isinstance(plant, PythonPlant) else plant, "hamiltonian", None)


def _check_power(plant: Plant, H: Callable[[Array], float], samples: Sequence[Sample], findings: Findings) -> None:
    """Check dH/dt <= u' B_m' dq_m, the power supplied by the motors."""
    gains, powers = [], []
    for x, u in samples:
        dx = plant.derivative(x, u)
        gains.append(slope(lambda s, x=x, dx=dx: float(H(x + s * dx))))  # type: ignore[misc]
        powers.append(float(plant.robot.velocities(x)[1] @ plant.robot.B_m @ u))
    dH, supplied = np.array(gains), np.array(powers)
    scale = np.abs(dH) + np.abs(supplied) + max(abs(float(H(x))) for x, _ in samples)
    excess = dH - supplied - RELATIVE * scale
    worst = int(np.argmax(excess))
    fault = (
        f"dH/dt is {dH[worst]:.4g} W at {_where(plant, samples[worst])}, where the motors supply "
        f"{supplied[worst]:.4g} W; expected at most that"
    )
    findings.add("" if excess[worst] <= 0 else fault, "dH/dt is at most the power of the motors")


def _where(plant: Plant, sample: Sample) -> str:
    return f"q_l = {rounded(sample[0][: plant.robot.n])}"
