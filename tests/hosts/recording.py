# SPDX-License-Identifier: Apache-2.0
"""Record the inputs of a controller: in a study of a scenario, or on the topics while a fault is injected."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import JointState

from faults.fault_rows import JOINT, Row
from faults.peers import COMMANDS, STATES
from faults.rig import NOTHING, SECOND, STEPPED, Rig
from fjr_core.config.nodes import CONTROLLER
from fjr_core.config.scenario import parse_scenario
from fjr_design.batch import Draws, scenario_loop
from fjr_msgs_py.names import state_names
from hosts.efforts import Efforts
from hosts.inputs import Input, Kind, Sequence, with_ticks
from system.executables import scenario as file_of

NOISE = {"position_noise": 1e-6, "velocity_noise": 1e-3}
"""Of the sensors [rad, rad/s], so that no two samples are equal."""
REQUESTS = "stop, resume, new gains and limits, hold"
MISWIRED = "motor velocity with the wrong sign"
LIMITED = {"limits.tracking_error": [0.5]}
CHANGED = {"gains.K_ld": [0.7], "gains.Pi_l": [40.0], "limits.effort": [1.0]}
STOP, RESUMED, CHANGE, HELD = 300, 400, 550, 700
"""Samples at which the state is outside the limit, and of the requests."""
START = SECOND  # stamp of the first sample: a message needs one above 0
TICK = SECOND // 100  # a tenth of state_timeout of the fault rows, as in the nodes


def of_scenario(name: str, samples: int) -> tuple[Sequence, Efforts]:
    """Return the samples of an installed scenario in a study, and the efforts (samples, n) of that study."""
    return of_study(name, Path(file_of(name)).read_text(encoding="utf-8"), samples)


def of_study(name: str, document: str, samples: int) -> tuple[Sequence, Efforts]:
    """Return the samples of the scenario of a document in a study, and the efforts (samples, n) of that study."""
    s = parse_scenario(name, document)
    duration = (samples - 0.5) * s.sample_period
    _, run = scenario_loop(s, s.sampled_law, duration, settle_after=0.0).recorded(Draws(1, **NOISE))
    inputs = []
    for k, measured in enumerate(run.measured[0]):
        stamp, (position, velocity) = START + round(k * s.sample_period * SECOND), np.split(measured, 2)
        message = JointState(name=state_names(s.joints), position=position, velocity=velocity)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, SECOND)
        inputs.append(Input(Kind.STATE, stamp, serialize_message(message)))
    return Sequence(name, document, True, tuple(inputs), published=True), run.u[0]


def of_requests() -> Sequence:
    """Return states of a joint with one outside the limit of the error, then the requests."""
    document, changed = (yaml.safe_dump(JOINT.document({"controller": more})) for more in (LIMITED, LIMITED | CHANGED))
    sequence, _ = of_study("requests", document, 1000)
    inputs = list(sequence.inputs)
    message = deserialize_message(inputs[STOP].raw, JointState)
    message.position = [each + 1.0 for each in message.position]
    inputs[STOP] = Input(Kind.STATE, inputs[STOP].time, serialize_message(message))
    for at, kind in ((HELD, Kind.HOLD), (CHANGE, Kind.CHANGE), (RESUMED, Kind.RESUME)):
        inputs.insert(at, Input(kind, inputs[at].time, parameters=CHANGED if kind is Kind.CHANGE else {}))
    return Sequence(REQUESTS, document, True, tuple(inputs), published=True, changed=changed)


def of_wrong_wiring(more: Mapping[str, Mapping[str, Any]] = NOTHING) -> Sequence:
    """Return states of a joint whose motor velocity has the wrong sign, for which the controller stops.

    more: parameters of each node.
    """
    sequence, _ = of_study(MISWIRED, yaml.safe_dump(JOINT.document(more)), 200)
    inputs = [replace(each, raw=_reversed(each.raw)) for each in sequence.inputs]
    return replace(sequence, inputs=tuple(inputs))


def _reversed(raw: bytes) -> bytes:
    message = deserialize_message(raw, JointState)
    message.velocity[1] *= -1
    return serialize_message(message)


def of_row(row: Row) -> Sequence:
    """Inject the fault of a row into running nodes; return what the controller received."""
    rig = Rig(row.setting, row.mode)
    try:
        rig.start_both()
        _, end = row.act(rig)
        rig.until_stamp(end + SECOND // 10)
        rig.until_calm(1.0 + (row.recovery or 0.0))
        rig.watcher.look()
        inputs = _received(rig)
    finally:
        rig.close()
    simulated = row.mode == STEPPED
    document = yaml.safe_dump(row.setting.document(), sort_keys=False)
    return Sequence(row.name, document, simulated, tuple(inputs) if simulated else with_ticks(inputs, TICK))


def _received(rig: Rig) -> list[Input]:
    """Return states and requests in the order of their times, without the states that no controller received."""
    states, requests = rig.watcher.heard[STATES], rig.remote.requests
    found = [Input(Kind.PARAMETERS, sent, parameters=values) for node, sent, values in requests if node == CONTROLLER]
    if killed := rig.killed.get("controller"):
        restarted = rig.started["controller"]
        answered = next(heard.stamp for heard in rig.watcher.heard[COMMANDS] if heard.sent > restarted)
        first = next(heard.sent for heard in states if heard.stamp >= answered)
        states = [heard for heard in states if not killed < heard.sent < first]
        found.append(Input(Kind.RESTART, first))
    found += [Input(Kind.STATE, heard.sent, heard.raw) for heard in states]
    return sorted(found, key=lambda each: each.time)
