# SPDX-License-Identifier: Apache-2.0
"""Time of the proof of a rate for the seven-joint arm, and the proven rate relative to sampled and attained ones.

Times are processor times of one core. `python -m bench.proof` prints the table of docs/proof.md, and with FILE.png
draws the proven rate against the number of boxes.
"""

from __future__ import annotations

import sys
import time

from bench.arm import arm7
from bench.figures import Figure
from bench.measure import one_core
from fjr_core.model.configuration_sampling import RATE_CONFIGURATIONS, sample_configurations
from fjr_core.motions.domain import Domain, tube
from fjr_proofs.rate import proof_of_rate

RADIUS, WIDER = 1e-3, 0.05  # rad, of the tubes
LONGEST = 120.0  # s
LEAST = 0.9  # proven / sampled
NEAR_BOUND = 1.0  # s


def over_joint_range_and_tube(most_boxes: int = 4000) -> list[Figure]:
    """Prove the rate over the joint range and near the reference; compare with sampled rates."""
    arm = arm7()
    law, where = arm.tracking_law, arm.configurations()
    with one_core():
        begin = time.process_time()
        near = law.proven_rate(tube(arm.reference, RADIUS), most_boxes=1)
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


def table() -> str:
    """Return sampled, proven and smallest rates [1/s] near the reference and over the joint range, and times [s]."""
    arm = arm7()
    law, where, rows = arm.tracking_law, arm.configurations(), []
    for radius in (RADIUS, WIDER, None):
        with one_core():
            begin = time.process_time()
            near = tube(arm.reference, radius) if radius else None
            found = law.proven_rate(near and Domain(near.lower, near.upper))
            seconds = time.process_time() - begin
        name = f"within {radius:g} rad of the reference in each joint" if radius else "joint range"
        sampled, attained = law.rate(where if radius else None).beta, found.attained or float("nan")
        rows.append(f"| {name} | {sampled:.3g} | {found.beta:.3g} | {attained:.3g} | {seconds:.2g} s |")
    return "\n".join(rows)


def draw(path: str) -> None:
    """Draw proven, attained and sampled rate over the joint range against the number of boxes of the proof."""
    from matplotlib.figure import Figure as Picture

    arm, rows = arm7(), list[tuple[float, ...]]()
    law = arm.tracking_law

    def watch(boxes: int, bound: float, attained: float) -> bool:
        rows.append((boxes, 1 / bound, 1 / attained))
        return True

    samples = sample_configurations(arm.robot, RATE_CONFIGURATIONS)
    proof_of_rate(arm.robot, law.gains, samples=samples, watch=watch)
    boxes, proven, attained = zip(*rows, strict=True)
    figure = Picture(figsize=(7.5, 3.4), layout="constrained")
    axes = figure.add_subplot()
    axes.axhline(law.rate().beta, color="0.5", linestyle=":", label=f"{len(samples)} sampled configurations")
    axes.semilogx(boxes, attained, color="C1", label="attained at a configuration")
    axes.semilogx(boxes, proven, color="C0", label="proven for every configuration")
    axes.set(xlabel="boxes", ylabel="rate beta [1/s]", ylim=(0, None), title="arm7 over its joint range")
    axes.legend(loc="lower right")
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    if sys.argv[1:]:
        draw(sys.argv[1])
    else:
        print(table())
