# SPDX-License-Identifier: Apache-2.0
"""Speed without ROS: evaluations against Pinocchio and MuJoCo, called from Python, and the loop against real time."""

from __future__ import annotations

from functools import partial
from timeit import timeit

import casadi as ca
import mujoco
import numpy as np
import pinocchio as pin

from bench.arm import arm7, forward_dynamics, mujoco_spec, random_motion, rigid_arm7
from bench.figures import Call, Figure, in_turns, microseconds, one_core, ratio
from fjr_core import PAPER_GAINS, TrackingLaw, simulate, single_link
from fjr_core.config.scenario import Scenario
from fjr_core.numerics.checks import Array
from fjr_core.numerics.jit import compiled
from fjr_core.numerics.symbolic import bind

STEP = 2.5e-4  # s
DURATION = 3.0  # s, of the closed loop
TOLERANCE = 1e-6  # rad; largest change of the closed loop when the inner step is halved
MOST_STEPS, REPEATS = 64, 9


def law_over_rnea() -> list[Figure]:
    """Compare u(x, x, t) of the law with inverse dynamics, also through the public methods."""
    arm = arm7()
    q, dq, ddq = random_motion(arm.robot.n, seed=1)
    x, jets = arm.robot.state(q, q + 0.01, dq, dq), arm.reference.jets(0.3)
    law, model = arm.tracking_law, rigid_arm7()
    calls: dict[str, Call] = {
        "law": _bound(law.command_function, x, jets),
        "pin.rnea": partial(pin.rnea, model, model.createData(), q, dq, ddq),
        "law.command": partial(law.command, x, jets),
        "law.effort": partial(law.effort, x, x, jets),
    }
    times = in_turns(calls)
    parts = microseconds(times)
    public = ("law.command", "law.effort")
    return [
        Figure(
            "law, 7 joints, over pin.rnea",
            ratio(times["law"], times["pin.rnea"]),
            "",
            bound=1.5,
            parts={key: value for key, value in parts.items() if not key.startswith(public)},
        ),
        *(Figure(f"{name}, 7 joints, arrays checked and copied", parts[f"{name} [us]"], "us") for name in public),
    ]


def forward_dynamics_over_aba() -> list[Figure]:
    """Compare the forward dynamics of the rigid arm."""
    arm = arm7()
    q, dq, tau = random_motion(arm.robot.n, seed=2)
    model = rigid_arm7()
    calls: dict[str, Call] = {
        "forward dynamics": _bound(compiled(forward_dynamics(arm.robot.links)), q, dq, tau),
        "pin.aba": partial(pin.aba, model, model.createData(), q, dq, tau),
    }
    return [_ratio("forward dynamics, 7 joints, over pin.aba", calls, bound=0.4)]


def step_over_mujoco() -> list[Figure]:
    """Compare one Runge-Kutta step of the elastic arm without effort; MuJoCo continues from step to step."""
    arm = arm7()
    q, dq, _ = random_motion(arm.robot.n, seed=3)
    u = np.zeros(arm.robot.n)
    model = mujoco_spec(arm.robot, STEP).compile()
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = np.concatenate([q, q + 0.01]), np.concatenate([dq, dq])
    x = arm.robot.state(q, q + 0.01, dq, dq)
    calls: dict[str, Call] = {
        "plant step": _bound(arm.plant.step_function, x, u, np.array([STEP])),
        "mj_step": partial(mujoco.mj_step, model, data),
    }
    figure = _ratio("RK4 step, elastic arm, over MuJoCo's", calls, bound=0.4)
    if not np.all(np.isfinite(data.qpos)):
        raise ArithmeticError("the state of MuJoCo's arm is not finite; expected a free oscillation")
    return [figure]


def virtual_machine_over_c() -> list[Figure]:
    """Compare CasADi's virtual machine with compiled C for the paper's joint."""
    robot = single_link()
    x, jets = robot.state([0.5], [0.5], [0.0], [0.0]), np.zeros((5, 1))
    laws = {name: TrackingLaw(robot, PAPER_GAINS, compile=name == "C") for name in ("virtual machine", "C")}
    calls = {name: _bound(law.command_function, x, jets) for name, law in laws.items()}
    return [_ratio("law, paper's joint, CasADi's virtual machine over C", calls)]


def times_real_time() -> list[Figure]:
    """Measure law and plant of the scenario at its sample period."""
    arm = arm7()
    steps, change = fine_enough(arm)
    with one_core():
        walls = [timeit(lambda: positions(arm, steps), number=1) for _ in range(REPEATS)]
    parts = {
        "inner step [ms]": 1e3 * arm.sample_period / steps,
        "halving it changes q by [rad]": change,
        "spread [%]": 100 * float(np.ptp(walls) / np.median(walls)),
    }
    value = DURATION / float(np.median(walls))
    return [Figure("closed loop, 7 joints, 1 kHz", value, "x real time", bound=60, aim=100, at_least=True, parts=parts)]


def fine_enough(arm: Scenario) -> tuple[int, float]:
    """Return the fewest steps per sample (a power of two), and the change of positions [rad] with twice as many."""
    steps, change, coarse = 1, np.inf, positions(arm, 1)
    while steps <= MOST_STEPS:
        fine = positions(arm, 2 * steps)
        change = float(np.max(np.abs(fine - coarse)))
        if change < TOLERANCE:
            return steps, change
        steps, coarse = 2 * steps, fine
    raise ArithmeticError(f"{MOST_STEPS} steps a sample leave {change:.1e} rad; expected less than {TOLERANCE}")


def positions(arm: Scenario, steps: int) -> Array:
    """Return q_l and q_m (k, 2n) at every sample [rad]."""
    period = arm.sample_period
    run = simulate(arm.plant, arm.law, arm.reference, arm.x0, DURATION, period, inner_step=period / steps)
    return run.x[:, : 2 * arm.robot.n]


def _ratio(name: str, calls: dict[str, Call], bound: float | None = None) -> Figure:
    times = in_turns(calls)
    ours, theirs = times.values()
    return Figure(name, ratio(ours, theirs), "", bound=bound, parts=microseconds(times))


def _bound(function: ca.Function, *arguments: Array) -> Call:
    results = [np.zeros(function.numel_out(i)) for i in range(function.n_out())]
    return bind(function, arguments, results)
