# SPDX-License-Identifier: Apache-2.0
"""Find in a bag when and why the controller stopped."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fjr_bringup.recording.reader import Array, Bag, Times
from fjr_core.control_step.event_kinds import STARTS_REFUSED, STOPS
from fjr_msgs_py import names
from fjr_msgs_py.messages.events import STAMP

EVENTS = f"/{names.CONTROLLER}/{names.EVENTS.removeprefix('~/')}"
HEADINGS = {STOPS: "The controller stopped at {:.3g} s", STARTS_REFUSED: "The controller did not start"}


@dataclass(frozen=True)
class ControllerStop:
    """A stop of the controller. at_s [s]: time since the start of the run; heading: event; reason: one sentence."""

    at_s: float
    heading: str
    reason: str

    @property
    def sentence(self) -> str:
        """Heading and reason."""
        return f"{self.heading}: {self.reason}"


def controller_stop(bag: Bag, sent: Times, stamps: Times, t: Array) -> ControllerStop | None:
    """Return the first stop in a bag; None if the controller never stopped.

    sent, stamps (k,) [ns]: send times and stamps of the states; t (k,) [s]: their times since the start of the run. An
    event without a stamp is assigned to the last state sent before it.
    """
    if not bag.holds(EVENTS):
        return None
    topic = bag.topic(EVENTS)
    for event, when in zip(topic.decoded, topic.publish_time, strict=True):
        if event.name in HEADINGS:
            stamp = next((int(pair.value) for pair in event.values if pair.key == STAMP), None)
            times, at_time = (sent, when) if stamp is None else (stamps, stamp)
            row = int(np.searchsorted(times, at_time, side="right")) - 1
            _, _, reason = event.message.partition(": ")
            at = float(t[max(row, 0)])
            return ControllerStop(at, HEADINGS[event.name].format(at), reason)
    return None
