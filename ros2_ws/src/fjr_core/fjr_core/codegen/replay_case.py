# SPDX-License-Identifier: Apache-2.0
"""A closed loop as Python runs it, sample by sample, with all that goes into and comes out of each function."""

from __future__ import annotations

import io
from dataclasses import dataclass, fields

import numpy as np

from ..errors import StateError
from ..numerics.casadi_function import NumericFunction
from ..numerics.checks import Array
from ..trajectories.reference import JETS
from .exported_loop import Loop


@dataclass(frozen=True)
class Case:
    """k samples, a row each; sizes and units as in SampledLaw.step_function, jets (k, 5n) a derivative after the other.

    t (k, 1) of the sample, dt (k, 1) since the last, x (k, 4n) the plant's state, x_next (k, 4n) one sample later.
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
    """The first samples of the loop from its x0; raises StateError where it diverges.

    The reference is NumPy's, law and plant run in CasADi's virtual machine.
    """
    n, m = loop.n, len(loop.law.memory)
    sizes = (2 * n,), (2 * n,), (JETS, n), loop.law.gain_values.shape, (m,), (n,), ()
    law = NumericFunction(loop.law.step_function, sizes)
    rows: list[tuple[Array, ...]] = []
    x: Array = np.asarray(loop.x0, dtype=float)
    sent: Array = np.zeros(n)
    memory, dt = loop.law.memory, 0.0
    for k in range(samples):
        t = k * loop.sample_period
        position, velocity = x[: 2 * n], np.concatenate(loop.plant.robot.velocities(x))
        jets = loop.reference.jets(t + loop.law.lead)
        u, V, after = law(position, velocity, jets, loop.law.gain_values, memory, sent, dt)
        x_next = _one_sample_later(loop, x, u)
        if not np.isfinite(x_next).all():
            raise StateError(f"the loop diverged at t = {t:.6g} s; expected one that is stable as sampled (fjr check)")
        rows.append(
            (np.array([t]), np.array([dt]), x, position, velocity, jets.ravel(), memory, sent, u, V, after, x_next)
        )
        x, memory, sent, dt = x_next, after, u, loop.sample_period
    return Case(*(np.array(column) for column in zip(*rows, strict=True)))


def _one_sample_later(loop: Loop, x: Array, u: Array) -> Array:
    for _ in range(loop.inner_steps):
        x = loop.plant.step(x, u, loop.inner_step)
    return x


def as_csv(case: Case) -> str:
    """A line of names, then a row a sample; numbers with 17 digits, which give back the same doubles."""
    columns = {field.name: getattr(case, field.name) for field in fields(case)}
    names = [f"{name}[{i}]" for name, values in columns.items() for i in range(values.shape[1])]
    text = io.StringIO()
    np.savetxt(text, np.hstack(list(columns.values())), fmt="%.17g", delimiter=",", header=",".join(names), comments="")
    return text.getvalue()
