# SPDX-License-Identifier: Apache-2.0
"""Possible faults of a robot and its sensors, each with the residual torque that it causes.

Each hypothesis is a set of columns; the residual is their sum with unknown coefficients. A wrong stiffness, for
example, leaves opposite torques proportional to the deflection in the two equations of its joint. A payload is a body
fixed to a link: its joint torques are linear in its ten inertial parameters. A base that stands at an angle changes
gravity in its frame, in which the weight is linear. A fault of an encoder adds an error to the measured position, and
its rate to the measured velocity: that of a gain is the position, that of an eccentric disc the sine of the angle, once
a turn, that of a drift the time. Friction, or a guess of the model, may be wrong at all joints at once.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from fjr_core.errors import RobotError
from fjr_core.model import springs
from fjr_core.model.newton_euler import ChainAt, mass_of
from fjr_core.model.rigid_arm import ArmDynamics
from fjr_core.numerics.checks import Array

from .residuals import Residuals, over_rows

SECOND_MOMENTS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
PARAMETERS = 4 + len(SECOND_MOMENTS)
LINK, MOTOR, JOINT, BASE = "link", "motor", "joint", "base"
CABLE = "pull of a cable"
SMOOTHING = 0.01, 1e-3  # rad/s, m/s; speed of revolute and prismatic joints below which its sign is uncertain
FREEPLAYS = np.geomspace(0.02, 2.0, 40)  # tested half-widths of backlash, relative to the RMS deflection
LIMITS = np.geomspace(2e-3, 0.95, 60)  # of an effort, relative to the largest one that is sent
CLIPPED = 5  # smallest number of blocks in which an effort exceeds its limit
LONGEST_ARM = 1.5  # m; largest considered distance of a payload from its joint
STEPS = 60  # of the fit of a payload
OF_GRAVITY = 0.05  # largest change of the size of gravity that is attributed to its direction
SIDES = LINK, MOTOR, JOINT
FRICTIONS = COULOMB, VISCOUS, FRICTION = "Coulomb friction", "viscous friction", "friction"
SHARED = ((COULOMB,), (VISCOUS,), (COULOMB, VISCOUS), ("stiffness",), ("torque constant",), ("inertia",))
"""Kinds that all joints, or one, may have together."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """Possible fault: kind, joint (index; None: all), side, unit of its size, and the residual (b, 2n) that it causes.

    columns (b, 2n, p): residual per unknown. size: returns the size from the p fitted unknowns, None if the fault is
    impossible. nonlinear: fits dependent unknowns from (A, c) = (X'X, X'y); None: least squares. least: what the first
    unknown must exceed. detail: all sizes, or what the model should say, from the p unknowns. sizes: these as numbers,
    by kind, or as "gravity" [m/s^2].
    """

    kind: str
    joint: int | None
    side: str
    unit: str
    columns: Array
    size: Callable[[Array], float | None] = lambda fitted: float(fitted[0])
    nonlinear: Callable[[Array, Array], Array] | None = None
    least: float = -np.inf
    detail: Callable[[Array], str] = lambda fitted: ""
    sizes: Callable[[Array], dict[str, list[float]]] = lambda fitted: {}

    @property
    def unknowns(self) -> int:
        """How many numbers are fitted: four of a point mass, which a cable resembles where a joint moves little."""
        return 4 if self.kind == CABLE or self.columns.shape[2] == PARAMETERS else self.columns.shape[2]

    def place(self, names: Sequence[str]) -> str:
        """Return where the fault is, with the names of the joints."""
        if self.joint is None:
            return BASE if self.side == BASE else f"all {self.side}s"
        return names[self.joint] if self.side == JOINT else f"{self.side} of {names[self.joint]}"


def hypotheses(seen: Residuals) -> Iterator[Hypothesis]:
    """Return all possible faults of all joints."""
    n, of_joints = seen.robot.n, list[Hypothesis]()
    for j, units in enumerate(seen.robot.units):
        of_sides = *_of_side(seen, j, LINK, j), *_of_side(seen, j, MOTOR, n + j)
        for each in (*of_sides, *_of_spring(seen, j), *_of_motor(seen, j, n + j)):
            of_joints.append(replace(each, unit=units.of(each.unit)))
        yield from _of_body(seen, j, units.of("kg m^2"))
    yield from of_joints
    one = {(each.side, each.kind, each.joint): each for each in reversed(of_joints)}
    everywhere = [(None, range(n))] if n > 1 else []
    for side, kinds, (at, joints) in itertools.product(SIDES, SHARED, (*everywhere, *((j, [j]) for j in range(n)))):
        parts = [one[side, kind, j] for kind in kinds for j in joints if (side, kind, j) in one]
        if len(parts) > 1:
            yield _together(parts, at)
    yield from _of_base(seen)


def _of_side(seen: Residuals, j: int, side: str, channel: int) -> Iterator[Hypothesis]:
    """Return constant torque and frictions of one side of a joint; offset, gain, eccentricity, drift of its encoder."""
    dq, damping = seen.dq[:, channel], (seen.robot.D_l if side == LINK else seen.robot.D_m)[j, j]
    slides = seen.robot.units[j].position == "m"

    yield Hypothesis("constant torque", j, side, "N m", seen.placed({channel: np.ones_like(dq)}))
    coulomb = seen.placed({channel: -np.tanh(dq / SMOOTHING[slides])})
    yield Hypothesis(COULOMB, j, side, "N m", coulomb, least=0.0)  # else friction would add energy
    yield Hypothesis(VISCOUS, j, side, "N m s/rad", seen.placed({channel: -dq}), least=-damping)
    if side == LINK:
        pull = [seen.placed({channel: signal}) for signal in (-seen.q[:, channel], np.ones_like(dq))]
        yield Hypothesis(CABLE, j, side, "N m/rad", np.concatenate(pull, axis=2))
    q, dq = seen.found.states[:, :, channel], seen.found.states[:, :, 2 * seen.robot.n + channel]
    one = np.ones_like(q)
    t = seen.found.t[:, None] * one
    column = seen.of_encoder(channel)
    yield Hypothesis("position offset", j, side, "rad", column(one, 0 * one))
    yield Hypothesis("encoder gain", j, side, "%", column(q, dq), lambda share: 100 * float(share[0] / (1 - share[0])))
    turn = np.concatenate([column(np.sin(q), np.cos(q) * dq), column(np.cos(q), -np.sin(q) * dq)], axis=2)
    if not slides:  # a linear encoder has no disc
        yield Hypothesis("eccentricity", j, side, "rad", turn, lambda fitted: float(np.hypot(*fitted)))
    yield Hypothesis("encoder drift", j, side, "rad/s", column(t, one))


def _of_spring(seen: Residuals, j: int) -> Iterator[Hypothesis]:
    """Return stiffness, of the joint alone and with its couplings, and backlash: torques with opposite reactions."""
    n, K = seen.robot.n, seen.robot.K
    k, made = K[j, j], (seen.q[:, n:] - seen.q[:, :n])[:, j, None] * K[:, j]
    zeta, row = made[:, j] / k, springs.torques(seen.robot, seen.q[:, n:] - seen.q[:, :n])[:, j]
    bent = row / k if seen.robot.curve else zeta
    linear = seen.placed({j: bent, n + j: -bent})
    yield Hypothesis("stiffness", j, JOINT, "%", linear, lambda fitted: 100 * float(fitted[0]) / k)
    made[:, j] = row
    coupled = seen.placed(dict(enumerate(np.hstack([made, -made]).T)))
    yield Hypothesis("stiffness", j, JOINT, "%", coupled, lambda fitted: 100 * float(fitted[0]))
    yield Hypothesis("cubic stiffness", j, JOINT, "N m/rad^3", seen.placed({j: zeta**3, n + j: -(zeta**3)}))
    for half in FREEPLAYS * np.sqrt(np.mean(zeta**2)):
        torque = -np.clip(zeta, -half, half) * k
        yield _of_size("backlash", j, JOINT, "rad", seen.placed({j: torque, n + j: -torque}), 2 * float(half))


def _of_size(kind: str, joint: int, side: str, unit: str, columns: Array, size: float) -> Hypothesis:
    """Return a fault of one size, whose columns (b, 2n, 1) are the residual."""
    return Hypothesis(kind, joint, side, unit, columns, lambda _: size, lambda A, c: np.ones(1))


def _of_motor(seen: Residuals, j: int, channel: int) -> Iterator[Hypothesis]:
    """Return torque constant, limit of the effort and inertia of the motor."""
    u = seen.u[:, j]

    def made(torque: Array) -> Array:  # by B_m a motor may drive other joints, too, as in a differential
        return seen.placed({seen.robot.n + i: b * torque for i, b in enumerate(seen.robot.B_m[:, j])})

    yield Hypothesis("torque constant", j, MOTOR, "%", made(u), lambda fitted: 100 * float(fitted[0]))
    for limit in LIMITS * np.max(np.abs(u)):
        columns = made(np.clip(u, -limit, limit) - u)
        if np.count_nonzero(columns.any(axis=1)) >= CLIPPED:
            yield _of_size("effort limit", j, MOTOR, "N m", columns, float(limit))
    yield Hypothesis("inertia", j, MOTOR, "kg m^2", seen.placed({channel: -seen.ddq[:, channel]}))


def _of_body(seen: Residuals, j: int, unit: str) -> Iterator[Hypothesis]:
    """Return a point mass on a link and the inertia of a link about its joint, or its mass in kg along a slide."""
    n, links = seen.robot.n, seen.robot.links
    if links.end_effector is None:
        yield Hypothesis("inertia", j, LINK, unit, seen.placed({j: -seen.ddq[:, j]}))
        return
    torque = -seen.means(body_torques(links, j, seen.q[:, :n], seen.dq[:, :n], seen.ddq[:, :n]))
    columns = np.zeros((len(torque), 2 * n, torque.shape[2]))
    columns[:, :n] = torque
    still = np.zeros((len(seen.q), n))
    weights = body_torques(links, j, seen.q[:, :n], still, still)[:, :, :4]
    efforts = np.array([each.effort for each in seen.robot.units])
    effort = str(efforts[np.abs(weights[:, :, 0]).max(axis=0).argmax()])  # of the joint that a mass loads most
    of_effort = weights[:, efforts == effort]

    def largest(fitted: Array) -> float:
        return float(np.abs(of_effort @ fitted[:4]).max())  # weight at any joint with this unit

    yield Hypothesis("gravity load", j, LINK, effort, columns[:, :, :4], largest)
    yield Hypothesis("gravity load", j, LINK, effort, columns, largest, _point_mass)
    parts = columns[:, :, :1] if unit == "kg" else columns[:, :, 4:7]
    yield Hypothesis("inertia", j, LINK, unit, parts, lambda fitted: float(fitted.sum()))


def _together(parts: Sequence[Hypothesis], joint: int | None) -> Hypothesis:
    """Return faults of one unknown each as one, of a joint or of all; its size is the largest of its first kind."""
    least, kinds = np.array([each.least for each in parts]), list(dict.fromkeys(each.kind for each in parts))

    def sizes(fitted: Array) -> dict[str, list[float]]:
        found = [(each.kind, each.size(fitted[i : i + 1]) or 0.0) for i, each in enumerate(parts)]
        return {kind: [size for of, size in found if of == kind] for kind in kinds}

    def bounded(A: Array, c: Array) -> Array:
        from scipy.optimize import lsq_linear  # 0.3 s of imports, as below

        return np.asarray(lsq_linear(*_square_root(A, c), (least, np.inf), method="bvls").x)

    columns = np.concatenate([each.columns for each in parts], axis=2)
    return Hypothesis(
        kinds[0] if len(kinds) == 1 else FRICTION,
        joint,
        parts[0].side,
        parts[0].unit,
        columns,
        lambda fitted: max(sizes(fitted)[kinds[0]], key=abs),
        bounded if np.isfinite(least).any() else None,
        detail=lambda fitted: f" ({', '.join(f'{x:.3g}' for x in sizes(fitted)[kinds[0]])})" if joint is None else "",
        sizes=sizes,
    )


def _of_base(seen: Residuals) -> Iterator[Hypothesis]:
    """Return the angle between gravity in the frame of the base and that of the model, for links with bodies."""
    n, links = seen.robot.n, seen.robot.links
    if not links.bodies or links.end_effector is None or not links.end_effector.gravity.any():
        return
    q_l, gravity, modelled = ca.SX.sym("q_l", n), ca.SX.sym("gravity", 3), links.end_effector.gravity
    along = [links.order.index(i) for i in range(n)]
    chain = ChainAt(links.bodies, [mass_of(body) for body in links.bodies], gravity, q_l[along])
    weight = ca.jacobian(chain.gravity_torque()[list(links.order)], gravity)
    function = ca.Function("weight", [q_l], [ca.densify(weight)])
    weights = over_rows(lambda rows: function(rows).full(), seen.q[:, :n], 3)
    columns = np.zeros((len(seen.r), 2 * n, 3))
    columns[:, :n] = -seen.means(weights)

    def angle(fitted: Array) -> float | None:
        size, turned = np.linalg.norm(modelled), np.linalg.norm(modelled + fitted)
        if abs(turned / size - 1) > OF_GRAVITY:
            return None
        return float(np.arccos(np.clip(modelled @ (modelled + fitted) / (size * turned), -1, 1)))

    def vector(fitted: Array) -> dict[str, list[float]]:
        return {"gravity": (np.round(modelled + fitted, 3) + 0.0).tolist()}  # no negative zero

    def detail(fitted: Array) -> str:
        return f" (gravity {vector(fitted)['gravity']} m/s^2)"

    yield Hypothesis("direction of gravity", None, BASE, "rad", columns, angle, detail=detail, sizes=vector)


def _point_mass(A: Array, c: Array) -> Array:
    """Fit a point mass of either sign, at most LONGEST_ARM away; return its ten inertial parameters."""
    from scipy.optimize import least_squares  # 0.3 s of imports, which the running nodes do not need

    root, target = _square_root(A, c)
    begins = ([m, *r] for m in (0.1, -0.1) for r in ((0.1, 0.0, 0.0), (0.0, 0.1, 0.1)))
    bounds = [-np.inf, *[-LONGEST_ARM] * 3], [np.inf, *[LONGEST_ARM] * 3]
    options: dict[str, Any] = {"bounds": bounds, "x_scale": "jac", "max_nfev": STEPS}

    def misses(x: Array) -> Array:
        return np.asarray(root @ _of_point_mass(x)[0] - target)

    tried = [least_squares(misses, begin, lambda x: root @ _of_point_mass(x)[1], **options) for begin in begins]
    return _of_point_mass(min(tried, key=lambda each: float(each.cost)).x)[0]


def _square_root(A: Array, c: Array) -> tuple[Array, Array]:
    """Return (X, y) of few rows with X'X = A and X'y = c, up to one factor of both."""
    scale = np.sqrt(np.diag(A).max()) or 1.0
    values, vectors = np.linalg.eigh(A / scale**2)
    kept = values > 1e-12 * values.max()
    root = (vectors[:, kept] * np.sqrt(values[kept])).T
    return root, (vectors[:, kept].T @ (c / scale)) / np.sqrt(values[kept]) / scale


def _of_point_mass(x: Array) -> tuple[Array, Array]:
    """Return the inertial parameters (10,) of x = (m, r) and their derivatives (10, 4)."""
    m, r, unit = x[0], x[1:], np.eye(3)
    unscaled = np.array([1.0, *r, *(r[i] * r[j] for i, j in SECOND_MOMENTS)])
    moments = [r[j] * unit[i] + r[i] * unit[j] for i, j in SECOND_MOMENTS]
    return m * unscaled, np.column_stack([unscaled, m * np.vstack([np.zeros(3), unit, *moments])])


def body_torques(links: ArmDynamics, link: int, q_l: Array, dq_l: Array, ddq_l: Array) -> Array:
    """Return the torques (k, n, 10) per inertial parameter of a body fixed to `link`, at k states (k, n).

    Parameters: m [kg]; m r [kg m] (3); sum m r r' [kg m^2] (6, in the order of SECOND_MOMENTS), r in the frame of
    the last link with the joints after `link` held at 0. d/dt dL/d(dq_l) - dL/dq_l with the Lagrangian
    L = sum m (|dp|^2 / 2 + g'p), p = p_0 + R r. Raises RobotError for links without an end-effector frame.
    """
    function, n = _function(links, link), links.n
    return over_rows(lambda rows: function(rows).full(), np.hstack([q_l, dq_l, ddq_l]), PARAMETERS).reshape(-1, n, 10)


def _function(links: ArmDynamics, link: int) -> ca.Function:
    """Build the function (q_l, dq_l, ddq_l) stacked -> (n, 10)."""
    if links.end_effector is None:
        raise RobotError("the links have no end-effector frame; expected links with one")
    n = links.n
    state, theta = ca.SX.sym("state", 3 * n), ca.SX.sym("theta", PARAMETERS)
    q_l, dq_l, ddq_l = ca.vertsplit(state, n)
    held = ca.vertcat(q_l[: link + 1], ca.SX.zeros(n - link - 1))
    p_0 = links.end_effector.position(held, ca.SX.zeros(3))
    R = ca.horzcat(*(links.end_effector.position(held, ca.SX.eye(3)[:, i]) - p_0 for i in range(3)))
    dp_0, dR = ca.jtimes(p_0, q_l, dq_l), ca.reshape(ca.jtimes(ca.vec(R), q_l, dq_l), 3, 3)
    m, mr, moments = theta[0], theta[1:4], theta[4:]
    S = ca.SX(3, 3)
    for value, (i, j) in zip(ca.vertsplit(moments), SECOND_MOMENTS, strict=True):
        S[i, j] = S[j, i] = value
    kinetic = m * ca.dot(dp_0, dp_0) / 2 + ca.dot(dp_0, dR @ mr) + ca.trace(dR @ S @ dR.T) / 2
    L = kinetic + ca.dot(ca.DM(links.end_effector.gravity), m * p_0 + R @ mr)
    momentum = ca.gradient(L, dq_l)
    torque = ca.jtimes(momentum, ca.vertcat(q_l, dq_l), ca.vertcat(dq_l, ddq_l)) - ca.gradient(L, q_l)
    return ca.Function("body_torques", [state], [ca.densify(ca.jacobian(torque, theta))], {"cse": True})
