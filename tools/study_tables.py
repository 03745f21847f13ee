# SPDX-License-Identifier: Apache-2.0
"""Studies of sensors and observer, of robust options and of noise: tables of docs/tables, between their markers.

. ros2_ws/install/setup.sh && .venv/bin/python -m tools.study_tables measurements robust
fjr tune arm7_tune && .venv/bin/python -m tools.study_tables noise --tuned runs/tuned/arm7_tune_v_dpbc/tuned.yaml

They are seeded and need no ROS. `robust` also draws docs/figures/robust.png.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from tqdm import tqdm

import fjr_core as fjr
from bench.figures import markdown, put
from fjr_core.config.controller import BANDWIDTH
from fjr_core.config.scenario import Scenario, load_scenario
from fjr_core.numerics.checks import Array
from fjr_core.robust.law import Robust, sampled_law
from fjr_design.batch import ClosedLoop, Draws
from fjr_design.studies.imperfections import directions, motion_demand
from fjr_design.studies.sweep import Sweep, figures, scenario_loop
from fjr_design.studies.sweep_file import Options, planned
from fjr_design.studies.trial import Trial
from fjr_design.tuning.equal_bandwidth import baseline_target, tune
from fjr_monitor.report.picture import COLOURS, STYLE

ROOT = Path(__file__).resolve().parents[1]
PICTURE = ROOT / "docs" / "figures" / "robust.png"
SECONDS, SETTLED = 6.0, 2.0  # s


def scenario(name: str) -> Scenario:
    """Load an installed scenario."""
    return load_scenario(ROOT / "ros2_ws/src/fjr_bringup/scenarios" / f"{name}.yaml")


# Sensors and observer.

START = 1_000_000_000  # ns; stamp of the first sample
TORQUE_RANGES = {"paper_k31": 5.0, "paper_k3p1": 5.0, "two_link": 50.0, "arm7": 200.0}  # N m, of the torque sensors
BANDWIDTHS = (30.0, 60.0, 100.0, 150.0, 200.0, 300.0, 500.0)  # rad/s


@dataclass(frozen=True)
class Sensors:
    """Sensors of q_l and q_m: encoders on both sides, or a joint torque sensor instead of the motor encoder.

    bits: encoder resolution per turn of its shaft, 0: exact. gear_ratio: turns of the motor shaft per turn of q_m.
    torque_range [N m]: of the torque sensors, 0: none; torque_bits: over +-range; torque_noise: standard deviation
    relative to the range, seeded.
    """

    bits: int = 0
    gear_ratio: float = 1.0
    torque_range: float = 0.0
    torque_bits: int = 16
    torque_noise: float = 5e-4

    def read(self, robot: fjr.Robot, q_l: Array, q_m: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Return measured (q_l, q_m) [rad]."""
        encoder = 2 * np.pi / 2**self.bits if self.bits else 0.0
        link = _rounded(q_l, encoder)
        if not self.torque_range:
            return link, _rounded(q_m * self.gear_ratio, encoder) / self.gear_ratio
        noise = self.torque_noise * self.torque_range * rng.standard_normal(robot.n)
        torque = _rounded(robot.K @ (q_m - q_l) + noise, 2 * self.torque_range / 2**self.torque_bits)
        return link, link + np.linalg.solve(robot.K, torque)


def _rounded(values: Array, step: float) -> Array:
    return np.round(values / step) * step if step else values


@dataclass(frozen=True)
class Run:
    """A run of k samples: t (k,) [s], q_tilde_l (k, n) [rad], u (k, n) [N m], velocity errors (k, 2n) [rad/s]."""

    t: Array
    q_tilde_l: Array
    u: Array
    velocity_error: Array

    def rms(self, start: float = SETTLED) -> float:
        """Return the RMS of q_tilde_l from `start` [s] on, of the worst joint [rad]."""
        return float(np.sqrt(np.mean(self.q_tilde_l[self.t >= start] ** 2, axis=0)).max())

    def largest(self, start: float = SETTLED) -> float:
        """Return the largest |q_tilde_l| from `start` [s] on, of all joints [rad]."""
        return float(np.abs(self.q_tilde_l[self.t >= start]).max())

    def ripple(self, start: float = SETTLED) -> float:
        """Return the RMS change of u between samples from `start` [s] on, of the worst joint [N m]."""
        return float(np.sqrt(np.mean(np.diff(self.u[self.t >= start], axis=0) ** 2, axis=0)).max())


def run(
    scenario: Scenario,
    sensors: Sensors,
    bandwidth: float | None,
    smoothed: bool = True,
    duration: float = 5.0,
    plant: fjr.Plant | None = None,
) -> Run:
    """Simulate the sampled loop without delay. bandwidth [rad/s]: of the observer; None: exact velocities.

    smoothed: feed back the positions of the observer instead of the measured ones. plant: replaces the scenario's.
    """
    robot, plant, n = scenario.robot, plant or scenario.plant, scenario.robot.n
    period = round(scenario.sample_period * 1e9)
    steps = int(scenario.plant_values["inner_steps"])  # type: ignore[arg-type]
    observer = fjr.VelocityObserver(robot, bandwidth, compile=True) if bandwidth else None
    rng, x = np.random.default_rng(0), scenario.x0
    u: Array = np.zeros(n)
    t = np.asarray(scenario.sample_period * np.arange(int(duration / scenario.sample_period + 1e-9) + 1), dtype=float)
    jets = scenario.reference.jets(t)
    error, efforts, velocity_error = np.empty((len(t), n)), np.empty((len(t), n)), np.zeros((len(t), 2 * n))
    for k in range(len(t)):
        position: Array = np.concatenate(sensors.read(plant.robot, x[:n], x[n : 2 * n], rng))
        exact = np.concatenate(plant.robot.velocities(x))
        velocity: Array = exact
        if observer:
            observer.update(START + k * period, position[:n], position[n:], u)
            velocity = observer.state[2 * n :]
            position = observer.state[: 2 * n] if smoothed else position
        error[k], velocity_error[k] = x[:n] - jets[k, 0], velocity - exact
        u = efforts[k] = scenario.law.measured_command(position, velocity, jets[k])[0]
        for _ in range(steps):
            x = plant.step(x, u, period * 1e-9 / steps)
    return Run(t, error, efforts, velocity_error)


ENCODERS = Sensors(bits=16)
SENSOR_SETS: dict[str, Callable[[Scenario, float], Run]] = {  # by a scenario and the range of its torque sensors [N m]
    "all measured, exact": lambda loop, _: run(loop, Sensors(), None),
    "all measured, encoders": lambda loop, _: run(loop, ENCODERS, None),
    "observer, exact positions": lambda loop, _: run(loop, Sensors(), BANDWIDTH),
    "observer, encoders": lambda loop, _: run(loop, ENCODERS, BANDWIDTH),
    "observer, encoders, positions not smoothed": lambda loop, _: run(loop, ENCODERS, BANDWIDTH, smoothed=False),
    "observer, encoders, gear ratio 100": lambda loop, _: run(loop, replace(ENCODERS, gear_ratio=100.0), BANDWIDTH),
    "observer, encoder and torque sensor": lambda loop, range_: run(
        loop, replace(ENCODERS, torque_range=range_), BANDWIDTH
    ),
}


def measurements() -> None:
    """Write errors [rad] and ripple [N m] by sensor set and by bandwidth, and errors with a wrong model."""
    loops = {name: scenario(name) for name in TORQUE_RANGES}
    sets = []
    for name, loop in loops.items():
        for sensor_set, simulated in SENSOR_SETS.items():
            found = simulated(loop, TORQUE_RANGES[name])
            sets.append(
                (f"`{name}`", sensor_set, *map("{:.1e}".format, (found.rms(), found.largest(), found.ripple())))
            )
    by_bandwidth = [
        (f"{each:g}", *(f"{found.rms():.1e} / {found.ripple():.1e}" for found in _with_encoders(loops, each)))
        for each in BANDWIDTHS
    ]
    real = fjr.single_link(stiffness=32.55, link_inertia=0.0341, gravity_torque=0.88, link_damping=0.15)
    wrong = partial(run, loops["paper_k31"], ENCODERS, plant=fjr.Plant(real, compile=True))
    observers = {"measured": None, **{f"{each:g}": each for each in BANDWIDTHS}}
    for table, head, rows in (
        ("measurements", ("scenario", "measurement", "RMS, rad", "largest, rad", "ripple of u, N m"), sets),
        ("bandwidths", ("bandwidth, rad/s", *(f"`{name}`" for name in loops)), by_bandwidth),
        (
            "mismatch",
            ("bandwidth, rad/s", *observers),
            [("RMS, rad", *(f"{wrong(each).rms():.1e}" for each in observers.values()))],
        ),
    ):
        begin, end = f"<!-- {table}: written by tools/study_tables.py -->", f"<!-- end of {table} -->"
        put(["", *markdown(head, rows), ""], "measurements.md", begin, end)


def _with_encoders(loops: Mapping[str, Scenario], bandwidth: float) -> Iterator[Run]:
    return (run(loop, ENCODERS, bandwidth) for loop in loops.values())


# Robust options.

PERIOD = 1e-3  # s
RESIDUAL, INTEGRAL = Robust(residual_gain=60.0), Robust(integral_gain=5.0)
LOAD = {"none": None, "residual": RESIDUAL, "integral": INTEGRAL, "both": Robust(residual_gain=60.0, integral_gain=5.0)}
PREDICTION = {"none": None, "prediction": Robust(delay=PERIOD)}
OPTION_COLOURS = dict(zip(LOAD, ("black", *COLOURS[:3]), strict=True)) | {"prediction": COLOURS[0]}
DRAWN_CASES = (1, 3, 5)


@dataclass(frozen=True, eq=False)
class Disturbed:
    """A loop on a robot that differs from the model of its law, and options to compensate that."""

    text: str
    scenario: Scenario
    reference: fjr.Reference
    deviation: Draws
    options: Mapping[str, Robust | None]

    def errors(self) -> dict[str, Array]:
        """Return q_l - q_ld (k, n) [rad] with each option, from the reference or from 0.5 rad at rest."""
        robot, n = self.scenario.robot, self.scenario.robot.n
        law = fjr.TrackingLaw(robot, self.scenario.gains, compile=True)
        q_l, dq_l = self.reference.jets(0.0)[:2]
        if n == 1 and not isinstance(self.reference, fjr.Hold):
            q_l, dq_l = np.array([0.5]), np.zeros(1)
        x0 = robot.state(q_l, q_l + np.linalg.solve(robot.K, robot.grad_P_l(q_l)), dq_l, dq_l)
        found = {}
        for name, option in self.options.items():
            loop = ClosedLoop(robot, sampled_law(law, option), self.reference, x0, SECONDS, PERIOD)
            run = loop.recorded(self.deviation)[1]
            found[name] = run.x[0, :, :n] - self.reference.jets(run.t)[:, 0]
        return found


def disturbed() -> list[Disturbed]:
    """Return the cases of the table."""
    joint, planar, arm = map(scenario, ("paper_k31", "two_link", "arm7"))
    slow = fjr.Sine(0.3, 2 * np.pi * 0.2, offset=arm.reference.jets(0.5)[0])
    pushed, heavier, late = Draws(1, external=0.3), Draws(1, link_inertia=1.2), Draws(1, delay=PERIOD)
    return [
        Disturbed("`paper_k31` at standstill, 0.3 N m on the link", joint, fjr.Hold([0.5]), pushed, LOAD),
        Disturbed("`paper_k31` moving, 0.3 N m on the link", joint, joint.reference, pushed, LOAD),
        Disturbed("`two_link` moving, inertia 20 % larger", planar, planar.reference, heavier, LOAD),
        Disturbed("`arm7`, 0.3 rad at 0.2 Hz, inertia 20 % larger", arm, slow, heavier, LOAD),
        Disturbed("the same, weight 20 % larger too", arm, slow, replace(heavier, gravity=1.2), LOAD),
        *(
            Disturbed(f"`{each.name}` moving, one sample of delay", each, each.reference, late, PREDICTION)
            for each in (joint, planar, arm)
        ),
    ]


def robust() -> None:
    """Write the RMS of q_l - q_ld [rad] without and with each option, and draw the errors of three cases."""
    found = [(case, case.errors()) for case in tqdm(disturbed(), desc="robust")]
    rows = []
    for case, errors in found:
        plain, *left = (float(np.sqrt(np.mean(e[round(SETTLED / PERIOD) :] ** 2))) for e in errors.values())
        for name, rms in zip(list(errors)[1:], left, strict=True):
            rows.append((case.text, f"{plain:.1e}", name, f"{rms:.1e}", f"{min(plain / rms, 1e6):.3g}"))
    head = ("disturbance", "error without, rad", "option", "error with, rad", "ratio")
    put(markdown(head, rows), "robust.md", "<!-- measured: begin -->", "<!-- measured: end -->")
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(12.0, 3.8), layout="constrained")
        for ax, i in zip(figure.subplots(1, 3), DRAWN_CASES, strict=True):
            case, errors = found[i]
            for name, e in errors.items():
                t = PERIOD * np.arange(len(e))
                ax.semilogy(t, np.maximum(np.abs(e).max(axis=1), 1e-9), color=OPTION_COLOURS[name], label=name, lw=1.0)
            ax.set_title(case.text.replace("`", ""), fontsize=9)
            ax.set_xlabel("t [s]")
            ax.set_ylim(bottom=1e-8)
            ax.legend(fontsize=8, loc="upper right")
        figure.axes[0].set_ylabel("largest |q_l - q_ld| [rad]")
        figure.savefig(PICTURE)


# Noise of arm7.

STIFFER = 7.0  # factor on K_md
DRAWN = 200  # plants


def noise(tuned: Path) -> None:
    """Write the noise that arm7 tolerates with six sets of gains; tuned: tuned.yaml of `fjr tune arm7_tune`."""
    study = planned("arm7_tune", Options(1, None, Path(), {}, {}))
    robot, given = study.scenario.robot, study.scenario.gains
    softer = replace(given, Pi_m=robot.K)
    gains = {
        "scenario": given,
        "`Pi_m = K`": softer,
        f"`K_md` {STIFFER:g} times as large": replace(given, K_md=STIFFER * np.asarray(given.K_md)),
        "both": replace(softer, K_md=STIFFER * np.asarray(given.K_md)),
        "[tuning rule](../compare.md#tuning-rule)": tune(
            "v_dpbc", baseline_target(study.scenario), retune=True
        ).law.gains.matrices,
        "`fjr tune arm7_tune`": load_scenario(tuned).gains,
    }
    rows = [(name, *_noise(study, each)) for name, each in tqdm(gains.items(), desc="noise of arm7")]
    head = ("gains of arm7", "RMS error", "noise in the effort", "noise margin", "delay margin")
    begin, end = "<!-- noise of arm7: written by tools/study_tables.py -->", "<!-- end of noise of arm7 -->"
    put(markdown(head, rows), "compare.md", begin, end)


def _noise(study: Sweep, gains: fjr.Gains) -> Iterator[str]:
    """Yield error and noise in the effort over drawn plants, noise margin and delay margin of gains as text.

    The loops have no limits of position, speed and error; the efforts of the draws stay limited.
    """
    scenario, draws = study.scenario, study.draws(0, DRAWN)
    law = fjr.TrackingLaw(scenario.robot, gains)
    drawn = figures(replace(study.loop, settings=None).with_law(law).run(draws), np.ones(DRAWN, dtype=bool))
    yield f"{1e3 * np.median(drawn['rms']):.2g} mrad"
    yield f"{np.median(drawn['effort_noise']):.2g} N m"
    longer = replace(scenario_loop(scenario, law, SECONDS, settle_after=SETTLED), settings=None)
    trial = Trial(longer, motion_demand(scenario.robot, scenario.reference), np.asarray(draws.effort_limit)[0])
    yield f"{1e3 * (trial.margins(directions(['noise']))['noise up to'].level or 0.0):.2g} mrad"
    check = fjr.check(law, scenario.sample_period, scenario.loop_delay, scenario.configurations())
    yield f"{check.delay_margin:.1f} samples"


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the named studies."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("studies", nargs="+", choices=("measurements", "robust", "noise"))
    parser.add_argument("--tuned", type=Path, help="tuned.yaml that `fjr tune arm7_tune` has written, for noise")
    given = parser.parse_args(arguments)
    if "noise" in given.studies and given.tuned is None:
        parser.error("noise needs --tuned")
    studies: dict[str, Callable[[], None]] = {"measurements": measurements, "robust": robust}
    studies["noise"] = partial(noise, given.tuned)
    for name in given.studies:
        studies[name]()


if __name__ == "__main__":
    main()
