# SPDX-License-Identifier: Apache-2.0
"""Simulated robot without ROS: state, exact time, held effort, inner steps of fixed length, sensors; see robot.h."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fjr_core import FjrError, ParameterError, Plant, Robot, StateError
from fjr_core.config.plant import OWN, Obstacle, channel_errors, obstacle, period_jitter, random_seed, sensor_errors
from fjr_core.config.plant import imperfections as build_imperfections
from fjr_core.model.springs import hardening
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import CFunction, WorkSpace, machine_code
from fjr_core.numerics.symbolic import not_converged
from fjr_core.simulation.imperfections import (
    ChannelErrors,
    Imperfections,
    SensorErrors,
    friction_rate,
    largest_load,
    stuck_rate,
)
from fjr_core.simulation.nonideal_plant import NonidealPlant

from .channel import SENSORS, Random, Transport
from .native import plant_program

if TYPE_CHECKING:
    from .engine import Engine

_FILL = ctypes.CDLL(np.random._generator.__file__).random_standard_normal_fill  # as numpy.org shows for extensions

NO_VELOCITIES: Array = np.zeros(0)


class Sensors:
    """Sensors of n joints with errors, as struct fjr_sensors; repeated readings at the same time are equal.

    The noise at the k-th instant depends only on the seed and k. Each kind of error has its own random numbers, scaled
    by its deviation, independent of the other errors.
    """

    def __init__(self, errors: SensorErrors, seed: int = 0) -> None:
        program, self._random = plant_program(), Random(seed, SENSORS)
        self._step, self._deviation, self._draw = np.zeros(2 * errors.n), np.zeros(4 * errors.n), np.zeros(4 * errors.n)
        self._kept = [program.array(each) for each in (self._step, self._deviation, self._draw)]
        self.pointer = program.ffi.new("struct fjr_sensors*")
        self.pointer.step, self.pointer.deviation, self.pointer.draw = self._kept
        self.pointer.normal = program.ffi.cast("fjr_normal", ctypes.cast(_FILL, ctypes.c_void_p).value)
        self.change(errors)
        self.reset()

    def reset(self) -> None:
        """Restart the random sequence."""
        self.pointer.random = self._random.restart()
        self.pointer.instant = -1

    def change(self, errors: SensorErrors) -> None:
        """Use other errors from now on; the random sequence continues."""
        bits = np.concatenate([errors.bits_l, errors.bits_m])
        self._step[:] = np.where(bits == 0, 0.0, 2 * np.pi * 2.0**-bits)  # rad; 0 bits: no encoder
        self._deviation[:] = np.concatenate(
            [errors.position_l, errors.position_m, errors.velocity_l, errors.velocity_m]
        )
        self.pointer.perfect, self.pointer.velocities = errors.off, errors.velocities

    @property
    def velocities(self) -> bool:
        """True if velocities are measured."""
        return bool(self.pointer.velocities)


def _array_slice(name: str, part: Callable[[int], slice], doc: str) -> Any:
    """Return a property that copies part of an array of struct fjr_robot, whose place depends on n."""

    def values(robot: SimulatedRobot) -> Array:
        return robot._arrays[name][part(robot._n)]

    def put(robot: SimulatedRobot, given: Array) -> None:
        values(robot)[:] = given

    return property(lambda robot: values(robot).copy(), put, doc=doc)


STIFFEST_FRICTION = 2.0
"""Largest product of friction rate and inner step; Runge-Kutta of order 4 is stable up to 2.78."""
STIFFEST_SPRING = 2.7
"""Largest product of the frequency of springs with hysteresis and inner step; stable up to 8^(1/2)."""


class SimulatedRobot:
    """Plant with a state, an exact integer time [ns] and an effort that is held between commands.

    u (n,) [N m]: command, external (n,) [N m]: torques on the links; both are set by the caller and held. x (4n,):
    state, with the momenta of a payload in p_l. Without imperfections the motion equals that of plant.step to the last
    bit. pointer: the same as struct fjr_robot*.
    """

    x = _array_slice("state", lambda n: slice(4 * n), "State (4n,).")
    _actuator_torque = _array_slice(
        "state", lambda n: slice(4 * n, 5 * n), "Torques of the actuators behind their lag (n,) [N m]."
    )
    _sliders = _array_slice("state", lambda n: slice(5 * n, 6 * n), "Sliders of the Maxwell elements (n,) [rad].")
    u = _array_slice("u", slice, "Command (n,) [N m].")
    external = _array_slice("external", slice, "Torques on the links (n,) [N m].")
    contact = _array_slice("contact", lambda n: slice(n + 6), "Torques (n,) and wrench (6,) by an obstacle, robot.h.")

    def __init__(
        self,
        plant: Plant,
        x0: Array,
        inner_step: int,
        imperfections: Imperfections | None = None,
        sensor_errors: SensorErrors | None = None,
        seed: int = 0,
        engine: type[Engine] | None = None,
        joints: Sequence[str] = (),
        obstacle: Obstacle | None = None,
    ) -> None:
        """Start at the state x0 (4n,) of the robot without payload; inner_step: integrator step [ns].

        seed: of the sensor noise. engine: class of a simulator with these names of the joints, None for the
        plant's own integrator. obstacle: what the simulator lets it touch. Raises ParameterError for invalid
        imperfections, and an obstacle inside the arm.
        """
        self._program = plant_program()
        self._plant, self._n = plant, plant.robot.n
        self._imperfect = NonidealPlant(plant)
        self._x0 = x0
        self._inner_step = inner_step
        self._sensors = Sensors(sensor_errors or SensorErrors(self._n), seed)
        self._build(len(Imperfections(self._n).vector))
        self._engine = engine(self._imperfect, joints, inner_step, self._program.ffi, obstacle) if engine else None
        if self._engine:
            self.pointer.engine, self.pointer.engine_advance = self._engine.handle, self._engine.advance
        self._use(imperfections or Imperfections(self._n))
        self.reset()
        if obstacle:
            self.obstruct(obstacle.present)

    def _build(self, parameters: int) -> None:
        """Build struct fjr_robot; parameters: their number."""
        n, ffi = self._n, self._program.ffi
        sizes = {"state": 6 * n, "next": 6 * n, "u": n, "external": n, "parameters": parameters, "measured": 6 * n}
        self._arrays = {name: np.zeros(size) for name, size in (sizes | {"contact": n + 6}).items()}
        functions = {
            "step": self._plant.step_function,
            "nonideal_step": self._imperfect.step_function,
            "outputs": self._plant.output_function,
            "nonideal_outputs": self._imperfect.output_function,
        }
        self._functions = {name: CFunction(ffi, function) for name, function in functions.items()}
        self._space = WorkSpace(ffi, list(functions.values()))
        self._kept = {name: self._program.array(values) for name, values in self._arrays.items()}
        given = {
            "n": n,
            "inner_step": self._inner_step,
            "dt": self._inner_step * 1e-9,
            "sensors": self._sensors.pointer,
            **self._kept,
            **{name: function.pointer for name, function in self._functions.items()},
            **{name: getattr(self._space, name) for name in ("arg", "res", "iw", "w")},
        }
        self.pointer = ffi.new("struct fjr_robot*", given)

    def reset(self) -> None:
        """Return to the initial positions and velocities at time 0, without effort, and restart the sensor noise."""
        self.pointer.time = 0
        for name in ("u", "external", "state", "contact"):
            self._arrays[name][:] = 0.0
        self.x, self._sliders = self._x0, self._deflection(self._x0)
        if np.any(self._imperfections.payload_mass):
            self.x = self._with_velocity(np.concatenate(self._plant.robot.velocities(self._x0)))
        self._sensors.reset()
        if self._engine:
            self._engine.forget()

    def warm_up(self) -> None:
        """Evaluate all functions, so that the first step is as fast as the later ones, also without imperfections."""
        for perfect in (not self.pointer.perfect, bool(self.pointer.perfect)):
            self.pointer.perfect = perfect
            self.advance_to(self._inner_step)
            self.measure()
            self.reset()
        self._imperfect.applied(self.u, self.u, self._arrays["parameters"])
        self._with_velocity(self._velocity())

    def change(self, imperfections: Imperfections, sensor_errors: SensorErrors | None = None) -> None:
        """Use other imperfections from now on; sensor_errors: None keeps the present ones.

        Positions and velocities are continuous; a payload is attached and released at the velocity of the end-effector.
        Raises ParameterError for invalid imperfections, without any change.
        """
        velocity, before, torque = self._velocity(), self._imperfections, self.u
        if not self.pointer.perfect:
            torque = self._imperfect.applied(self._actuator_torque, self.u, self._arrays["parameters"])
        self._use(imperfections)
        self._actuator_torque = torque
        self._sliders = np.where(np.asarray(before.hysteresis) > 0, self._sliders, self._deflection(self.x))
        if not _same_load(before, imperfections):
            self.x = self._with_velocity(velocity)
        if sensor_errors is not None:
            self._sensors.change(sensor_errors)

    def obstruct(self, present: bool) -> None:
        """Put the obstacle to its place, or take it away; raise ParameterError if the arm is there."""
        assert self._engine is not None  # an obstacle is one of a simulator
        self._engine.obstruct(present, self.x[: 2 * self._n])

    def advance_to(self, time: int) -> None:
        """Integrate in whole inner steps up to, and never past, `time` [ns].

        Raises StateError on divergence and UserCodeError for a failure of a plant in Python.
        """
        self.check(self._program.lib.fjr_robot_advance(self.pointer, time))

    def measure(self) -> tuple[Array, Array, Array]:
        """Measure positions (q_l, q_m) [rad], velocities [rad/s] and (spring, applied) torques [N m], (2n,) each.

        Velocities are (0,) if the sensors do not measure them. Repeated calls at the same time return the same values.
        """
        self.check(self._program.lib.fjr_robot_measure(self.pointer))
        position, velocity, torque = self._arrays["measured"].copy().reshape(3, -1)
        return position, velocity if self._sensors.velocities else NO_VELOCITIES, torque

    def check(self, fault: int) -> None:
        """Raise the error of an enum fjr_fault of the robot."""
        if fault:
            raise self.error(fault)

    def error(self, fault: int) -> FjrError:
        """Return the error of an enum fjr_fault of the robot."""
        try:
            self._plant.raise_failure()
        except FjrError as error:
            return error
        if fault == self._program.lib.FJR_STEP_FAILED:
            return not_converged(self._plant.step_function)
        return StateError(f"the state of the robot is not finite after {self.time * 1e-9:.3f} s: the motion diverged")

    @property
    def time(self) -> int:
        """Robot time [ns]."""
        return int(self.pointer.time)

    @property
    def in_machine_code(self) -> bool:
        """True if no function needs Python."""
        own = all(machine_code(each.function) is not None for each in self._functions.values())
        return own and not (self._engine and self._engine.in_python)

    def _use(self, imperfections: Imperfections) -> None:
        """Check imperfections and use them from now on. Raises ParameterError, then nothing has changed."""
        self._imperfect.check(imperfections)
        self._check_step(imperfections)
        if self._engine:
            self._engine.use(imperfections)
        self._imperfections, self.pointer.perfect = imperfections, imperfections.off
        self._arrays["parameters"][:] = imperfections.vector

    def _deflection(self, x: Array) -> Array:
        """Return the deflections (n,) of the springs [rad] at x (4n,)."""
        return np.asarray(x[self._n : 2 * self._n] - x[: self._n])

    def _check_step(self, imperfections: Imperfections) -> None:
        """Raise ParameterError for friction or hysteresis too stiff for the explicit integrator."""
        if self._plant.integrator != "rk4":
            return
        robot, dt = self._plant.robot, self._inner_step * 1e-9
        M_l = robot.M_l(self._x0[: self._n])
        K = robot.K * hardening(robot, self._deflection(self._x0)[None])
        rate = stuck_rate(imperfections, K, M_l, robot.M_m)
        if rate * dt > STIFFEST_SPRING:
            raise ParameterError(
                f"springs with hysteresis oscillate at {rate:.4g} rad/s; expected at most {STIFFEST_SPRING / dt:.4g} "
                "rad/s for inner steps of this length: raise imperfections.hysteresis_deflection or inner_steps"
            )
        load = largest_load(robot, self._x0[: self._n], imperfections.effort_limit)
        rate = friction_rate(imperfections, M_l, robot.M_m, load)
        if rate * dt > STIFFEST_FRICTION:
            raise ParameterError(
                f"friction damps with {rate:.4g} 1/s about rest; expected at most {STIFFEST_FRICTION / dt:.4g} 1/s for "
                "inner steps of this length: raise imperfections.friction_smoothing_velocity or inner_steps"
            )

    def _velocity(self) -> Array:
        """Return the exact velocities (2n,)."""
        return self._imperfect.measure(self._arrays["state"], self._arrays["parameters"])[0]

    def _with_velocity(self, velocity: Array) -> Array:
        """Return the state (4n,) at the present position with these velocities (2n,), including the payload."""
        return self._imperfect.state(self.x[: 2 * self._n], velocity, self._arrays["parameters"])


def _same_load(one: Imperfections, other: Imperfections) -> bool:
    if not (np.any(one.payload_mass) or np.any(other.payload_mass)):
        return True
    same = (np.array_equal(getattr(one, name), getattr(other, name)) for name in ("payload_mass", "payload_position"))
    return all(same)


def errors_of(
    values: Mapping[str, Any], robot: Robot
) -> tuple[Imperfections, SensorErrors, tuple[ChannelErrors, ChannelErrors, float]]:
    """Return the errors of motion, sensors, and messages (of states, commands, sample times); raises ParameterError."""
    messages = (*channel_errors(values), period_jitter(values))
    return build_imperfections(values, robot.n), sensor_errors(values, robot.n), messages


def simulated(values: Mapping[str, Any], plant: Plant, x0: Array) -> tuple[SimulatedRobot, Transport]:
    """Return robot and message channels for the checked values of the plant's parameters; raises ParameterError."""
    inner_step = round(1e9 / values["publish_rate"] / values["inner_steps"])  # ns
    seed, (motion, sensors, messages) = random_seed(values), errors_of(values, plant.robot)
    transport = Transport(plant.robot.n, inner_step * values["inner_steps"], inner_step, seed)
    transport.change(*messages)
    simulator = {"joints": values["joints"], "obstacle": obstacle(values)}
    if values["engine"] != OWN:
        from .engine import engine_kind

        simulator["engine"] = engine_kind(values)
    return SimulatedRobot(plant, x0, inner_step, motion, sensors, seed, **simulator), transport
