# SPDX-License-Identifier: Apache-2.0
"""Time of the proof of a rate for the seven-joint arm, and the proven rate relative to sampled and attained ones.

Times are processor times of one core. `python -m bench.proof` prints the table of docs/proof.md, and with FILE.png
draws the proven rate against the number of boxes.
"""

from __future__ import annotations

import sys
import time
from typing import NamedTuple

from bench.arm import arm7
from bench.figures import Figure, markdown, one_core
from fjr_core.model.configuration_sampling import RATE_CONFIGURATIONS, sample_configurations
from fjr_core.motions.domain import MOST_BOXES, Domain, tube
from fjr_proofs.rate import proof_of_rate

RADIUS, WIDER = 1e-3, 0.05  # rad, of the tubes
LONGEST = 120.0  # s
LEAST = 0.9  # proven / sampled
NEAR_BOUND = 1.0  # s


class Rates(NamedTuple):
    """Sampled, proven and smallest found rate [1/s], and the processor time of the proof [s]."""

    sampled: float
    proven: float
    attained: float
    seconds: float


def proven(domain: Domain | None, most_boxes: int = MOST_BOXES) -> Rates:
    """Prove the rate on a domain near the reference, or on None, the joint range."""
    arm = arm7()
    law = arm.tracking_law
    with one_core():
        begin = time.process_time()
        found = law.proven_rate(domain, most_boxes=most_boxes)
        seconds = time.process_time() - begin
    sampled = law.rate(arm.configurations() if domain else None).beta
    return Rates(sampled, found.beta, found.attained or float("nan"), seconds)


def over_joint_range_and_tube(most_boxes: int = MOST_BOXES) -> list[Figure]:
    """Prove the rate over the joint range and near the reference; compare with sampled rates."""
    near, whole = proven(tube(arm7().reference, RADIUS), most_boxes=1), proven(None, most_boxes)
    rates = {"proven [1/s]": whole.proven, "sampled [1/s]": whole.sampled, "attained [1/s]": whole.attained}
    share, reached = whole.proven / whole.sampled, whole.proven / whole.attained
    return [
        Figure("proof of a rate near the reference of arm7", near.seconds, "s", NEAR_BOUND, 0.2),
        Figure("proven / sampled rate near the reference", near.proven / near.sampled, "", LEAST, at_least=True),
        Figure("proof of a rate over the joint range of arm7", whole.seconds, "s", LONGEST, 60.0),
        Figure("proven / sampled rate over the joint range", share, "", LEAST, at_least=True, parts=rates),
        Figure("proven / attained rate over the range", reached, "", LEAST, at_least=True),
    ]


def table() -> list[str]:
    """Return the Markdown lines of rates near the reference and over the joint range, and times."""
    domains: dict[str, Domain | None] = {}
    for radius in (RADIUS, WIDER):
        near = tube(arm7().reference, radius)
        domains[f"within {radius:g} rad of the reference in each joint"] = Domain(near.lower, near.upper)
    rows = []
    for name, domain in (domains | {"joint range": None}).items():
        *rates, seconds = proven(domain)
        rows.append((name, *(f"{rate:.3g}" for rate in rates), f"{seconds:.2g} s"))
    head = ("domain of `arm7`, gains of the scenario", "sampled", "proven", "smallest rate found", "time, one core")
    return markdown(head, rows)


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
        print("\n".join(table()))
