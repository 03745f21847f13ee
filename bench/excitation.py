# SPDX-License-Identifier: Apache-2.0
"""Intervals of the stiffness from a designed motion, against those from the scenario's own, by the estimator.

    python -m bench.excitation SCENARIO EXCITED.yaml --duration 10

EXCITED.yaml is the output of `fjr excite SCENARIO`. Both references are simulated with white encoder noise; each
record is identified with all usual parameters free. Takes minutes for seven joints: no part of `make bench`.
"""

from __future__ import annotations

import argparse

import numpy as np

from bench.identification import simulated
from fjr_core.config.scenario import Scenario
from fjr_core.numerics.checks import Array
from fjr_identification.estimation.identify import identify
from fjr_identification.estimation.parameters import IdentifyOptions, Prior
from fjr_msgs_py.scenarios import library

SHOWN = ("joint_stiffness", "motor_inertia")


def half_widths(scenario: Scenario, duration: float, noise: float) -> dict[str, Array]:
    """Return the relative half widths (n,) of the 95 % intervals by parameter."""
    record, _ = simulated(scenario, duration, noise)
    found = identify([record], scenario.robot, Prior.of(scenario.robot), IdentifyOptions())
    return {
        name: np.array([(e.high - e.low) / (2 * e.value) for e in found.estimates if e.name == name]) for name in SHOWN
    }


def main() -> None:
    """Print the half widths of both motions and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenario")
    parser.add_argument("excited")
    parser.add_argument("--duration", type=float, default=10.0, help="s")
    parser.add_argument("--noise", type=float, default=1e-5, help="rad")
    given = parser.parse_args()
    before, after = (
        half_widths(library.load(name), given.duration, given.noise) for name in (given.scenario, given.excited)
    )
    for name in SHOWN:
        print(f"{name}: {before[name]} before, {after[name]} excited, ratio {before[name] / after[name]}")


if __name__ == "__main__":
    main()
