# SPDX-License-Identifier: Apache-2.0
"""Simulated robot: state, exact time and held effort, advanced in fixed inner steps; without ROS."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from fjr_core import ParameterError, Plant, Robot, StateError
from fjr_core.config import nonidealities
from fjr_core.numerics.casadi_function import bind, dense_function, not_converged
from fjr_core.numerics.checks import Array
from fjr_core.simulation.nonideal_parameters import Nonidealities, SensorErrors, friction_rate
from fjr_core.simulation.nonideal_plant import NonidealPlant

from .channel import Transport
from .sensors import Sensors


class Stepper:
    """Step function (state, held inputs.., dt) -> next state, bound to two buffers used in turn; not thread-safe."""

    def __init__(self, function: ca.Function, dt: float) -> None:
        """Bind the function; dt: length of a step [s]."""
        state, *held, _ = (np.zeros(function.numel_in(i)) for i in range(function.n_in()))
        self._function, self._held = function, held
        self._buffers = state, state.copy()
        length = np.array(dt)
        there = bind(function, (self._buffers[0], *held, length), self._buffers[1:])
        back = bind(function, (self._buffers[1], *held, length), self._buffers[:1])
        self._steps = there, back

    def after(self, steps: int, state: Array, *held: Array) -> Array:
        """Return the state after `steps` steps as a new array; raises StateError if a step does not converge."""
        np.copyto(self._buffers[0], state)
        for own, given in zip(self._held, held, strict=True):
            np.copyto(own, given)
        try:
            for k in range(steps):
                self._steps[k & 1]()
        except RuntimeError:
            raise not_converged(self._function) from None
        return self._buffers[steps & 1].copy()


class Velocities:
    """Velocities (dq_l, dq_m) (2n,) of states x (4n,) of a robot, bound to buffers; not thread-safe."""

    def __init__(self, robot: Robot) -> None:
        x = ca.SX.sym("x", 4 * robot.n)
        function = dense_function("velocities", {"x": x}, {"dq": ca.vertcat(*robot.velocity_expressions(x))})
        self._x, self._dq = np.zeros(4 * robot.n), np.zeros(2 * robot.n)
        self._evaluate = bind(function, (self._x,), (self._dq,))

    def of(self, x: Array) -> Array:
        """Return the velocities as a new array."""
        np.copyto(self._x, x)
        self._evaluate()
        return self._dq.copy()


STIFFEST_FRICTION = 2.0
"""Largest product of friction rate and inner step; Runge-Kutta of order 4 is stable up to 2.78."""


class SimulatedRobot:
    """Plant with a state, an exact integer time [ns] and an effort that is held between commands.

    u (n,) [N m]: command, external (n,) [N m]: torques on the links; both are set by the caller and held. x (4n,):
    state, with the momenta of a payload in p_l. Without non-idealities the motion equals that of plant.step to the last
    bit.
    """

    def __init__(
        self,
        plant: Plant,
        x0: Array,
        inner_step: int,
        imperfections: Nonidealities | None = None,
        sensor_errors: SensorErrors | None = None,
        seed: int = 0,
    ) -> None:
        """Start at the state x0 (4n,) of the robot without payload; inner_step: integrator step [ns].

        seed: of the sensor noise. Raises ParameterError for invalid non-idealities.
        """
        self._plant, self._n = plant, plant.robot.n
        self._imperfect = NonidealPlant(plant)
        self._x0 = x0
        self._inner_step = inner_step
        self._velocities = Velocities(plant.robot)
        self._sensors = Sensors(sensor_errors or SensorErrors(self._n), seed)
        self._use(imperfections or Nonidealities(self._n))
        self.reset()

    def reset(self) -> None:
        """Return to the initial positions and velocities at time 0, without effort, and restart the sensor noise."""
        self.time = 0
        self.u: Array = np.zeros(self._n)
        self.external = np.zeros(self._n)
        self._output: Array = np.zeros(self._n)  # of the actuators, behind the lag
        self.x = self._x0.copy()
        if np.any(self._imperfections.payload_mass):
            self.x = self._with_velocity(np.concatenate(self._plant.robot.velocities(self._x0)))
        self._sensors.reset()

    def warm_up(self) -> None:
        """Build all functions, so that the first step is as fast as the later ones."""
        nothing = np.zeros(self._n)
        self._step.after(1, self._x0, nothing)
        self._imperfect_step.after(1, np.concatenate([self._x0, nothing]), nothing, nothing, self._parameters)
        self._imperfect.applied(nothing, nothing, self._parameters)
        self._with_velocity(self._imperfect.measure(self._x0, self._parameters)[0])
        self.measure()
        self._sensors.reset()

    def change(self, imperfections: Nonidealities, sensor_errors: SensorErrors | None = None) -> None:
        """Use other non-idealities from now on; sensor_errors: None keeps the present ones.

        Positions and velocities are continuous; a payload is attached and released at the velocity of the end-effector.
        Raises ParameterError for invalid non-idealities, without any change.
        """
        velocity, output, before = self._ideal()[1], self._applied(), self._imperfections
        self._use(imperfections)
        self._output = output
        if not _same_load(before, imperfections):
            self.x = self._with_velocity(velocity)
        if sensor_errors is not None:
            self._sensors.change(sensor_errors)

    def advance_to(self, time: int) -> None:
        """Integrate in whole inner steps up to, and never past, `time` [ns].

        Raises StateError on divergence and UserCodeError for a failure of a plant in Python.
        """
        steps = max((time - self.time) // self._inner_step, 0)
        if self._perfect and not self._loaded:
            self.x = self._step.after(steps, self.x, self.u)
        else:
            state = np.concatenate([self.x, self._applied() if self._perfect else self._output])
            state = self._imperfect_step.after(steps, state, self.u, self.external, self._parameters)
            self.x, self._output = np.split(state, [4 * self._n])
        self._plant.raise_failure()
        self.time += steps * self._inner_step
        if not self.x.dot(self.x) < np.inf and not np.isfinite(self.x).all():  # the squares may overflow
            raise StateError(
                f"the state of the robot is not finite after {self.time * 1e-9:.3f} s: the motion diverged"
            )

    def measure(self) -> tuple[Array, Array, Array]:
        """Measure positions (q_l, q_m) [rad], velocities [rad/s] and (spring, applied) torques [N m], (2n,) each.

        Velocities are (0,) if the sensors do not measure them. Repeated calls at the same time return the same values.
        """
        position, velocity, spring = self._ideal()
        if not self._sensors.perfect:
            position, velocity = self._sensors.measured(self.time, position, velocity)
        return position, velocity, np.concatenate([spring, self._plant.robot.B_m.dot(self._applied())])

    @property
    def external(self) -> Array:
        """Torques on the links (n,) [N m]; assign a new array to change them."""
        return self._external

    @external.setter
    def external(self, torque: Array) -> None:
        self._external, self._loaded = torque, bool(torque.any())

    @cached_property
    def _step(self) -> Stepper:
        return Stepper(self._plant.step_function, self._inner_step * 1e-9)

    @cached_property
    def _imperfect_step(self) -> Stepper:
        return Stepper(self._imperfect.step_function, self._inner_step * 1e-9)

    def _use(self, imperfections: Nonidealities) -> None:
        self._imperfect.check(imperfections)
        self._check_friction(imperfections)
        self._imperfections, self._perfect = imperfections, imperfections.off
        self._parameters = imperfections.vector

    def _check_friction(self, imperfections: Nonidealities) -> None:
        robot, dt = self._plant.robot, self._inner_step * 1e-9
        rate = friction_rate(imperfections, robot.M_l(self._x0[: self._n]), robot.M_m)
        if self._plant.integrator == "rk4" and rate * dt > STIFFEST_FRICTION:
            raise ParameterError(
                f"friction damps with {rate:.4g} 1/s about rest; expected at most {STIFFEST_FRICTION / dt:.4g} 1/s for "
                "inner steps of this length: raise imperfections.friction_smoothing_velocity or inner_steps"
            )

    def _ideal(self) -> tuple[Array, Array, Array]:
        """Return exact positions, velocities (2n,) and spring torques (n,)."""
        n, robot = self._n, self._plant.robot
        position = self.x[: 2 * n]
        if self._perfect:
            return position, self._velocities.of(self.x), robot.K.dot(position[n:] - position[:n])
        return position, *self._imperfect.measure(self.x, self._parameters)

    def _applied(self) -> Array:
        """Return the present actuator outputs (n,) [N m]."""
        return self.u if self._perfect else self._imperfect.applied(self._output, self.u, self._parameters)

    def _with_velocity(self, velocity: Array) -> Array:
        """Return the state (4n,) at the present position with these velocities (2n,), including the payload."""
        return self._imperfect.state(self.x[: 2 * self._n], velocity, self._parameters)


def _same_load(one: Nonidealities, other: Nonidealities) -> bool:
    if not (np.any(one.payload_mass) or np.any(other.payload_mass)):
        return True
    same = (np.array_equal(getattr(one, name), getattr(other, name)) for name in ("payload_mass", "payload_position"))
    return all(same)


def simulated(values: Mapping[str, Any], plant: Plant, x0: Array) -> tuple[SimulatedRobot, Transport]:
    """Return robot and message channels for the checked values of the plant's parameters; raises ParameterError."""
    inner_step = round(1e9 / values["publish_rate"] / values["inner_steps"])  # ns
    seed, robot = nonidealities.seed(values), plant.robot
    motion, sensors = nonidealities.imperfections(values, robot), nonidealities.sensor_errors(values, robot.n)
    transport = Transport(inner_step * values["inner_steps"], inner_step, seed)
    transport.change(*nonidealities.channel_errors(values), nonidealities.period_jitter(values))
    return SimulatedRobot(plant, x0, inner_step, motion, sensors, seed), transport
