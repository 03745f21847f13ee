# SPDX-License-Identifier: Apache-2.0
"""Simulate the closed loop without ROS, in continuous time or sampled with a zero-order hold, and draw a run."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ..errors import PIP, FjrError, StateError, TrajectoryError
from ..law.interfaces import SampledLaw, StaticLaw, check_law
from ..model.joints import Units, joined
from ..model.port_hamiltonian import Plant
from ..model.robot import Robot
from ..motions.reference import JETS, Reference, check_reference
from ..numerics import checks
from ..numerics.checks import Array
from ..numerics.integrators import INNER_STEP, rk4_expression
from ..numerics.one_line import brief, joints, span
from ..numerics.symbolic import NumericFunction, bind, dense_function, evaluate_rows, not_converged

if TYPE_CHECKING:
    from matplotlib.figure import Figure


CONTINUOUS_STEP = 1e-4  # s; output step of a continuous-time run
STEPS = 500  # of an integration in continuous time in one call of CasADi


def simulate(
    plant: Plant,
    law: SampledLaw,
    reference: Reference,
    x0: ArrayLike,
    duration: float,
    sample_period: float | None = None,
    inner_step: float | None = None,
    delay: float = 0.0,
) -> Trajectory:
    """Simulate u(x, x, t) on the plant from x0 (4n,) for `duration` seconds.

    sample_period [s]: the law is evaluated once per sample and held, with steps of plant.step of at most inner_step
    [s]; None: continuous time, the law is evaluated in each stage of a Runge-Kutta step of inner_step. The instants are
    multiples of the sample period (of inner_step in continuous time) up to the duration.
    delay [s]: the effort for the state at t acts from t + delay on, with zero effort before the first; Trajectory.u is
    the effort computed at t. Only for a sampled loop.
    law: one with a controller state (robust.law.RobustLaw) requires a sample_period; its reference is at t + law.lead.
    The robots of plant and law may differ (model mismatch). The law receives the positions and velocities of the
    plant, and V is its own; Trajectory.x is the state of the plant, with momenta by the plant's inertia.
    Raises StateError for wrong shapes or numbers, a law that is none, and if the state is no longer finite;
    TrajectoryError for a reference that is none, such as a function of time; UserCodeError for a failure of a law or
    plant in Python.
    """
    checks.instance("plant", plant, Plant, StateError, "a plant, e.g. fjr.Plant(robot)")
    check_law(law)
    try:
        x0 = checks.vector("x0", x0, 4 * plant.robot.n, StateError)
        check_joints(plant.robot, law.robot, reference)
        usual = CONTINUOUS_STEP if sample_period is None else INNER_STEP
        inner_step = checks.positive("inner_step", usual if inner_step is None else inner_step, StateError)
        delay = checks.positive("delay", delay, StateError, zero=True)
        if delay and sample_period is None:
            raise StateError(f"delay is {delay} s; expected a sample_period with it, or 0 in continuous time")
        period = inner_step if sample_period is None else checks.positive("sample_period", sample_period, StateError)
        duration = checks.positive("duration", duration, StateError)
        if duration < period:
            raise StateError(f"duration is {duration:g} s; expected at least one step of {period:g} s")
        t = np.asarray(period * np.arange(int(duration / period + 1e-9) + 1), dtype=float)
        if sample_period is not None:
            return _sampled(plant, law, reference, x0, t, period, inner_step, delay)
        if not isinstance(law, StaticLaw):
            kind = type(law).__name__
            raise StateError(f"law is a {kind} without a sample_period; expected a StaticLaw or a sample_period")
        return _continuous(plant, law, reference, x0, t, period)
    finally:
        plant.raise_failure()
        law.raise_failure()


def check_joints(plant: Robot, law: Robot, reference: Reference) -> None:
    """Raise StateError unless plant, law and reference have equally many joints."""
    check_reference(reference)
    n = plant.n, law.n, reference.n
    if len(set(n)) != 1:
        raise StateError(f"plant, law and reference have {n[0]}, {n[1]} and {n[2]} joints; expected equal")


def _sampled(
    plant: Plant,
    law: SampledLaw,
    reference: Reference,
    x0: Array,
    t: Array,
    period: float,
    inner_step: float,
    delay: float,
) -> Trajectory:
    """Simulate sample by sample."""
    n, run = plant.robot.n, _empty_trajectory(plant.robot, t, _jets(reference, t))
    x, u, V, none = x0.copy(), np.zeros(n), np.zeros(1), np.zeros(n)
    jets = _jets(reference, t + law.lead) if law.lead else run.jets
    evaluate_law = _bound_law(plant, law, x, u, V)
    segments = _segments(plant, x, period, delay, inner_step)
    for k in range(len(t)):
        if not np.isfinite(x).all():
            raise _diverged(t[k])
        evaluate_law(jets[k], t[k] - t[k - 1] if k else 0.0)
        run.x[k], run.u[k], run.V[k] = x, u, V[0]
        if k + 1 == len(t):
            break
        for age, advance in segments:
            advance(run.u[k - age] if k >= age else none)
    return run


def _segments(
    plant: Plant, x: Array, period: float, delay: float, inner_step: float
) -> list[tuple[int, Callable[[Array], None]]]:
    """Divide a sample where the effort changes, unless the delay is a whole number of samples.

    Return, for each segment, the age [samples] of the effort that acts, and the function that advances the array x.
    """
    whole, late = divmod(delay, period)
    found = []
    for age, length in ((int(whole) + 1, late), (int(whole), period - late)):
        if steps := int(np.ceil(length / inner_step - 1e-9)):
            found.append((age, _advancing(plant, x, length / steps, steps)))
    return found


def _advancing(plant: Plant, x: Array, dt: float, steps: int) -> Callable[[Array], None]:
    """Return the function that advances the array x (4n,) by `steps` steps of dt [s] under an effort (n,) [N m]."""
    effort, x_next = np.zeros(plant.robot.n), np.zeros_like(x)
    step = bind(plant.step_function, [x, effort, np.array([dt])], [x_next])

    def advance(u: Array) -> None:
        effort[...] = u
        try:
            for _ in range(steps):
                step()
                x[...] = x_next
        except RuntimeError:
            raise not_converged(plant.step_function) from None

    return advance


def _bound_law(plant: Plant, law: SampledLaw, x: Array, u: Array, V: Array) -> Callable[[Array, float], None]:
    """Return the evaluation of a law at jets (5, n), dt [s] after the last one, from x (4n,) into u (n,) and V (1,).

    The law sees the positions and velocities of the plant. u still holds the effort of the last sample, which was sent.
    """
    now, velocity, sent, age = np.zeros((JETS, len(u))), np.zeros(len(x) // 2), np.zeros_like(u), np.zeros(1)
    memory, gains = law.memory.copy(), np.ascontiguousarray(law.gain_values, dtype=float)
    after, see = np.zeros_like(memory), bind(plant.robot.to_velocity, [x], [velocity])
    kept, found = ([], []) if isinstance(law, StaticLaw) else ([memory, sent, age], [after])
    evaluate = bind(law.function, [x[: len(velocity)], velocity, now, gains, *kept], [u, V, *found])

    def evaluate_law(jets: Array, dt: float) -> None:
        now[...], sent[...], age[...] = jets, u, dt
        see()
        evaluate()
        memory[...] = after

    return evaluate_law


def _continuous(plant: Plant, law: StaticLaw, reference: Reference, x0: Array, t: Array, dt: float) -> Trajectory:
    step, run = _closed_loop_step(plant, law, dt), _empty_trajectory(plant.robot, t, _jets(reference, t))
    run.x[0] = x0
    stages = np.stack([run.jets[:-1], _jets(reference, t[:-1] + dt / 2), run.jets[1:]])
    most = 1 if plant.in_python or law.in_python else STEPS
    several = cache(lambda count: NumericFunction(step.mapaccum(count)))  # the last ones are fewer
    for k in range(0, len(t) - 1, most):
        now = stages[:, k : k + most]
        count = now.shape[1]
        (states,) = several(count)(run.x[k], *now.reshape(3, -1, plant.robot.n))
        found = run.x[k + 1 : k + 1 + count] = states.reshape(count, -1)
        if not np.isfinite(found).all():
            raise _diverged(t[k + 1 + int(np.argmin(np.isfinite(found).all(axis=1)))])
    (velocity,) = evaluate_rows(plant.robot.to_velocity, run.x)
    measured = run.x[:, : velocity.shape[1]], velocity, run.jets
    run.u[:], V = evaluate_rows(law.function, *measured, np.tile(law.gain_values, (len(t), 1)))
    run.V[:] = V[:, 0]
    return run


def _closed_loop_step(plant: Plant, law: StaticLaw, dt: float) -> ca.Function:
    """Build the Runge-Kutta step over dt [s] of dx/dt = f(x) + G u(x, x, t): x, jets at start, middle, end -> x."""
    n, gains = plant.robot.n, ca.DM(law.gain_values)
    x, *stages = ca.MX.sym("x", 4 * n), *(ca.MX.sym(name, n, JETS) for name in ("start", "middle", "end"))

    def f(x: ca.MX, jets: ca.MX) -> ca.MX:
        return plant.dynamics(x, law.function(x[: 2 * n], plant.robot.to_velocity(x), jets, gains)[0])

    inputs = {"x": x, **{each.name(): each for each in stages}}
    return dense_function("closed_loop_step", inputs, {"x_next": rk4_expression(f, x, tuple(stages), dt)})


def _diverged(t: float) -> StateError:
    return StateError(f"the closed loop diverged: the state is not finite at t = {t:.6g} s")


def _empty_trajectory(robot: Robot, t: Array, jets: Array) -> Trajectory:
    x, u, V = np.empty((len(t), 4 * robot.n)), np.empty((len(t), robot.n)), np.empty(len(t))
    return Trajectory(t, x, u, jets, V, robot.units)


def _jets(reference: Reference, t: Array) -> Array:
    """Return q_ld .. d4q_ld (k, 5, n) at times t (k,) [s]; raise TrajectoryError, as a user may write the reference."""
    jets = checks.floats("jets of the reference", reference.jets(t), TrajectoryError)
    if jets.shape != (shape := (len(t), JETS, reference.n)):
        raise TrajectoryError(f"jets of the reference have shape {jets.shape} at {len(t)} times; expected {shape}")
    return jets


class PlotError(FjrError):
    """Matplotlib is not installed."""


@dataclass(frozen=True)
class Trajectory:
    """Closed-loop run at k instants: t (k,), x (k, 4n), u (k, n), jets (k, 5, n), V (k,); SI units.

    units: of each joint, rad and N m or m and N.
    """

    t: Array
    x: Array
    u: Array
    jets: Array
    V: Array
    units: tuple[Units, ...]

    def __repr__(self) -> str:
        effort, V = np.max(np.abs(self.u), initial=0.0), brief(self.V[[0, -1]])
        return (
            f"Trajectory({joints(self.u.shape[1])}, {len(self.t)} instants, {span(self.t)}, |u| <= {effort:.4g}, V={V})"
        )

    def plot(self) -> Figure:
        """Draw positions, tracking errors, efforts and V over time; return the Matplotlib figure.

        Each joint has a colour. Raises PlotError if Matplotlib cannot be imported.
        """
        try:
            from matplotlib import pyplot
        except ImportError as error:
            sentence = f"Matplotlib cannot be imported ({error}); expected it from: {PIP} matplotlib"
            raise PlotError(sentence) from None
        figure, ((position, effort), (deviation, storage)) = pyplot.subplots(
            2, 2, sharex=True, figsize=(9, 5), layout="constrained"
        )
        n = self.u.shape[1]
        q_l, q_ld = self.x[:, :n], self.jets[:, 0]
        length, force = (joined(getattr(each, name) for each in self.units) for name in ("position", "effort"))
        for axes, label, values in (
            (position, f"q_l [{length}]", q_l),
            (deviation, f"q_l - q_ld [{length}]", q_l - q_ld),
            (effort, f"u [{force}]", self.u),
            (storage, "V [J]", self.V[:, None]),
        ):
            axes.plot(self.t, values)
            axes.set_ylabel(label)
            axes.grid(alpha=0.3)
        for joint, line in enumerate(position.lines[:]):
            position.plot(self.t, q_ld[:, joint], "--", color=line.get_color(), alpha=0.6)
        if np.any(self.V > 0):
            storage.set_yscale("log")
        for axes in (deviation, storage):
            axes.set_xlabel("t [s]")
        position.set_title("links (dashed: reference)", fontsize="medium")
        if n > 1:
            names = [f"joint {i + 1}" for i in range(n)]
            figure.legend(effort.lines, names, loc="outside right upper", fontsize="small")
        return figure
