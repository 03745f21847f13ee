# SPDX-License-Identifier: Apache-2.0
"""Script that computes the first effort from the URDF of a scenario, run in its own process."""

from __future__ import annotations

import sys

from fjr_core import TrackingLaw
from fjr_core.config.scenario import load_scenario


def main(path: str) -> None:
    """Print the effort at the initial state of the scenario."""
    scenario = load_scenario(path)
    law = TrackingLaw(scenario.robot, scenario.gains, compile=True)
    print(law.command(scenario.x0, scenario.reference.jets(0.0)).tolist(), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
