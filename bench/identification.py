# SPDX-License-Identifier: Apache-2.0
"""Coverage of the intervals of `fjr identify`: random arms and records, identified, compared with the truth.

    python -m bench.identification --cases 30 --joints 1 2 3 4 5 6 7 --measured both --out coverage.jsonl

Each case is added to the file as it ends. The same command goes on with the missing ones, and prints the tables of all.
A study of an hour for many joints: no part of `make bench`.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterable, Sequence
from itertools import product
from multiprocessing import Pool
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from bench.figures import markdown
from bench.identification_cases import MEASURED, Case, draw
from fjr_core.errors import FjrError
from fjr_design.uncertainty.posterior import LOG, UNKNOWN, Identification
from fjr_identification.estimation.identify import identify
from fjr_identification.estimation.parameters import KINDS, IdentifyOptions

Row = dict[str, Any]
Key = tuple[str, int, int]
"""Kind of measurement, number of joints, and seed of a case."""
FIRST = 1000
"""First seed, so that no case is one by which the estimator was made."""


def identified(key: Key) -> Row:
    """Identify a case; return its estimates beside the truth, or why it was refused."""
    measured, n, seed = key
    case, began = draw(n, seed, measured=measured), time.perf_counter()
    line: Row = {"measured": measured, "joints": n, "seed": seed}
    try:
        rows = compared(case, identify([case.record], case.robot, case.prior, IdentifyOptions(threads=1)))
    except FjrError as error:
        return {**line, "error": str(error), "rows": []}
    return {**line, "seconds": round(time.perf_counter() - began, 2), "rows": rows}


def compared(case: Case, found: Identification) -> list[Row]:
    """Return for each parameter whether its interval contains the truth; score: its error in standard deviations."""
    rows = []
    posterior = dict(zip(found.free, zip(found.mean, np.sqrt(np.diag(found.covariance)), strict=True), strict=True))
    for k, each in enumerate(found.estimates):
        true = float(case.truth[each.name][found.joints.index(each.joint)])
        z, sd = posterior.get(k, (np.nan, np.nan))
        rows.append(
            {
                "name": each.name,
                "joint": each.joint,
                "verdict": each.verdict,
                "inside": bool(each.low <= true <= each.high),
                "score": float((z - (np.log(true) if KINDS[each.name].coordinate == LOG else true)) / sd),
                "error": abs(each.value / true - 1) if true else float("nan"),
            }
        )
    return rows


def table(rows: Sequence[Row]) -> list[str]:
    """Return a Markdown table with one line for each kind of parameter; behind the share, its 95 % Wilson interval."""
    cells = []
    for name in dict.fromkeys(row["name"] for row in rows):
        own = [row for row in rows if row["name"] == name]
        known = [row for row in own if row["verdict"] != UNKNOWN]
        share, error = "", ""
        if known:
            test = binomtest(sum(row["inside"] for row in known), len(known))
            low, high = test.proportion_ci(method="wilson")
            share = f"{test.statistic:.1%} ({100 * low:.1f} to {100 * high:.1f})"
            error = f"{np.nanmedian([row['error'] for row in known]):.2%}"
        cells.append((name.replace("_", " "), str(len(known)), share, str(len(own) - len(known)), error))
    head = ("parameter", "intervals", "inside", "not identifiable", "median error")
    return markdown(head, cells, right=head[1:])


def report(lines: Sequence[Row]) -> Iterable[str]:
    """Return the table of each kind of measurement, below what it consists of."""
    for measured in dict.fromkeys(line["measured"] for line in lines):
        own = [line for line in lines if line["measured"] == measured]
        numbers = {n: sum(line["joints"] == n for line in own) for n in sorted({line["joints"] for line in own})}
        refused = sum("error" in line for line in own)
        shares = ", ".join(f"{count} of {n}" for n, count in numbers.items())
        yield f"\n{measured}: {len(own)} records (joints: {shares}), {refused} refused\n"
        yield from table([row for line in own for row in line["rows"]])
        known = [row for line in own for row in line["rows"] if row["verdict"] != UNKNOWN]
        largest = max((abs(row["score"]) for row in known), default=0.0)
        times = {n: [line["seconds"] for line in own if line["joints"] == n and "seconds" in line] for n in numbers}
        medians = ", ".join(f"{np.median(each):.1f} s ({n})" for n, each in times.items() if each)
        longest = max((each for own in times.values() for each in own), default=0.0)
        yield f"\nlargest error: {largest:.1f} standard deviations"
        yield f"median time (joints): {medians}; longest: {longest:.0f} s"


def summary(line: Row) -> str:
    """Return one line about a case."""
    outside = ", ".join(f"{row['name']} {row['score']:.1f}" for row in line["rows"] if not row["inside"])
    found = line.get("error") or f"{line['seconds']:.1f} s; outside: {outside or 'none'}"
    return f"{line['measured']} n={line['joints']} seed {line['seed']}: {found}"


def finished(file: Path) -> list[Row]:
    """Return the results in a file; the last line may have been cut off when the study was killed."""
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    return [json.loads(line) for line in lines if line.endswith("}")]


def main() -> None:
    """Run what is missing of the study, and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=30, help="of each number of joints and kind of measurement")
    parser.add_argument("--joints", type=int, nargs="+", default=[1, 2, 3, 4, 5, 6, 7])
    parser.add_argument("--measured", choices=MEASURED, nargs="+", default=["both"])
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("coverage.jsonl"))
    options = parser.parse_args()
    lines = finished(options.out)
    done = {(line["measured"], line["joints"], line["seed"]) for line in lines}
    keys = product(options.measured, options.joints, range(FIRST, FIRST + options.cases))
    missing = [key for key in keys if key not in done]
    with Pool(options.processes) as pool, options.out.open("w", encoding="utf-8") as out:
        out.writelines(f"{json.dumps(line)}\n" for line in lines)
        for k, line in enumerate(pool.imap_unordered(identified, missing), 1):
            print(json.dumps(line), file=out, flush=True)
            print(f"{k}/{len(missing)} {summary(line)}", flush=True)
            lines.append(line)
    print("\n".join(report(lines)))


if __name__ == "__main__":
    main()
