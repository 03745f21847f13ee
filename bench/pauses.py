# SPDX-License-Identifier: Apache-2.0
"""Pauses of the processes (SIGSTOP, SIGCONT) in real time, and a controller that is killed beside a moving robot.

An arm without efforts falls: it has left its limits by itself if a state violates one at most
REACTION after the first new effort.
"""

from __future__ import annotations

import os
import signal
import time
from contextlib import ExitStack
from dataclasses import dataclass
from functools import cache

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from numpy.typing import NDArray

from bench.figures import Figure
from bench.nodes import controller, plant, process, scenario_file
from bench.tap import DEPTH, Heard, Tap, waiting
from fjr_core.config.nodes import CONTROLLER
from fjr_core.config.scenario import Scenario
from fjr_core.runtime.events import STOPS
from fjr_msgs_py import names
from fjr_msgs_py.scenarios import library

ROBOTS, PAUSED = ("arm7", "two_link"), (("controller",), ("plant",), ("plant", "controller"))
PAUSES, KILLS, SEED = 40, 4, 0
SHORTEST, LONGEST = 0.05, 1.0  # s
WARM_UP, AFTER, UNDISTURBED = 2.0, 5.0, 9.0  # s
REACTION = 10_000_000  # ns
OLD = 5_000_000  # ns; an effort for a state older than the newest one by more is one for the past
ON_ITS_WAY = 1_000_000  # ns; a state that left later before the effort may not have arrived
PEAK_BOUND = 1.5  # of the peak effort of the undisturbed run
LIMIT = 60.0  # s; of each wait
load = cache(library.load)
TOPICS, EVENTS = [names.JOINT_STATES, names.JOINT_COMMANDS], f"{CONTROLLER}/events"


@dataclass(frozen=True)
class Outcome:
    """What followed a pause. peak: relative to the undisturbed run; old: efforts for the past; lost [s]: the pause."""

    robot: str
    paused: str
    lost: float
    at: float
    stopped: bool
    left: bool
    peak: float
    old: int


def recovered(pauses: int = PAUSES, kills: int = KILLS) -> list[Figure]:
    """Return the worst of all pauses, and of all restarts of a killed controller; print each."""
    random, outcomes = np.random.default_rng(SEED), list[Outcome]()
    for k in range(pauses + kills):
        at, lost = random.uniform(0.0, 4.0), random.uniform(SHORTEST, LONGEST)
        paused = PAUSED[k // len(ROBOTS) % len(PAUSED)] if k < pauses else ()
        outcomes.append(_outcome(ROBOTS[k % len(ROBOTS)], paused, at, lost))
        print(outcomes[-1], flush=True)
    figures = []
    for what, chosen in (
        ("pauses", [each for each in outcomes if each.paused != "killed"]),
        ("kills of the controller", [each for each in outcomes if each.paused == "killed"]),
    ):
        own = [each for each in chosen if not each.left]
        counted = {"all": float(len(chosen)), "within the limits": float(len(own))}
        figures += [
            Figure(f"{what}: stops within the limits", sum(each.stopped for each in own), "", bound=0, parts=counted),
            Figure(f"{what}: peak effort", max((each.peak for each in own), default=0.0), "of the run's", PEAK_BOUND),
            Figure(f"{what}: efforts for the past", sum(each.old for each in chosen), "", bound=0),
        ]
    return figures


def _outcome(robot: str, paused: tuple[str, ...], at: float, lost: float) -> Outcome:
    """Run a pair, disturb it `at` seconds after the warm-up, and judge what follows; no process paused: kill."""
    own = _own_peak(robot, WARM_UP if paused else 0.0)  # a start is compared with a run and its start
    with scenario_file(name=robot) as file, Tap() as tap, ExitStack() as stack:
        nodes = {
            "plant": stack.enter_context(process(plant(file), quiet=True)),
            "controller": stack.enter_context(process(controller(file), quiet=True, may_end=not paused)),
        }
        events = tap.node.create_subscription(DiagnosticStatus, EVENTS, lambda _: None, DEPTH)
        heard = stack.enter_context(tap.listening(TOPICS, LIMIT))
        heard.collect(WARM_UP + at)
        begin = woken = time.time_ns()
        if paused:
            for name in paused:
                os.kill(nodes[name].pid, signal.SIGSTOP)
            time.sleep(lost)
            woken = time.time_ns()
            for name in paused:
                os.kill(nodes[name].pid, signal.SIGCONT)
        else:
            nodes["controller"].kill()
            nodes["controller"].wait()
            stack.enter_context(process(controller(file), quiet=True))
        count = len(heard.seen[1])
        heard.until(lambda: len(heard.seen[1]) > count, LIMIT, "a command of a running controller")
        heard.collect(AFTER)
        stopped = STOPS in [event.name for event, _ in waiting(events, DiagnosticStatus)]
    left, peak, old = _judged(robot, heard, begin, woken)
    return Outcome(robot, "+".join(paused) or "killed", lost, at, stopped, left, peak / own, old)


def _judged(robot: str, heard: Heard, begin: int, woken: int) -> tuple[bool, float, int]:
    """Return whether the arm left its limits by itself, the peak effort [N m], and the number of efforts for the past.

    begin, woken: when the pause began and ended [ns].
    """
    seen, times = heard.messages()
    after, answers = times[:, 1] >= woken, np.zeros(len(times), dtype=bool)
    answers[np.unique(times[:, 0], return_index=True)[1]] = True  # the stop effort after a silence answers no state
    answers &= after
    newest = np.maximum.accumulate(seen[:, 0])
    at_sending = newest[np.searchsorted(seen[:, 1], times[answers, 1] - ON_ITS_WAY) - 1]
    old = int(np.sum(at_sending - times[answers, 0] > OLD))
    first = int(times[answers, 1][0]) if answers.any() else woken
    meanwhile = (seen[:, 1] >= begin) & (seen[:, 1] <= first + REACTION)
    left = bool((_outside(load(robot), heard.values(0, "position", "velocity")) & meanwhile).any())
    return left, float(np.abs(heard.values(1, "effort")[after]).max()), old


def _outside(scenario: Scenario, states: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which positions and velocities (k, 4n) violate a limit of position, velocity or deflection."""
    limits, n = scenario.settings, scenario.robot.n
    q_l, q_m, dq_l, dq_m = np.split(states, [n, 2 * n, 3 * n], axis=1)
    found = np.zeros(len(states), dtype=bool)
    for value, lower, upper in (
        (q_l, limits.link_position_lower, limits.link_position_upper),
        (q_m, limits.motor_position_lower, limits.motor_position_upper),
        (np.abs(dq_l), 0.0, limits.link_velocity),
        (np.abs(dq_m), 0.0, limits.motor_velocity),
        (np.abs(q_m - q_l), 0.0, limits.deflection),
    ):
        found |= ((value < np.asarray(lower)) | (value > np.asarray(upper))).any(axis=1)
    return found


@cache
def _own_peak(robot: str, skipped: float) -> float:
    """Return the largest effort of an undisturbed run [N m] after the first `skipped` seconds."""
    with scenario_file(name=robot) as file, Tap() as tap, ExitStack() as stack:
        for command in (plant(file), controller(file)):
            stack.enter_context(process(command, quiet=True))
        heard = stack.enter_context(tap.listening(TOPICS, LIMIT))
        heard.collect(UNDISTURBED)
    sent = heard.messages()[1][:, 1]
    return float(np.abs(heard.values(1, "effort")[sent >= sent[0] + skipped * 1e9]).max())
