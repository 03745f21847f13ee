# SPDX-License-Identifier: Apache-2.0
"""Regenerate the tables of docs/tables/measurements.md between their markers; seeded, so that they repeat.

. ros2_ws/install/setup.sh && .venv/bin/python -m tools.measurement_study.table
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from fjr_core import Plant, single_link
from fjr_core.config.controller import BANDWIDTH
from fjr_core.config.scenario import Scenario

from .loop import Run, Sensors, run, scenario

PAGE = Path(__file__).resolve().parents[2] / "docs" / "tables" / "measurements.md"
TORQUE_RANGES = {"paper_k31": 5.0, "paper_k3p1": 5.0, "two_link": 50.0, "arm7": 200.0}  # N m, of the torque sensors
BANDWIDTHS = (30.0, 60.0, 100.0, 150.0, 200.0, 300.0, 500.0)  # rad/s
SETTLED = 2.0  # s


def modes(scenario: Scenario, torque_range: float) -> Iterator[tuple[str, Run]]:
    """Yield a description of each sensor set with its run; torque_range [N m] of the torque sensors."""
    exact, encoders = Sensors(), Sensors(bits=16)
    yield "all measured, exact", run(scenario, exact, None)
    yield "all measured, encoders", run(scenario, encoders, None)
    yield "observer, exact positions", run(scenario, exact, BANDWIDTH)
    yield "observer, encoders", run(scenario, encoders, BANDWIDTH)
    yield "observer, encoders, positions not smoothed", run(scenario, encoders, BANDWIDTH, smoothed=False)
    yield "observer, encoders, gear ratio 100", run(scenario, Sensors(bits=16, gear_ratio=100.0), BANDWIDTH)
    sensors = Sensors(bits=16, torque_range=torque_range)
    yield "observer, encoder and torque sensor", run(scenario, sensors, BANDWIDTH)


def measured_table(scenarios: Mapping[str, Scenario]) -> list[str]:
    """Return the table of errors [rad] and ripple [N m] by scenario and sensor set."""
    lines = [
        "| scenario | measurement | RMS, rad | largest, rad | ripple of u, N m |",
        "| --- | --- | --- | --- | --- |",
    ]
    for name, loop in scenarios.items():
        for sensor_set, found in modes(loop, TORQUE_RANGES[name]):
            metrics = (found.rms(SETTLED), found.largest(SETTLED), found.ripple(SETTLED))
            lines.append(f"| `{name}` | {sensor_set} | " + " | ".join(f"{value:.1e}" for value in metrics) + " |")
    return lines


def bandwidth_table(scenarios: Mapping[str, Scenario]) -> list[str]:
    """Return the table of RMS error [rad] and ripple [N m] with encoders by bandwidth and scenario."""
    lines = ["| bandwidth, rad/s | " + " | ".join(f"`{name}`" for name in scenarios) + " |"]
    lines.append("| --- " * (len(scenarios) + 1) + "|")
    for bandwidth in BANDWIDTHS:
        runs = [run(loop, Sensors(bits=16), bandwidth) for loop in scenarios.values()]
        cells = (f"{found.rms(SETTLED):.1e} / {found.ripple(SETTLED):.1e}" for found in runs)
        lines.append(f"| {bandwidth:g} | " + " | ".join(cells) + " |")
    return lines


def mismatch_table(scenarios: Mapping[str, Scenario]) -> list[str]:
    """Return the table of RMS error [rad] of the paper's joint with a wrong model: by bandwidth."""
    real = single_link(stiffness=32.55, link_inertia=0.0341, gravity_torque=0.88, link_damping=0.15)
    observers = {"measured": None, **{f"{bandwidth:g}": bandwidth for bandwidth in BANDWIDTHS}}
    loop, plant = scenarios["paper_k31"], Plant(real, compile=True)
    found = [run(loop, Sensors(bits=16), bandwidth, plant=plant).rms(SETTLED) for bandwidth in observers.values()]
    head = "| bandwidth, rad/s | " + " | ".join(observers) + " |"
    return [
        head,
        "| --- " * (len(observers) + 1) + "|",
        "| RMS, rad | " + " | ".join(f"{rms:.1e}" for rms in found) + " |",
    ]


def main() -> int:
    """Rewrite the tables on the page."""
    scenarios = {name: scenario(name) for name in TORQUE_RANGES}
    page = PAGE.read_text(encoding="utf-8")
    tables = {"measurements": measured_table, "bandwidths": bandwidth_table, "mismatch": mismatch_table}
    for name, table in tables.items():
        begin, end = f"<!-- {name}: written by tools/measurement_study/table.py -->", f"<!-- end of {name} -->"
        before, rest = page.split(begin)
        page = "\n".join([before + begin, "", *table(scenarios), "", end + rest.split(end)[1]])
    PAGE.write_text(page, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
