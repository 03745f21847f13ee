# SPDX-License-Identifier: Apache-2.0
"""State the claim of the paper's simulations with the numbers of a run with a stiff and one with a soft joint.

Paper, section 4: with K = 3.1 in place of 31 N m/rad the loop still converges and the transient time is maintained, but
the effort overshoots considerably more.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from fjr_core.numerics.one_line import at_least
from fjr_monitor.analysis import headlines
from fjr_monitor.analysis.metrics import Report, Storage
from fjr_msgs_py.console.output import number

SAME = 0.2  # largest relative difference of two settling times that count as equal


@dataclass(frozen=True)
class Claim:
    """The claim in one sentence. kind: holding if the runs show it, else unknown. title: of the page, if they do."""

    kind: str
    heading: str
    sentence: str
    title: str = ""


def paper_claim(stiff: Report, soft: Report, stiffness: tuple[float, float]) -> Claim:
    """Return the claim for two runs with the same law and gains; stiffness of their joints [N m/rad], stiff first."""
    reasons = [*_reasons(stiff, soft)]
    if reasons:
        return Claim("unknown", "The paper's claim is not shown", f"{'; '.join(reasons)}.")
    softer, efforts = (
        number(stiffness[0] / stiffness[1], digits=2),
        [headlines.peak_effort(each) for each in (stiff, soft)],
    )
    title = f"A joint {softer} times softer: the link moves alike, the effort rises from {efforts[0]} to {efforts[1]}"
    return Claim("holding", "The paper's claim", _sentence(stiff, soft, stiffness), title)


def _sentence(stiff: Report, soft: Report, stiffness: tuple[float, float]) -> str:
    first, second = (_storage(each) for each in (stiff, soft))
    softer = number(stiffness[0] / stiffness[1], digits=2)
    stiffnesses = _both(stiffness, "N m/rad")
    settled = _both([each.tracking.settling_time_2_percent_s for each in (stiff, soft)], "s")
    decay = _both([each.measured_decay_rate_per_s for each in (first, second)], "1/s")
    least = f"{at_least(min(first.guaranteed_decay_rate_per_s, second.guaranteed_decay_rate_per_s), 3)} 1/s"
    basis = "proven" if first.guarantee_is_proven and second.guarantee_is_proven else "sampled"
    return (
        f"The same law with the same gains tracks with a joint {softer} times softer: with {stiffnesses} the link "
        f"error settles within 2 % of its start in {settled}, V decays at {decay} ({basis}: at least {least}), and the "
        f"peak effort rises from {headlines.peak_effort(stiff)} to {headlines.peak_effort(soft)}."
    )


def _both(values: Sequence[float | None], unit: str) -> str:
    """Format two values as 40.6 and 72.3 1/s, or one if they read the same."""
    texts = list(dict.fromkeys(map(number, values)))
    return f"{' and '.join(texts)} {unit}"


def _reasons(stiff: Report, soft: Report) -> Iterator[str]:
    """Yield why the runs do not show the claim."""
    for each in (stiff, soft):
        storage, settled = each.storage, each.tracking.settling_time_2_percent_s
        if each.stop:
            yield f"{each.scenario}: {each.stop.heading}"
        elif each.advice:
            yield f"{each.scenario}: {each.advice}"
        elif each.status not in ("holding", "degraded"):
            yield f"{each.scenario}: {each.verdict.sentence.rstrip('.')}"
        elif settled is None:
            yield f"{each.scenario}: the link error does not settle within {number(each.duration_s, 's')}"
        elif storage is None or (storage.measured_decay_rate_per_s or 0.0) < storage.guaranteed_decay_rate_per_s:
            yield f"{each.scenario}: V does not decay at the guaranteed rate"
    times = [each.tracking.settling_time_2_percent_s for each in (stiff, soft)]
    if None not in times and abs(times[0] - times[1]) > SAME * max(times):  # type: ignore[operator,type-var]
        yield f"the transients differ: {number(times[0], 's')} and {number(times[1], 's')}"


def _storage(report: Report) -> Storage:
    assert report.storage is not None  # _reasons has no reason
    return report.storage
