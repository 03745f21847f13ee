# SPDX-License-Identifier: Apache-2.0
"""Check a control law: shapes, finite efforts, purity, and its certificate, at random states."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..errors import FjrError, ParameterError
from ..extensions.python_code import PythonLaw
from ..law.interfaces import StaticLaw
from ..law.vdpbc import TrackingLaw
from ..model.port_hamiltonian import Plant
from ..model.robot import Robot
from ..motions.reference import JETS
from ..numerics.checks import Array
from .findings import RELATIVE, Findings, random_states, rounded, slope

Sample = tuple[Array, Array]
"""A state x (4n,) and reference jets (5, n)."""


def check_law(law: Any, robot: Robot | None = None, states: int = 64, seed: int = 0) -> tuple[str, ...]:
    """Check a law at random states and references; return a sentence for each property that holds.

    law: an object with the members of control.python_law.OwnLaw, or a StaticLaw. robot: default law.robot.
    Checked: u (n,) is finite, and V of a law with a storage 0 or more; the result depends on the arguments only, which
    are not changed; dV/dt <= -2 rate V along the closed loop with the robot, if the law has a rate.
    Raises CheckError with one sentence for each fault, and ParameterError without a robot.
    """
    robot = robot or getattr(law, "robot", None)
    if not isinstance(robot, Robot):
        raise ParameterError(f"{type(law).__name__} has no robot; expected check_law(law, robot)")
    findings = Findings(type(law).__name__)
    rng = np.random.default_rng(seed)
    x = random_states(robot, states, rng)
    jets = rng.uniform(-1.0, 1.0, (states, JETS, robot.n))
    samples = list(zip(x, jets, strict=True))
    try:
        checked = law if isinstance(law, StaticLaw) else PythonLaw(law, robot)
        _check_values(checked, samples, findings)
        if not findings.faults:
            _check_certificate(checked, samples, findings)
    except FjrError as error:
        findings.faults.append(str(error))
    return findings.result()


def _check_values(law: StaticLaw, samples: Sequence[Sample], findings: Findings) -> None:
    """Evaluate the law at all samples, and again in the opposite order."""
    once = [_values(law, sample) for sample in samples]
    again = [_values(law, sample) for sample in reversed(samples)][::-1]
    at = next((k for k, each in enumerate(once) if not np.isfinite(each[:-1]).all()), None)
    fault = f"u is not finite at {_where(law, samples[at])}; expected finite numbers" if at is not None else ""
    findings.add(fault, f"u ({law.robot.n},) is finite at {len(samples)} states")
    findings.add_repetition(once, again)


def _check_certificate(law: StaticLaw, samples: Sequence[Sample], findings: Findings) -> None:
    V = np.array([_values(law, sample)[-1] for sample in samples])
    if isinstance(law, PythonLaw) and not law.has_storage:
        return
    if not isinstance(law, PythonLaw) and np.isnan(V).all():
        return
    least = int(np.argmin(np.where(np.isnan(V), -np.inf, V)))
    fault = f"V is {V[least]:.4g} J at {_where(law, samples[least])}; expected 0 or more"
    findings.add("" if V[least] >= 0 else fault, "V is 0 or more")
    rate = _rate(law, samples)
    if rate is None or findings.faults:
        return
    plant = Plant(law.robot)
    dV = np.array([_storage_rate(law, plant, sample) for sample in samples])
    bound = -2 * rate * V
    excess = dV - bound - RELATIVE * (np.abs(dV) + np.abs(bound))
    worst = int(np.argmax(excess))
    fault = (
        f"dV/dt is {dV[worst]:.4g} W at {_where(law, samples[worst])}, where V is {V[worst]:.4g} J; "
        f"expected at most -2 rate V = {bound[worst]:.4g} W with the rate {rate:.4g} 1/s"
    )
    findings.add("" if excess[worst] <= 0 else fault, f"V decays at least as exp(-2 rate t), rate {rate:.4g} 1/s")


def _rate(law: StaticLaw, samples: Sequence[Sample]) -> float | None:
    """Return the rate [1/s] that the law claims, None without one."""
    if isinstance(law, TrackingLaw):
        return law.rate(np.array([x[: law.robot.n] for x, _ in samples])).beta
    rate = getattr(law.own, "rate", None) if isinstance(law, PythonLaw) else None
    if rate is not None and not (isinstance(rate, (int, float)) and 0 < rate < np.inf):
        raise ParameterError(f"rate is {rate!r}; expected a positive number [1/s]")
    return rate


def _storage_rate(law: StaticLaw, plant: Plant, sample: Sample) -> float:
    """Return dV/dt [W] along the closed loop, with the reference continued by its derivatives."""
    x, jets = sample
    dx = plant.derivative(x, law.command(x, jets))
    djets = np.vstack([jets[1:], np.zeros(law.robot.n)])
    return slope(lambda s: float(_values(law, (x + s * dx, jets + s * djets))[-1]))


def _values(law: StaticLaw, sample: Sample) -> Array:
    """Return (u, V) (n + 1,) at a sample; raises UserCodeError."""
    x, jets = sample
    n = law.robot.n
    u, V = law.measured_command(x[: 2 * n], np.concatenate(law.robot.velocities(x)), jets)
    return np.append(u, V)


def _where(law: StaticLaw, sample: Sample) -> str:
    return f"q_l = {rounded(sample[0][: law.robot.n])}"
