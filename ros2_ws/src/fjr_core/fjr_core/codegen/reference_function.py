# SPDX-License-Identifier: Apache-2.0
"""Build the built-in references as CasADi functions t -> jets, from which C can be generated.

For circles and sines only the position is written here; CasADi derives the total derivatives along those of the angle.
"""

from __future__ import annotations

from functools import singledispatch

import casadi as ca
import numpy as np

from ..errors import TrajectoryError
from ..numerics.casadi_function import dense_function
from ..numerics.checks import Array
from ..numerics.symbolic import directional
from ..trajectories.circle import Circle
from ..trajectories.piecewise_polynomial import DEGREE, PiecewisePolynomial
from ..trajectories.point_to_point import Hold, PointToPoint
from ..trajectories.reference import JETS, Reference
from ..trajectories.sampled_motion import SampledMotion
from ..trajectories.sine import MultiSine, Sine
from ..trajectories.spline import Spline
from ..trajectories.transition import TimeShifted, Transition

FAR = 1e300  # s; larger times are equivalent
KNOWN = "Sine, MultiSine, PointToPoint, Circle, Hold, Spline, SampledMotion, joined or shifted"


def jets_function(reference: Reference) -> ca.Function:
    """Return the CasADi function t -> jets (n, 5) of a built-in reference; raises TrajectoryError for any other."""
    t = ca.MX.sym("t")
    return dense_function("reference", {"t": t}, {"jets": jets_expression(reference, t)})


@singledispatch
def jets_expression(reference: object, _t: ca.MX) -> ca.MX:
    """Return q_ld .. d4q_ld (n, 5) at time t [s]."""
    raise TrajectoryError(f"a reference {type(reference).__name__} cannot be exported to C; expected one of {KNOWN}")


@jets_expression.register(Sine)
@jets_expression.register(MultiSine)
def _(reference: Sine | MultiSine, t: ca.MX) -> ca.MX:
    a, w, phase = (np.atleast_2d(value) for value in (reference.amplitude, reference.frequency, reference.phase))
    return _sines(a, w, phase, np.asarray(reference.offset), t)


@jets_expression.register
def _(reference: Hold, _t: ca.MX) -> ca.MX:
    return ca.MX(ca.DM(reference.jets(0.0).T))


@jets_expression.register
def _(reference: PiecewisePolynomial, t: ca.MX) -> ca.MX:
    edges, origins, rates, coefficients = reference.table
    i = ca.low(ca.DM([-FAR, *edges, FAR]), t, {"lookup_mode": "binary"})
    s = (t - _entry(origins, i)) * _entry(rates, i)
    row, value = _entry(coefficients, i), ca.MX.zeros(JETS * reference.n)
    for part in reversed(ca.vertsplit(row, JETS * reference.n)):
        value = value * s + part
    assert row.numel() == (DEGREE + 1) * value.numel()
    return ca.reshape(value, reference.n, JETS)


@jets_expression.register
def _(reference: PointToPoint, t: ca.MX) -> ca.MX:
    within = ca.fmod(ca.fmax(t, 0.0), reference.period) if reference.returns else t
    return jets_expression(reference.pieces, within)


@jets_expression.register
def _(reference: Circle, t: ca.MX) -> ca.MX:
    angle = [ca.SX.sym(name) for name in ("angle", "w", "dw", "ddw", "d3w")]
    circle = reference.radius * ca.vertcat(ca.cos(angle[0]), ca.sin(angle[0]))
    position = ca.vertcat(circle, ca.DM.zeros(reference.n - 2)) + ca.DM(np.asarray(reference.centre))
    along_circle = dense_function(
        "turning", {"angle": ca.vertcat(*angle)}, {"jets": _with_derivatives(position, angle)}, cse=True
    )
    return along_circle(jets_expression(reference.angle, t).T)


@jets_expression.register(Spline)
@jets_expression.register(SampledMotion)
def _(reference: Spline | SampledMotion, t: ca.MX) -> ca.MX:
    return jets_expression(reference.pieces, t)


@jets_expression.register
def _(reference: Transition, t: ca.MX) -> ca.MX:
    sides = (jets_expression(side, t) for side in (reference.segment, reference.target))
    return ca.if_else(t < reference.transition_end, *sides)


@jets_expression.register
def _(reference: TimeShifted, t: ca.MX) -> ca.MX:
    return jets_expression(reference.reference, t - reference.t0)


def _sines(amplitude: Array, frequency: Array, phase: Array, offset: Array, t: ca.MX) -> ca.MX:
    """Return the jets of offset + sum of amplitude sin(frequency t + phase), with tables (m, n) and offset (n,)."""
    m, n = amplitude.shape
    angle = [ca.SX.sym("angle", m, n), ca.SX(ca.DM(frequency)), *(ca.SX.zeros(m, n) for _ in range(JETS - 2))]
    position = ca.DM(offset) + ca.sum1(ca.DM(amplitude) * ca.sin(angle[0])).T
    sines = dense_function("swing", {"angle": angle[0]}, {"jets": _with_derivatives(position, angle)}, cse=True)
    return sines(ca.DM(frequency) * t + ca.DM(phase))


def _with_derivatives(position: ca.SX, angle: list[ca.SX]) -> ca.SX:
    """Return position (n,) and its four derivatives as (n, 5), with angle[k] the k-th derivative of the angle."""
    rates = [ca.vec(ca.SX(rate)) for rate in angle]
    varying = [k for k, rate in enumerate(rates[:-1]) if not rate.is_constant()]
    z, dz = (ca.vertcat(*(rates[k + step] for k in varying)) for step in (0, 1))
    rows = [ca.SX(position)]
    for _ in range(JETS - 1):
        rows.append(directional(rows[-1], z, dz))
    return ca.horzcat(*rows)


def _entry(table: Array, i: ca.MX) -> ca.MX:
    """Return table[i] as a column for an integer i known only at run time."""
    width = int(np.prod(table.shape[1:], dtype=int))
    return ca.MX(ca.DM(table.ravel()))[i * width + ca.DM(range(width))]
