# SPDX-License-Identifier: Apache-2.0
"""Time of the proof of a rate for the seven-joint arm, and the proven rate relative to sampled and attained ones.

Times are processor times of one core.
"""

from __future__ import annotations

import time

from bench.arm import Arm
from bench.figures import Figure
from bench.measure import one_core
from fjr_core.trajectories.tube import tube

RADIUS = 1e-3  # rad, of the tube
LONGEST = 120.0  # s
LEAST = 0.9  # proven / sampled
NEAR_BOUND = 1.0  # s


def over_joint_range_and_tube(arm: Arm, most_boxes: int = 4000) -> list[Figure]:
    """Prove the rate over the joint range and near the reference; compare with sampled rates."""
    law, where = arm.law, arm.scenario.configurations()
    with one_core():
        begin = time.process_time()
        near = law.proven_rate(tube(arm.scenario.reference, RADIUS), most_boxes=1)
        first = time.process_time()
        whole = law.proven_rate(most_boxes=most_boxes)
        last = time.process_time()
    sampled, along, attained = law.rate().beta, law.rate(where).beta, whole.attained or float("nan")
    rates = {"proven [1/s]": whole.beta, "sampled [1/s]": sampled, "attained [1/s]": attained}
    return [
        Figure("proof of a rate near the reference of arm7", first - begin, "s", NEAR_BOUND, 0.2),
        Figure("proven / sampled rate near the reference", near.beta / along, "", LEAST, at_least=True),
        Figure("proof of a rate over the joint range of arm7", last - first, "s", LONGEST, 60.0),
        Figure(
            "proven / sampled rate over the joint range", whole.beta / sampled, "", LEAST, at_least=True, parts=rates
        ),
        Figure("proven / attained rate over the range", whole.beta / attained, "", LEAST, at_least=True),
    ]
