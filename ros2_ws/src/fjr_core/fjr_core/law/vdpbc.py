# SPDX-License-Identifier: Apache-2.0
"""The tracking law u(x_v, x, t), eqs. (30), (31), (33), (39), (40) and (42), with its storage V and its rate (43)."""

from __future__ import annotations

from collections.abc import Callable, Set
from dataclasses import dataclass, fields
from functools import cached_property
from types import SimpleNamespace
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import GainsError
from ..files import importing
from ..model import springs
from ..model.robot import Robot, check_robot
from ..motions.domain import GOAL, MOST_BOXES, Domain
from ..numerics.checks import Array, instance
from ..numerics.jit import compiled_from_inputs
from ..numerics.one_line import one_line
from ..numerics.symbolic import dense_function, evaluate, symbols
from .gains import Gains
from .interfaces import StaticLaw
from .lie_derivative import Flow, flow

if TYPE_CHECKING:
    from .rate import Rate


def law_expressions(flow: Flow, gains: SimpleNamespace, omega: ca.SX) -> dict[str, ca.SX]:
    """Return expressions of the fields of Evaluation, s_m and port_l: link stage, motor stage, storage.

    M_l, C_l and D_l are at the measured state, P_l and the spring at the virtual one. With v_lr = M_l^-1 p_lr and
    v_mr = M_m^-1 p_mr, the first two terms of eq. (33) are
    dp_lr + E_l v_lr = M_l dv_lr + (dM_l + E_l) v_lr = M_l dv_lr + C_l v_lr.
    phi(zeta) = K zeta is the torque of the springs; where they harden (model.springs), q_md takes its inverse, and the
    coupling Pi_m^-1 S' s_l of (40), with s_l = M_l^-1 sigma_l, its secant S between q_mv - q_lv and q_md - q_lv, so
    that phi(q_mv - q_lv) = u_l + S qt_m.
    gains: the arrays of CheckedGains.arrays, symbols or constants.
    omega (n,) [N m]: external input. The load torque on the links (Flow.load) is subtracted from u_l.

    Integral action against a disturbance torque d on the links (Flow.load, at x_v = x only) has the storage
    V + integral' gain^-1 integral / 2. The uncompensated torque d - w - integral, with w the known part, enters dV/dt
    only through the port output port_l = dV/dp_l (n,) [rad/s]. The integral is driven by gain times this output
    (docs/robust.md), so that d/dt (V + integral' gain^-1 integral / 2) = -dissipation + port_l' (d - w) + s_m' omega
    holds exactly. port_l = s_l - (dq_md/dp_l)' Pi_m qt_m - (dv_mr/dp_l)' sigma_m is built stage by stage, as the tuning
    functions of adaptive backstepping are (Krstic, Kanellakopoulos, Kokotovic 1992). Each stage uses the integral's
    rate known so far; u_mi adds the part that was unknown at the stage of q_md. Without integral action the rates are
    None, u_mi is zero and port_l is not complete.
    """
    robot, action = flow.robot, flow.integrated  # integral action, or None
    D_l, M_m, D_m = robot.D_l, robot.M_m, robot.D_m
    q_lv, q_mv, dq_lv, dq_mv = flow.virtual.q_l, flow.virtual.q_m, flow.virtual.dq_l, flow.virtual.dq_m
    q_ld, dq_ld = flow.jets[:, 0], flow.jets[:, 1]

    q_tilde_l = q_lv - q_ld  # (30)
    phi_l = gains.Lambda_l @ q_tilde_l + gains.Gamma_l @ q_tilde_l**3
    v_lr = dq_ld - phi_l  # (31)
    s_l = dq_lv - v_lr  # (30)
    sigma_l = flow.M_l @ s_l
    (dv_lr,) = flow.d(v_lr)
    u_lff = flow.inertial_torque(v_lr, dv_lr) + robot.links.grad_P_l(q_lv) + D_l @ v_lr  # (33)
    u_lfb = -gains.Pi_l @ q_tilde_l - gains.K_ld @ s_l
    u_l = u_lff + u_lfb - flow.external

    zeta, zeta_d = q_mv - q_lv, springs.deflection(robot, u_l)
    q_md, S = q_lv + zeta_d, springs.secant(robot, zeta, zeta_d)
    q_tilde_m = q_mv - q_md  # (39)
    port_l = s_l if action is None else s_l - flow.momentum_vjp(q_md, gains.Pi_m @ q_tilde_m)
    (dq_md,) = flow.d(q_md, integral=None if action is None else action.gain @ port_l)
    phi_m = gains.Lambda_m @ q_tilde_m + gains.Gamma_m @ q_tilde_m**3
    v_mr = dq_md - phi_m - gains.Pi_m_inverse @ S.T @ s_l  # (40)
    s_m = dq_mv - v_mr  # (39)
    sigma_m = M_m @ s_m
    port_l = port_l if action is None else port_l - flow.momentum_vjp(v_mr, sigma_m)
    (dv_mr,) = flow.d(v_mr, integral=None if action is None else action.gain @ port_l)
    u_mff = M_m @ dv_mr + springs.torque(robot, zeta) + D_m @ v_mr  # (42)
    u_mfb = -gains.Pi_m @ q_tilde_m - gains.K_md @ s_m + omega
    u_mi = ca.SX(robot.n, 1)
    if action is not None:  # completes dq_md: (dv_mr/dp_l) gain phi'^-1 Pi_m qt_m
        compliance = springs.compliance(robot, zeta_d)
        u_mi = M_m @ flow.momentum_jvp(v_mr, action.gain @ (compliance @ gains.Pi_m @ q_tilde_m))
    u = np.linalg.inv(robot.B_m) @ (u_mff + u_mfb + u_mi)

    V_l = (ca.dot(q_tilde_l, gains.Pi_l @ q_tilde_l) + ca.dot(s_l, sigma_l)) / 2  # (46), integrated
    V_m = (ca.dot(q_tilde_m, gains.Pi_m @ q_tilde_m) + ca.dot(s_m, sigma_m)) / 2  # (48), integrated
    dissipation_l = ca.dot(q_tilde_l, gains.Pi_l @ phi_l) + ca.dot(s_l, (D_l + gains.K_ld) @ s_l)
    dissipation_m = ca.dot(q_tilde_m, gains.Pi_m @ phi_m) + ca.dot(s_m, (D_m + gains.K_md) @ s_m)
    dissipation = dissipation_l + dissipation_m  # -dV/dt for omega = 0
    return {
        "u": u,
        "u_l": u_l,
        "q_md": q_md,
        "q_tilde_l": q_tilde_l,
        "sigma_l": sigma_l,
        "q_tilde_m": q_tilde_m,
        "sigma_m": sigma_m,
        "s_m": s_m,
        "port_l": port_l,
        "V": V_l + V_m,  # (43), integrated
        "dissipation": dissipation,
        "dV": -dissipation + ca.dot(s_m, omega),
    }


@dataclass(frozen=True)
class Evaluation:
    """The law and its certificate at one instant; dV = -dissipation + s_m' omega holds exactly.

    u, u_l (n,) [N m], q_md, q_tilde_l, q_tilde_m (n,) [rad], sigma_l, sigma_m (n,) [N m s],
    V [J], dissipation and dV [W].
    """

    u: Array
    u_l: Array
    q_md: Array
    q_tilde_l: Array
    sigma_l: Array
    q_tilde_m: Array
    sigma_m: Array
    V: float
    dissipation: float
    dV: float

    __repr__ = one_line


class TrackingLaw(StaticLaw):
    """The v-dPBC tracking law of a robot, as pure functions of (x_v, x, jets, omega).

    Its equations are in law_expressions.
    The controller applies u(x, x, t); analysis uses x_v != x. x_v and x are states (4n,) with momenta,
    jets (5, n) holds q_ld .. d4q_ld, omega (n,) [N m] is the external input of eq. (42).
    compile: compile to machine code if a C compiler is available (numerics.jit); results agree to rounding.
    Raises GainsError (see Gains.checked) on construction and StateError for wrong shapes. Efforts are neither
    saturated nor checked for finite values; that is the caller's duty.
    """

    def __init__(self, robot: Robot, gains: Gains, compile: bool = False) -> None:
        check_robot(robot)
        instance("gains", gains, Gains, GainsError, "gains, e.g. fjr.PAPER_GAINS")
        super().__init__(robot, gains.checked(robot.n), compile)

    def effort(self, x_v: ArrayLike, x: ArrayLike, jets: ArrayLike, omega: ArrayLike = 0.0) -> Array:
        """Return the effort u (n,) [N m], eq. (42).

        A law of the user has effort(position, velocity, jets) instead: it knows no virtual state (PythonLaw).
        """
        return evaluate(self._effort, x_v, x, jets, omega)[0]

    def evaluate(self, x_v: ArrayLike, x: ArrayLike, jets: ArrayLike, omega: ArrayLike = 0.0) -> Evaluation:
        """Return the effort, all errors, the storage V of eq. (43) (undifferentiated) and its exact rate."""
        results = evaluate(self._evaluation, x_v, x, jets, omega)
        u, u_l, q_md, q_tilde_l, sigma_l, q_tilde_m, sigma_m = results[:7]
        V, dissipation, dV = (float(result[0]) for result in results[7:])
        return Evaluation(u, u_l, q_md, q_tilde_l, sigma_l, q_tilde_m, sigma_m, V, dissipation, dV)

    def rate(self, configurations: ArrayLike | None = None) -> Rate:
        """Return the convergence rates [1/s], proven if the vertices of M_l are known, else sampled (k, n)."""
        from .rate import rate

        return rate(self.robot, self.gains, configurations)

    def proven_rate(self, domain: Domain | None = None, goal: float = GOAL, most_boxes: int = MOST_BOXES) -> Rate:
        """Return convergence rates [1/s] that are proven on a domain of positions, by default the joint range.

        The search ends if beta >= goal times a rate attained at a configuration, or after most_boxes; what is proven
        by then is returned. Raises RobotError for a robot whose bodies are unknown or with more than 8 revolute joints,
        MissingPackageError without the package of the proofs.
        """
        prover = importing.module("fjr_proofs.rate")
        rate: Rate = prover.proof_of_rate(self.robot, self.gains, domain, goal, most_boxes).rate
        return rate

    @cached_property
    def function(self) -> ca.Function:
        """The CasADi function (position (2n,), velocity (2n,), jets (n, 5), gains) -> u, V; compiled if requested."""
        return self.derived("measured_command", lambda: self.measured_expression)

    def measured_expressions(
        self, f: Flow | None = None, omega: ca.SX | None = None, slope: bool = False
    ) -> tuple[dict[str, ca.SX], dict[str, ca.SX]]:
        """Return the arguments of `function`, and expressions of the fields of Evaluation, s_m and port_l.

        f: flow at x_v = x, e.g. with a load. omega (n,) [N m]: input of eq. (42), zero by default.
        port_l = dV/dp_l (n,) [rad/s], defined if the flow has a load with integral action.
        slope: also return slope = dV/d(position, velocity) (4n,) at a constant reference.
        """
        f = flow(self.robot, diagonal=True) if f is None else f
        omega = ca.SX.zeros(self.robot.n) if omega is None else omega
        outputs = law_expressions(f, SimpleNamespace(**self.symbols.by_name), omega)
        if slope:
            outputs["slope"] = f.gradient(outputs["V"])
        return self.at_measured(f, outputs)

    def derived(self, name: str, build: Callable[[], ca.Function]) -> ca.Function:
        """Return build(), a function of the robot and the gain pattern; if the law is compiled, from the code cache."""
        if not self.compiles:
            return build()
        return compiled_from_inputs(name, self.robot.fingerprint(), self.symbols.pattern, build)

    @property
    def hold_damping(self) -> Array:
        """Injected motor damping K_md (n, n) [N m s/rad]."""
        return self.gains.K_md

    @cached_property
    def _effort(self) -> ca.Function:
        return self._function("effort", {"u"})

    @cached_property
    def _evaluation(self) -> ca.Function:
        return self._function("evaluate", {f.name for f in fields(Evaluation)})

    def _function(self, name: str, names: Set[str]) -> ca.Function:
        """Build (x_v, x, jets, omega) -> the outputs named; compiled if requested."""
        s, f = symbols(x_v=4 * self.robot.n, x=4 * self.robot.n, omega=self.robot.n), flow(self.robot)
        gains = SimpleNamespace(**{key: ca.sparsify(ca.DM(array)) for key, array in self.gains.arrays().items()})
        outputs = {key: value for key, value in law_expressions(f, gains, s["omega"]).items() if key in names}
        values = f.at(s["x_v"], s["x"], *outputs.values())
        inputs = {"x_v": s["x_v"], "x": s["x"], "jets": f.jets, "omega": s["omega"]}
        return self.ready(dense_function(name, inputs, dict(zip(outputs, values, strict=True)), cse=True))
