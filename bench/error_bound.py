# SPDX-License-Identifier: Apache-2.0
"""Bound of the tracking error against the largest error of simulated robots of its class, drawn and searched for.

`python -m bench.error_bound SCENARIO [NAME=VALUE ...] [runs=N] [searches=N]` prints the figures of one scenario, e.g.
for payload=0.2, with one sample of delay. It fails if a bound is missed.

The simulation shares nothing with the bound: the links are a sum of chains in which one body has its mass or its
inertia only; equations are integrated as second order differential equations in positions and velocities by the
classical Runge-Kutta method.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import product
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike
from tqdm import tqdm

from bench.figures import Figure, table
from fjr_core.law.interfaces import StaticLaw
from fjr_core.model.newton_euler import serial_chain
from fjr_core.model.rigid_arm import ArmDynamics
from fjr_core.model.robot import Robot
from fjr_core.motions.inverse_dynamics import motor_motion
from fjr_core.motions.reference import Reference
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import compiled
from fjr_core.stability.linearization import split
from fjr_msgs_py.console.options import model_error
from fjr_msgs_py.scenarios import library
from fjr_proofs.check_rows import payload_position
from fjr_proofs.error_bound import bound_errors
from fjr_proofs.error_bound.search import SECONDS_TO_PROVE

RUNS, SEARCHES = 10_000, 200
ROUNDS = 15  # of a search
AT_ONCE = 250  # runs between two steps of the bar
SETTLED = 1.0  # s until errors count
SCENARIOS = {"paper_k31": (7.3, 1.5), "two_link": (7.3, 2.0), "arm7": (3.0, 3.0)}
"""Length [s] of a run, a period of the reference beyond SETTLED; largest ratio of bound and largest error."""
STEPS = 2  # of the integrator in each part of a sample
WIDTHS = {"payload": 1, "payload_mass": 1, "payload_position": 3, "gravity": 1, "gravity_direction": 2}
JOINTS = ("link_mass", "link_central_inertia", "stiffness", "motor_inertia", "link_damping", "motor_damping")
LEVELS = ("payload_mass", "payload_position", "gravity_direction")
STEP_SIZE = 0.5  # of the search, as a share of the half widths


def on_reference(robot: Robot, reference: Reference, t: float = 0.0) -> tuple[Array, Array, Array, Array, Array]:
    """Return q_l, q_m, dq_l, dq_m and u (n,) of the robot that keeps its links on the reference, at a time [s]."""
    q, dq, *more = reference.jets(t)
    motors = motor_motion(robot, q, dq, *more)
    theta, dtheta, torque = (each.full().ravel() for each in (motors.theta, motors.dtheta, motors.torque))
    return q, theta, dq, dtheta, np.linalg.solve(robot.B_m, torque)


@dataclass(frozen=True, eq=False)
class UncertainLoop:
    """A law, sampled every T [s] and late by a delay [s], on robots that differ from its own along a reference.

    errors: largest error of each parameter, as for `bound_errors`. payload_position (3,) [m]. settled, duration [s]:
    time until errors count, and of a run.
    """

    law: StaticLaw
    reference: Reference
    T: float
    delay: float
    errors: Mapping[str, ArrayLike]
    settled: float
    duration: float
    payload_position: ArrayLike = (0.0, 0.0, 0.0)

    @property
    def numbers(self) -> int:
        """Number of uncertain parameters."""
        return sum(self._sizes[name].size for name in self.errors)

    def worst(self, searches: int, rounds: int, weights: Array) -> Array:
        """Return the largest errors (searches, n) [rad], or [m], that each search by CMA-ES finds.

        Errors count relative to `weights` (n,). The searches ask at once for the robots of a round.
        """
        of_all = [self._search(seed) for seed in range(searches)]
        largest: Array = np.zeros((searches, len(weights)))
        for _ in tqdm(range(rounds), desc="rounds of the searches", disable=not sys.stderr.isatty()):
            asked = [search.ask() for search in of_all]
            sizes = [len(each) for each in asked]
            peaks, _ = self.peaks(np.concatenate(asked)[:, : self.numbers])
            found = np.split(peaks, np.cumsum(sizes)[:-1])
            for search, points, errors in zip(of_all, asked, found, strict=True):
                search.tell(points, list(-np.max(errors / weights, axis=1)))
            largest = np.maximum(largest, [each.max(axis=0) for each in found])
        return largest

    def _search(self, seed: int) -> Any:
        """Return a search by CMA-ES from random shares; of one parameter, repeated, as it needs several."""
        import cma  # with Matplotlib, which no test needs that only reads this module

        start = np.random.default_rng(seed).uniform(-1, 1, self.numbers)
        options = {"bounds": [-1, 1], "seed": seed + 1, "verbose": -9}
        return cma.CMAEvolutionStrategy(start.repeat(max(1, 3 - len(start))), STEP_SIZE, options)

    def peaks(self, shares: Array) -> tuple[Array, Array]:
        """Return the largest |q_l - q_ld| (k, n) once settled, and at all times, of robots with shares (k, .), -1 to 1.

        The robots start on the reference with the motors of the model, whose efforts are in transit.
        """
        parameters, n = self._parameters(shares).T, self.law.robot.n
        whole, fraction = split(self.delay, self.T)
        start, *before = (on_reference(self.law.robot, self.reference, -i * self.T) for i in range(whole + 2))
        x = np.tile(np.concatenate(start[:4])[:, None], len(shares))
        efforts = [np.tile(u[:, None], len(shares)) for *_, u in before]
        largest = np.zeros((2, n, len(shares)))
        answer, advance = (function.map(len(shares)) for function in (self._answer, self._step))
        for k in range(round(self.duration / self.T)):
            jets = self.reference.jets(k * self.T)
            error = np.abs(x[:n] - jets[0][:, None])
            largest[1] = np.maximum(largest[1], error)
            if k * self.T >= self.settled:
                largest[0] = np.maximum(largest[0], error)
            efforts = [answer(x, np.tile(jets.T, len(shares))).full(), *efforts[: whole + 1]]
            for effort, share in ((efforts[whole + 1], fraction), (efforts[whole], 1 - fraction)):
                if share:
                    x = advance(x, effort, parameters, share * self.T).full()
        return largest[0].T, largest[1].T

    @property
    def _sizes(self) -> dict[str, Array]:
        n = self.law.robot.n
        widths = WIDTHS | dict.fromkeys(JOINTS, n)
        return {name: np.broadcast_to(self.errors.get(name, 0.0), size) for name, size in widths.items()}

    def _parameters(self, shares: Array) -> Array:
        """Return all parameters (k, .) at shares of the uncertain ones."""
        ends = np.cumsum([self._sizes[name].size for name in self.errors])[:-1]
        parts = np.split(shares, ends, axis=1) if self.errors else []
        of_errors = dict(zip(self.errors, parts, strict=True))
        columns = []
        for name, size in self._sizes.items():
            share = of_errors.get(name, np.zeros((len(shares), size.size)))
            nominal = np.asarray(self.payload_position) if name == "payload_position" else float(name not in LEVELS)
            columns.append(size * (1 + share) / 2 if name == "payload_mass" else nominal + size * share)
        return np.concatenate(columns, axis=1)

    @cached_property
    def _answer(self) -> ca.Function:
        n, law = self.law.robot.n, self.law
        x, jets = ca.SX.sym("x", 4 * n), ca.SX.sym("jets", n, 5)
        u, _ = law.measured_expression(x[: 2 * n], x[2 * n :], jets, ca.DM(law.gain_values))
        return compiled(ca.Function("uncertain_answer", [x, jets], [ca.densify(u)], {"cse": True}))

    @cached_property
    def _step(self) -> ca.Function:
        """(x, u, parameters, dt) -> x after dt."""
        robot, n = self.law.robot, self.law.robot.n
        x, u, dt = ca.SX.sym("x", 4 * n), ca.SX.sym("u", n), ca.SX.sym("dt")
        sizes = {name: size.size for name, size in self._sizes.items()}
        parts = {name: ca.SX.sym(name, size) for name, size in sizes.items()}
        parameters = ca.vertcat(*parts.values())
        f = ca.Function("f", [x, ca.vertcat(u, parameters)], [_rates(robot, x, u, parts)])
        after = ca.simpleRK(f, STEPS)(x, ca.vertcat(u, parameters), dt)
        return compiled(ca.Function("uncertain_step", [x, u, parameters, dt], [after], {"cse": True}))


def _rates(robot: Robot, x: ca.SX, u: ca.SX, p: Mapping[str, ca.SX]) -> ca.SX:
    """Return dx/dt (4n,) of x = (q_l, q_m, dq_l, dq_m)."""
    q_l, q_m, dq_l, dq_m = ca.vertsplit(x, robot.n)
    M, torque, zero = ca.SX(robot.n, robot.n), ca.SX(robot.n, 1), ca.DM.zeros(robot.n)
    a, b = ca.vertsplit(p["gravity_direction"])
    end_effector = robot.links.end_effector
    assert end_effector is not None
    gravity = end_effector.gravity
    across = np.linalg.svd(gravity[None, :])[2][1:]
    size, down = np.linalg.norm(gravity), gravity / np.linalg.norm(gravity)
    turned = size * (ca.sin(b) * across[0] - ca.sin(a) * ca.cos(b) * across[1] + ca.cos(a) * ca.cos(b) * down)
    for body, of_inertia in product(range(robot.n), (False, True)):
        joint = robot.links.order.index(body)
        factor = p["link_mass"][joint] * (p["link_central_inertia"][joint] if of_inertia else 1)
        alone = partial(_alone, robot.links, body, of_inertia)
        M += factor * alone(gravity).M_l(q_l)
        torque += factor * alone(gravity).inertial_torque(q_l, dq_l, dq_l, zero)
        for axis in range(3):
            torque += factor * p["gravity"] * turned[axis] * alone(np.eye(3)[axis]).grad_P_l(q_l)
    M, torque = p["payload"] * M, p["payload"] * torque  # of the links, not of the payload in kg
    place = end_effector.position(q_l, p["payload_position"])
    J = ca.jacobian(place, q_l)
    bent = ca.jtimes(J @ dq_l, q_l, dq_l)
    M += p["payload_mass"] * J.T @ J
    torque += p["payload_mass"] * J.T @ (bent - p["gravity"] * turned)
    tau = p["stiffness"] * (robot.K @ (q_m - q_l))
    links = tau - p["link_damping"] * (robot.D_l @ dq_l) - torque
    motors = robot.B_m @ u - tau - p["motor_damping"] * (robot.D_m @ dq_m)
    ddq_m = np.linalg.inv(robot.M_m) @ (motors / p["motor_inertia"])
    return ca.vertcat(dq_l, dq_m, ca.solve(M, links), ddq_m)


def _alone(links: ArmDynamics, body: int, of_inertia: bool, gravity: Array) -> ArmDynamics:
    """Return the arm of which one body has its mass, or its inertia about the centre of mass, and all else nothing.

    gravity (3,) [m/s^2].
    """
    shares = [(k == body and not of_inertia, k == body and of_inertia) for k in range(len(links.bodies))]
    bodies = [
        replace(each, mass=mass * each.mass, inertia=inertia * np.asarray(each.inertia))
        for each, (mass, inertia) in zip(links.bodies, shares, strict=True)
    ]
    return serial_chain(bodies, gravity, links.order)


def of_scenario(
    name: str, errors: Mapping[str, ArrayLike], runs: int, searches: int, settings: list[str]
) -> list[Figure]:
    """Bound the tracking error for errors of parameters and one sample of delay; compare with runs and searches.

    The box of errors is not divided for a bound from the start.
    """
    scenario, (duration, limit) = library.load(name, settings), SCENARIOS[name]
    T, place = scenario.sample_period, payload_position(scenario)
    prove = None if scenario.robot.n <= SECONDS_TO_PROVE else True
    loop = scenario.law, scenario.reference, T, T
    bound = bound_errors(*loop, errors, prove=prove, payload_position=place, seconds=0.0)
    robots = UncertainLoop(*loop, errors, SETTLED, duration, place)
    steady, whole = drawn(robots, runs if errors else 1)
    found = robots.worst(searches, ROUNDS, bound.position) if errors and searches else steady[:0]
    largest, basis = np.max([*found, steady.max(axis=0)], axis=0), "proven" if bound.proven else "sampled"
    sizes = {
        f"{what} of {joint} [mrad]": 1e3 * float(size)
        for what, of_joints in (("bound", bound.position), ("largest error", largest))
        for joint, size in zip(scenario.joints, of_joints, strict=True)
    }
    ratio = float(np.max(bound.position / largest))
    return [
        Figure(f"{name}, {basis} error bound: runs of {len(steady)} beyond it", beyond(steady, bound.position), "", 0),
        Figure("... in parts", bound.parts, ""),
        Figure("... runs beyond the bound from the start", beyond(whole, bound.from_start), "", 0),
        Figure(f"... searches of {len(found)} beyond it", beyond(found, bound.position), "", 0),
        Figure("... bound / largest error, worst joint", ratio, "", limit, parts=sizes),
    ]


def beyond(peaks: Array, bound: Array) -> int:
    """Return the number of runs (k, n) that exceed a bound (n,)."""
    return int(np.count_nonzero(np.any(peaks > bound, axis=1))) if len(peaks) else 0


def drawn(loop: UncertainLoop, runs: int, seed: int = 0) -> tuple[Array, Array]:
    """Return the peaks of robots that are drawn uniformly; every second one is a corner of the class."""
    shares = np.random.default_rng(seed).uniform(-1, 1, (runs, loop.numbers))
    shares[::2] = np.sign(shares[::2])
    parts = [shares[i : i + AT_ONCE] for i in range(0, runs, AT_ONCE)]
    peaks = [loop.peaks(part) for part in tqdm(parts, desc="runs", disable=not sys.stderr.isatty())]
    steady, whole = (np.concatenate(each) for each in zip(*peaks, strict=True))
    if not np.all(np.isfinite(whole)):
        raise RuntimeError("a run is not stable; expected all of them to be")
    return steady, whole


if __name__ == "__main__":
    if len(sys.argv) < 2 or sys.argv[1] not in SCENARIOS:
        sys.exit(f"usage: python -m bench.error_bound {'|'.join(SCENARIOS)} [NAME=VALUE ...] [runs=N] [searches=N]")
    settings = [word for word in sys.argv[2:] if ":=" in word]
    given = dict(model_error(word) for word in sys.argv[2:] if ":=" not in word)
    runs, searches = (int(np.max(given.pop(*of))) for of in (("runs", RUNS), ("searches", SEARCHES)))
    figures = of_scenario(sys.argv[1], given, runs, searches, settings)
    print(table(figures))
    sys.exit(not all(figure.holds for figure in figures))
