# SPDX-License-Identifier: Apache-2.0
"""Record a closed loop in Python, sample by sample, with inputs and outputs of each exported function."""

from __future__ import annotations

import io
from dataclasses import dataclass, fields

import numpy as np

from ..errors import StateError
from ..numerics.casadi_function import NumericFunction
from ..numerics.checks import Array
from .exported_loop import Loop


@dataclass(frozen=True)
class Case:
    """k samples, one per row; sizes and units as in SampledLaw.step_function, jets (k, 5n) by increasing derivative.

    t (k, 1) [s]: time; dt (k, 1) [s]: since the last sample; x (k, 4n): state of the plant; x_next (k, 4n): one sample
    later.
    """

    t: Array
    dt: Array
    x: Array
    position: Array
    velocity: Array
    jets: Array
    memory: Array
    sent: Array
    u: Array
    V: Array
    next: Array
    x_next: Array


def recorded(loop: Loop, samples: int) -> Case:
    """Simulate the first samples of the loop from its x0; raises StateError if it diverges.

    The reference is evaluated by NumPy, law and plant by CasADi's virtual machine.
    """
    n, law = loop.n, NumericFunction(loop.law.step_function)
    rows: list[tuple[Array, ...]] = []
    x: Array = np.asarray(loop.x0, dtype=float)
    sent: Array = np.zeros(n)
    memory, dt = loop.law.memory, 0.0
    for k in range(samples):
        t = k * loop.sample_period
        position, velocity = x[: 2 * n], np.concatenate(loop.plant.robot.velocities(x))
        jets = loop.reference.jets(t + loop.law.lead)
        u, V, after = law(position, velocity, jets, loop.law.gain_values, memory, sent, dt)
        x_next = x
        for _ in range(loop.inner_steps):
            x_next = loop.plant.step(x_next, u, loop.inner_step)
        if not np.isfinite(x_next).all():
            raise StateError(
                f"the loop diverged at t = {t:.6g} s; expected a loop that is stable at its sample period (fjr check)"
            )
        rows.append(
            (np.array([t]), np.array([dt]), x, position, velocity, jets.ravel(), memory, sent, u, V, after, x_next)
        )
        x, memory, sent, dt = x_next, after, u, loop.sample_period
    return Case(*(np.array(column) for column in zip(*rows, strict=True)))


def as_csv(case: Case) -> str:
    """Format a line of names, then one row per sample; 17 digits reproduce the doubles exactly."""
    columns = {field.name: getattr(case, field.name) for field in fields(case)}
    names = [f"{name}[{i}]" for name, values in columns.items() for i in range(values.shape[1])]
    text = io.StringIO()
    np.savetxt(text, np.hstack(list(columns.values())), fmt="%.17g", delimiter=",", header=",".join(names), comments="")
    return text.getvalue()
