# SPDX-License-Identifier: Apache-2.0
"""A robot in motion: state, exact time and held effort, advanced in fixed inner steps; without ROS."""

from __future__ import annotations

from functools import cached_property

import casadi as ca
import numpy as np

from fjr_core import ParameterError, Plant, Robot, StateError
from fjr_core.numerics.casadi_function import bind, dense_function, not_converged
from fjr_core.numerics.checks import Array
from fjr_core.simulation.nonideal_parameters import Imperfections, SensorErrors, friction_rate
from fjr_core.simulation.nonideal_plant import ImperfectPlant

from .sensors import Sensors


class Stepper:
    """A step function (state, held inputs.., dt) -> next state, from one buffer into the other and back."""

    def __init__(self, function: ca.Function, dt: float) -> None:
        """dt: length of a step [s]. Not for two threads at once."""
        state, *held, _ = (np.zeros(function.numel_in(i)) for i in range(function.n_in()))
        self._function, self._held = function, held
        self._buffers = state, state.copy()
        length = np.array(dt)
        there = bind(function, (self._buffers[0], *held, length), self._buffers[1:])
        back = bind(function, (self._buffers[1], *held, length), self._buffers[:1])
        self._turns = there, back

    def after(self, steps: int, state: Array, *held: Array) -> Array:
        """The state that many steps later, a new array; raises StateError where a step does not converge."""
        np.copyto(self._buffers[0], state)
        for own, given in zip(self._held, held, strict=True):
            np.copyto(own, given)
        try:
            for k in range(steps):
                self._turns[k & 1]()
        except RuntimeError:
            raise not_converged(self._function) from None
        return self._buffers[steps & 1].copy()


class Velocities:
    """Velocities (dq_l, dq_m) (2n,) of states x (4n,) of a robot; not for two threads at once."""

    def __init__(self, robot: Robot) -> None:
        x = ca.SX.sym("x", 4 * robot.n)
        function = dense_function("velocities", {"x": x}, {"dq": ca.vertcat(*robot.velocity_expressions(x))})
        self._x, self._dq = np.zeros(4 * robot.n), np.zeros(2 * robot.n)
        self._evaluate = bind(function, (self._x,), (self._dq,))

    def of(self, x: Array) -> Array:
        """The velocities, a new array."""
        np.copyto(self._x, x)
        self._evaluate()
        return self._dq.copy()


STIFFEST_FRICTION = 2.0
"""Largest product of friction's rate about rest and the inner step: Runge-Kutta is stable to 2.78, here with room."""


class SimulatedRobot:
    """A plant with a state, a time [ns, integer, exact] and an effort that is held between commands.

    u (n,) [N m]: the command, external (n,) [N m]: torques on the links; both are set from outside and held.
    x (4n,): the state; with a payload p_l holds its momenta too.
    Without imperfections the motion is that of plant.step, bit for bit.
    """

    def __init__(
        self,
        plant: Plant,
        x0: Array,
        inner_step: int,
        imperfections: Imperfections | None = None,
        sensor_errors: SensorErrors | None = None,
        seed: int = 0,
    ) -> None:
        """x0: initial state (4n,) of the robot without payload; inner_step: integrator step [ns].

        seed: of the sensors' noise. Raises ParameterError for imperfections that do not fit.
        """
        self._plant, self._n = plant, plant.robot.n
        self._imperfect = ImperfectPlant(plant)
        self._x0 = x0
        self._inner_step = inner_step
        self._velocities = Velocities(plant.robot)
        self._sensors = Sensors(sensor_errors or SensorErrors(self._n), seed)
        self._use(imperfections or Imperfections(self._n))
        self.reset()

    def reset(self) -> None:
        """Back to the initial positions and velocities and time 0, no effort, the noise from its start."""
        self.time = 0
        self.u: Array = np.zeros(self._n)
        self.external = np.zeros(self._n)
        self._output: Array = np.zeros(self._n)  # of the actuators
        self.x = self._x0.copy()
        if np.any(self._imperfections.payload_mass):
            self.x = self._moving(np.concatenate(self._plant.robot.velocities(self._x0)))
        self._sensors.reset()

    def warm_up(self) -> None:
        """Build everything that is built once, so that the first step is as fast as any other, whatever is changed."""
        nothing = np.zeros(self._n)
        self._step.after(1, self._x0, nothing)
        self._imperfect_step.after(1, np.concatenate([self._x0, nothing]), nothing, nothing, self._parameters)
        self._imperfect.applied(nothing, nothing, self._parameters)
        self._moving(self._imperfect.measure(self._x0, self._parameters)[0])
        self.measure()
        self._sensors.reset()

    def change(self, imperfections: Imperfections, sensor_errors: SensorErrors | None = None) -> None:
        """Other imperfections from now on; sensor_errors: other ones, None leaves them as they are.

        Positions and velocities go on without a jump: a payload is taken and let go at the speed of the hand.
        Raises ParameterError and changes nothing for imperfections that do not fit.
        """
        velocity, output, before = self._ideal()[1], self._applied(), self._imperfections
        self._use(imperfections)
        self._output = output
        if not _same_load(before, imperfections):
            self.x = self._moving(velocity)
        if sensor_errors is not None:
            self._sensors.change(sensor_errors)

    def advance_to(self, time: int) -> None:
        """Integrate in whole inner steps up to, and never past, `time` [ns]; raises StateError on divergence."""
        steps = max((time - self.time) // self._inner_step, 0)
        if self._perfect and not self._pushed:
            self.x = self._step.after(steps, self.x, self.u)
        else:
            state = np.concatenate([self.x, self._applied() if self._perfect else self._output])
            state = self._imperfect_step.after(steps, state, self.u, self.external, self._parameters)
            self.x, self._output = np.split(state, [4 * self._n])
        self.time += steps * self._inner_step
        if not self.x.dot(self.x) < np.inf and not np.isfinite(self.x).all():  # the squares may overflow
            raise StateError(f"the robot's state is not finite after {self.time * 1e-9:.3f} s: the motion diverged")

    def measure(self) -> tuple[Array, Array, Array]:
        """Positions (q_l, q_m) [rad], velocities [rad/s] and efforts (spring torque, applied torque) [N m], (2n,) each.

        Velocities are (0,) where the sensors have none. The same at one time, however often it is asked for.
        """
        position, velocity, spring = self._ideal()
        if not self._sensors.perfect:
            position, velocity = self._sensors.measured(self.time, position, velocity)
        return position, velocity, np.concatenate([spring, self._plant.robot.B_m.dot(self._applied())])

    @property
    def external(self) -> Array:
        """Torques on the links (n,) [N m]; to be replaced as a whole."""
        return self._external

    @external.setter
    def external(self, torque: Array) -> None:
        self._external, self._pushed = torque, bool(torque.any())

    @cached_property
    def _step(self) -> Stepper:
        return Stepper(self._plant.step_function, self._inner_step * 1e-9)

    @cached_property
    def _imperfect_step(self) -> Stepper:
        return Stepper(self._imperfect.step_function, self._inner_step * 1e-9)

    def _use(self, imperfections: Imperfections) -> None:
        self._imperfect.check(imperfections)
        self._check_friction(imperfections)
        self._imperfections, self._perfect = imperfections, imperfections.off
        self._parameters = imperfections.vector

    def _check_friction(self, imperfections: Imperfections) -> None:
        robot, dt = self._plant.robot, self._inner_step * 1e-9
        rate = friction_rate(imperfections, robot.M_l(self._x0[: self._n]), robot.M_m)
        if self._plant.integrator == "rk4" and rate * dt > STIFFEST_FRICTION:
            raise ParameterError(
                f"friction damps with {rate:.4g} 1/s about rest; expected at most {STIFFEST_FRICTION / dt:.4g} 1/s for "
                "inner steps of this length: raise imperfections.friction_smoothing_velocity or inner_steps"
            )

    def _ideal(self) -> tuple[Array, Array, Array]:
        """Positions, velocities (2n,) and spring torques (n,) as they are."""
        n, robot = self._n, self._plant.robot
        position = self.x[: 2 * n]
        if self._perfect:
            return position, self._velocities.of(self.x), robot.K.dot(position[n:] - position[:n])
        return position, *self._imperfect.measure(self.x, self._parameters)

    def _applied(self) -> Array:
        """What the actuators give now (n,)."""
        return self.u if self._perfect else self._imperfect.applied(self._output, self.u, self._parameters)

    def _moving(self, velocity: Array) -> Array:
        """The state (4n,) here with these velocities (2n,), payload and all."""
        return self._imperfect.state(self.x[: 2 * self._n], velocity, self._parameters)


def _same_load(one: Imperfections, other: Imperfections) -> bool:
    if not (np.any(one.payload_mass) or np.any(other.payload_mass)):
        return True
    same = (np.array_equal(getattr(one, name), getattr(other, name)) for name in ("payload_mass", "payload_position"))
    return all(same)
