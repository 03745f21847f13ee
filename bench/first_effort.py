# SPDX-License-Identifier: Apache-2.0
"""A process of its own: from a scenario's URDF to the first effort, as a user's script would."""

from __future__ import annotations

import sys

from fjr_core import TrackingLaw
from fjr_core.config.scenario import load_scenario


def main(path: str) -> None:
    """Print the law's effort at the scenario's start."""
    scenario = load_scenario(path)
    law = TrackingLaw(scenario.robot, scenario.gains, compile=True)
    print(law.command(scenario.x0, scenario.reference.jets(0.0)).tolist(), flush=True)


if __name__ == "__main__":
    main(sys.argv[1])
