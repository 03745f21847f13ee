# SPDX-License-Identifier: Apache-2.0
"""Robot with friction, cubic springs, hysteresis, torque ripple, saturation and lag, payload, external torques.

    dq_l = (M_l + m J'J)^-1 p_l                      dq_m = M_m^-1 p_m
    dp_l = -dH/dq_l - D_l dq_l - F_l(dq_l) + h + tau
    dp_m = -dH/dq_m - D_m dq_m - F_m(dq_m) - h + r(q_m) + B_m a
    H    = eq. (36) with the payload + sum cubic zeta^4 / 4
    T da/dt = sat(u) - a                             solved exactly, also in the middle of a step
    h = hysteresis cut((zeta - s) / slip)            cut to -1 .. 1; s is held in a step, then |zeta - s| <= slip

All imperfections are arguments of one function, so that they can change while the robot moves.
"""

from __future__ import annotations

from functools import cached_property
from types import SimpleNamespace

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import ParameterError
from ..model import springs
from ..model.port_hamiltonian import Plant, derivative_expression
from ..model.rigid_arm import PayloadArm
from ..model.robot import Elastic, SymbolicRobot
from ..numerics.checks import Array
from ..numerics.integrators import step_expression
from ..numerics.symbolic import PackedVector, dense_function, evaluate, sparse, symbols
from .imperfections import NAMES, SIZES, Imperfections

SHORTEST_LAG = 1e-12  # s


class NonidealPlant:
    """Plant (36) with imperfections as parameters, as pure functions that are built once.

    The state is (x, a, s) (6n,): x of eq. (36) with the momenta of the payload in p_l, the actuator outputs a (n,) and
    the sliders s (n,) [rad] of the Maxwell elements, the deflections at which they carry no torque. A payload is
    ignored for links without an end-effector frame; `check` refuses it.
    """

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.robot = plant.robot
        self.layout = layout(plant.robot.n)

    def check(self, imperfections: Imperfections) -> None:
        """Raise ParameterError for imperfections that do not fit this robot."""
        if imperfections.n != self.robot.n:
            raise ParameterError(f"imperfections have {imperfections.n} joints; expected {self.robot.n}")
        if self.robot.links.end_effector is None and np.any(imperfections.payload_mass):
            raise ParameterError("payload_mass is not 0 for links without an end-effector frame; expected 0")
        for name in ("payload_mass", "cubic") if self.plant.in_python else ():
            if np.any(getattr(imperfections, name)):
                raise ParameterError(f"{name} is not 0 for a plant in Python; expected 0: it is part of that plant")

    def step(self, state: ArrayLike, u: ArrayLike, external: ArrayLike, parameters: ArrayLike, dt: float) -> Array:
        """Return the state (6n,) after dt [s] under the command u (n,) and external torques (n,) [N m] on the links."""
        return evaluate(self.step_function, state, u, external, parameters, dt)[0]

    def applied(self, a: ArrayLike, u: ArrayLike, parameters: ArrayLike) -> Array:
        """Return the present actuator outputs (n,) for the state a (n,) of the lag and the command u (n,)."""
        return evaluate(self._actuators, a, u, parameters, 0.0)[0]

    def measure(self, state: ArrayLike, parameters: ArrayLike) -> tuple[Array, Array]:
        """Return velocities (dq_l, dq_m) (2n,) [rad/s] and joint torques (n,) [N m], with h, at a state (6n,)."""
        velocity, spring = evaluate(self._measure, state, parameters)
        return velocity, spring

    def state(self, position: ArrayLike, velocity: ArrayLike, parameters: ArrayLike) -> Array:
        """Return x (4n,) from positions and velocities (2n,) of links and motors, with the momenta of the payload."""
        return evaluate(self._state, position, velocity, parameters)[0]

    @cached_property
    def dynamics(self) -> ca.Function:
        """Return the function (x, inputs) -> dx/dt (4n,).

        inputs: actuator outputs, external torques and sliders (n,) each, parameters.
        """
        n = self.robot.n
        s = symbols(ca.MX if self.plant.in_python else ca.SX, x=4 * n, inputs=3 * n + self.layout.size)
        x, inputs = s.values()
        applied, external, sliders, parameters = ca.vertsplit(inputs, [0, n, 2 * n, 3 * n, inputs.numel()])
        p = self.named(parameters)
        if self.plant.in_python:
            dx, dq = self.plant.dynamics(x, applied), self.robot.to_velocity(x)
        else:
            dx = derivative_expression(self.robot_of(p), x, applied)
            dq = dx[: 2 * n]
        dx += ca.vertcat(ca.DM.zeros(2 * n), *self._imperfect_torques(x[: 2 * n], dq, external, sliders, p))
        return dense_function("nonideal_dynamics", s, {"dx": dx}, cse=True)

    def _imperfect_torques(
        self, q: ca.SX, dq: ca.SX, external: ca.SX, sliders: ca.SX, p: SimpleNamespace
    ) -> tuple[ca.SX, ca.SX]:
        """Return external torques, friction, hysteresis and ripple on links and motors (n,) each [N m].

        q, dq (2n,): positions and velocities of links and motors.
        """
        (q_l, q_m), (dq_l, dq_m) = ca.vertsplit(q, self.robot.n), ca.vertsplit(dq, self.robot.n)
        h = hysteresis(q_m - q_l, sliders, p)
        load = ca.fabs(springs.torque(self.robot_of(p), q_m - q_l) + h)
        F_l = friction(dq_l, p.coulomb_l, p.static_l, p.stribeck_l, p.smoothing, p.load_l * load)
        F_m = friction(dq_m, p.coulomb_m, p.static_m, p.stribeck_m, p.smoothing, p.load_m * load)
        return external + h - F_l, p.ripple * ca.sin(p.ripple_periods * q_m + p.ripple_phase) - h - F_m

    @cached_property
    def joint_torques(self) -> ca.Function:
        """Return the function (q, dq, a, u, external, sliders, parameters, t) -> torques (2n,) for another simulator.

        q, dq (2n,): of links and motors; t [s]: since the actuator outputs a. They are all torques on links and motors
        beside inertia, weight, straight springs diag(K) and damping diag(D_l), diag(D_m).
        """
        n, robot = self.robot.n, self.robot
        s = symbols(q=2 * n, dq=2 * n, a=n, u=n, external=n, sliders=n, parameters=self.layout.size, t=1)
        p = self.named(s["parameters"])
        on_l, on_m = self._imperfect_torques(s["q"], s["dq"], s["external"], s["sliders"], p)
        zeta = s["q"][n:] - s["q"][:n]
        bend = springs.torque(self.robot_of(p), zeta) - ca.DM(np.diag(robot.K)) * zeta
        D_l, D_m = (sparse(D - np.diag(np.diag(D))) for D in (robot.D_l, robot.D_m))
        on_l += bend - D_l @ s["dq"][:n]
        on_m += sparse(robot.B_m) @ self._actuators(s["a"], s["u"], s["parameters"], s["t"]) - bend - D_m @ s["dq"][n:]
        return self.plant.ready(dense_function("joint_torques", s, {"torques": ca.vertcat(on_l, on_m)}, cse=True))

    @cached_property
    def memory_step(self) -> ca.Function:
        """Return the function (q, a, u, sliders, parameters, dt) -> a, sliders after a step that ended at q (2n,)."""
        n = self.robot.n
        s = symbols(q=2 * n, a=n, u=n, sliders=n, parameters=self.layout.size, dt=1)
        a = self._actuators(s["a"], s["u"], s["parameters"], s["dt"])
        sliders = dragged(s["sliders"], s["q"][n:] - s["q"][:n], self.named(s["parameters"]).slip)
        return self.plant.ready(dense_function("memory_step", s, {"applied": a, "dragged": sliders}))

    @cached_property
    def step_function(self) -> ca.Function:
        """Return the function (state, u, external, parameters, dt) -> next state; machine code as the plant's step."""
        return self.plant.ready(self._step_function(as_c=False))

    @cached_property
    def functions_as_c(self) -> dict[str, ca.Function]:
        """Return functions from which C can be generated, by name.

        step: as step_function. measure: (state, parameters) -> velocities, joint torques. applied: (a, u, parameters,
        t) -> torques of the actuators after t [s], on the motors. state: (position, velocity, parameters) -> x.
        """
        a, u, p, t = self._actuators.sx_in()
        applied = {"a": a, "u": u, "parameters": p, "t": t}, {"torque": self.robot.B_m @ self._actuators(a, u, p, t)}
        return {
            "step": self._step_function(as_c=True),
            "measure": self._measure,
            "applied": dense_function("applied", *applied),
            "state": self._state,
        }

    def _step_function(self, as_c: bool) -> ca.Function:
        n = self.robot.n
        s = symbols(ca.MX, state=6 * n, u=n, external=n, parameters=self.layout.size, dt=1)
        state, u, external, parameters, dt = s.values()
        x, a, sliders = ca.vertsplit(state, [0, 4 * n, 5 * n, 6 * n])
        applied = [self._actuators(a, u, parameters, t) for t in (0, dt / 2, dt)]
        start, middle, end = (ca.vertcat(b, external, sliders, parameters) for b in applied)
        x_next = step_expression(self.plant.integrator, self.dynamics, x, (start, middle, end), dt, as_c)
        sliders_next = dragged(sliders, x_next[n : 2 * n] - x_next[:n], self.named(parameters).slip)
        return dense_function("nonideal_step", s, {"next": ca.vertcat(x_next, applied[-1], sliders_next)})

    @cached_property
    def output_function(self) -> ca.Function:
        """Return the function (state, u, parameters) -> outputs as Plant.output_function; machine code as the step."""
        n = self.robot.n
        s, p = self._symbols(state=6 * n, u=n)
        velocities, torques = self._measured(s["state"], p)
        applied = sparse(self.robot.B_m) @ self._actuators(s["state"][4 * n : 5 * n], s["u"], s["parameters"], 0)
        outputs = {"q": s["state"][: 2 * n], "dq": velocities, "torques": ca.vertcat(torques, applied)}
        return self.plant.ready(dense_function("nonideal_outputs", s, outputs))

    def _measured(self, state: ca.SX, p: SimpleNamespace) -> tuple[ca.SX, ca.SX]:
        """Return velocities (2n,) and joint torques (n,) at a state (6n,) as expressions."""
        n = self.robot.n
        zeta, sliders = state[n : 2 * n] - state[:n], state[5 * n :]
        robot = self.robot_of(p)
        velocities = ca.vertcat(*robot.velocity_expressions(state[: 4 * n]))
        return velocities, springs.torque(robot, zeta) + hysteresis(zeta, sliders, p)

    def named(self, parameters: ca.SX) -> SimpleNamespace:
        """Return the imperfections by name."""
        return self.layout.named(parameters)

    def robot_of(self, p: SimpleNamespace) -> Elastic:
        """Return the robot with the payload and the cubic stiffness of the parameters p."""
        links, tip = self.robot.links, self.robot.links.end_effector
        loaded = links if tip is None else PayloadArm(links, tip, p.payload_mass, p.payload_position)
        return SymbolicRobot(self.robot, links=loaded, added=p.cubic)

    @cached_property
    def _actuators(self) -> ca.Function:
        """Build (a, u, parameters, t) -> actuator outputs after t [s]: the saturated command behind the lag."""
        n = self.robot.n
        s = symbols(a=n, u=n, parameters=self.layout.size, t=1)
        a, u, p, t = s["a"], s["u"], self.named(s["parameters"]), s["t"]
        saturated = ca.fmin(ca.fmax(u, -p.effort_limit), p.effort_limit)
        lagged = saturated + (a - saturated) * ca.exp(-t / ca.fmax(p.lag, SHORTEST_LAG))
        return dense_function("actuators", s, {"applied": ca.if_else(p.lag > 0, lagged, saturated)})

    def _symbols(self, **rows: int) -> tuple[dict[str, ca.SX], SimpleNamespace]:
        """Return symbols with these numbers of rows and `parameters`, and the entries of `parameters`, each by name."""
        s = symbols(ca.SX, **rows, parameters=self.layout.size)
        return s, self.named(s["parameters"])

    @cached_property
    def _measure(self) -> ca.Function:
        s, p = self._symbols(state=6 * self.robot.n)
        velocities, torques = self._measured(s["state"], p)
        return dense_function("measure", s, {"velocities": velocities, "springs": torques})

    @cached_property
    def _state(self) -> ca.Function:
        s, p = self._symbols(position=2 * self.robot.n, velocity=2 * self.robot.n)
        x = self.robot_of(p).state_expression(s["position"], s["velocity"])
        return dense_function("nonideal_state", s, {"x": x})


def friction(
    v: ca.SX, coulomb: ca.SX, static: ca.SX, stribeck: ca.SX, smoothing: ca.SX, of_load: ca.SX | float = 0.0
) -> ca.SX:
    """Return the friction torque (n,) at the velocity v (n,), without the viscous damping: v' F >= 0.

    of_load (n,): the part of the level that is due to the load, as in gears.

    B. Armstrong-Helouvry, P. Dupont, C. Canudas de Wit, Automatica 30(7), 1994, with tanh(v / smoothing)
    in place of sign(v) as in S. Andersson, A. Soderberg, S. Bjorklund, Tribology International 40(4), 2007.
    """
    level = coulomb + ca.fmax(static - coulomb, 0) * ca.exp(-((v / stribeck) ** 2)) + of_load
    return level * ca.tanh(v / smoothing)


def hysteresis(zeta: ca.SX, sliders: ca.SX, p: SimpleNamespace) -> ca.SX:
    """Return the torques h (n,) [N m] of the Maxwell elements at deflections zeta of springs (n,) [rad].

    A spring of stiffness hysteresis / slip drags a slider that gives way at the torque `hysteresis` (F. Al-Bender, V.
    Lampaert, J. Swevers, IEEE Transactions on Automatic Control 50(11), 2005). The work over a closed cycle is that of
    the slider, the integral of h ds >= 0: between -A and A >= slip it is 4 hysteresis (A - slip), and the two branches
    are 2 hysteresis apart.
    """
    return p.hysteresis * ca.fmin(ca.fmax((zeta - sliders) / p.slip, -1), 1)


def dragged(sliders: ca.SX, zeta: ca.SX, slip: ca.SX) -> ca.SX:
    """Return the sliders (n,) [rad], dragged along where a deflection zeta (n,) is farther away than `slip` (n,)."""
    return ca.fmin(ca.fmax(sliders, zeta - slip), zeta + slip)


def layout(n: int) -> PackedVector:
    """Return the parts of Imperfections.vector for n joints."""
    return PackedVector({name: SIZES.get(name, n) for name in NAMES})
