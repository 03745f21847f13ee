# SPDX-License-Identifier: Apache-2.0
"""Change one operator or number at a time in model, law, control step and certificate, and see whether a test fails.

. ros2_ws/install/setup.sh && .venv/bin/python tools/mutants.py [SECONDS [SIZE [SEED]]]

A uniform sample of SIZE mutants, in an order that SEED fixes, is tried in a copy of fjr_core by the tests of TESTS.
Results are added to build/mutants.tsv; the next run continues there, and repeats what took longer than SECONDS.
"""

from __future__ import annotations

import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from ast import literal_eval
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from scipy.stats import binomtest

ROOT = Path(__file__).resolve().parents[1]
SOURCES, LOG = ROOT / "ros2_ws" / "src", ROOT / "build" / "mutants.tsv"
LONGEST, SIZE, SEED = 300, 300, 25  # s of one mutant; all take an hour or more
STEP = " ".join(f"core/runtime/test_{name}.py" for name in ("step", "reference", "certificate", "measurement"))
STEP += " core/monitoring tracking"
TESTS = {
    "model/*.py": "core/model core/law core/urdf core/simulation core/robust core/config design/batch "
    "engines/test_engines.py nodes/test_simulated_robot.py",
    "law/*.py": "core/law core/extensions core/model/test_springs.py core/simulation design/baselines design/stability",
    "monitoring/certificate.py": "core/monitoring core/runtime/test_certificate.py",
    "runtime/control_step.py": STEP,
    "runtime/[!w]*.c": STEP,
    "runtime/wiring*.c": "core/runtime/test_step.py system/test_wiring_faults.py nodes/test_wiring.py "
    "tracking/test_dead_sources.py",
}
SAME = re.compile(r'""".*?"""|"[^"\n]*"|\'[^\'\n]*\'|/\*.*?\*/|^ *[@#](?!define)[^\n]*|(?<= )#[^\n]*', re.S | re.M)
SWAPPED = {"+": "-", "*": "/", "<": "<=", ">": ">=", "==": "!=", "and": "or", "&&": "||", "+=": "-=", "is": "is not"}
SWAPPED |= {new: old for old, new in SWAPPED.items()} | {"@": "*", "not": "", "True": "False", "False": "True"}
OPERATOR = re.compile(r"(?<= )(?:is not|and|or|is|&&|\|\||[<>=!+-]=|[-+*/@<>])(?= )|\bnot(?= )|\bTrue\b|\bFalse\b")
NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.])")


def mutants(file: Path) -> Iterator[tuple[int, str, str]]:
    """Yield place, text and new text of all mutants of a file: operators are exchanged, numbers one larger."""
    code = SAME.sub(lambda found: re.sub(r"[^\n]", " ", found[0]), file.read_text(encoding="utf-8"))
    operators, numbers = OPERATOR.finditer(code), NUMBER.finditer(code)
    yield from ((found.start(), found[0], SWAPPED[found[0]]) for found in operators if found[0] in SWAPPED)
    yield from ((found.start(), found[0], str(literal_eval(found[0]) + 1)) for found in numbers)


def outcome(folder: Path, tests: str, longest: float) -> str:
    """Return killed, survived or timeout for the fjr_core in a folder; no process of the tests is left."""
    path = os.pathsep.join([str(folder), *map(str, SOURCES.iterdir()), os.environ["PYTHONPATH"]])  # entry points last
    env = os.environ | {"PYTHONPATH": path, "PYTHONDONTWRITEBYTECODE": "1", "TMPDIR": str(folder)}
    env |= {"PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    options = ["-x", "-q", "-p", "timeout", "-p", "hypothesispytest", "-p", "no:cacheprovider"]
    command = [sys.executable, "-m", "pytest", *options, *(f"tests/{name}" for name in tests.split())]
    child = subprocess.Popen(command, cwd=ROOT, env=env, stdout=subprocess.DEVNULL, start_new_session=True)
    try:
        return "killed" if child.wait(longest) else "survived"
    except subprocess.TimeoutExpired:
        return "timeout"
    finally:
        with suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)


def main() -> None:
    """Try what is left of the sample; print the share of killed mutants with its 95 % interval (Wilson)."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that `finally` ends the tests
    core, given = SOURCES / "fjr_core" / "fjr_core", [int(word) for word in sys.argv[1:]]
    longest, size, seed = given + [LONGEST, SIZE, SEED][len(given) :]
    every = [(file, tests, *m) for p, tests in TESTS.items() for file in sorted(core.glob(p)) for m in mutants(file)]
    LOG.parent.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="fjr-mutants-") as folder, LOG.open("a+", encoding="utf-8") as log:
        log.seek(0)
        results = dict(line.rstrip("\n").rsplit("\t", 1) for line in log)
        shutil.copytree(core, Path(folder, core.name))
        if failing := [tests for tests in TESTS.values() if outcome(Path(folder), tests, longest) == "killed"]:
            sys.exit(f"tests fail without a mutant: {failing}")
        for file, tests, place, old, new in random.Random(seed).sample(every, size):
            text, name = file.read_text(encoding="utf-8"), file.relative_to(core)
            row, column = text.count("\n", 0, place) + 1, place - text.rfind("\n", 0, place)
            mutant = f"{name}:{row}:{column}\t{old} -> {new}"
            if results.get(mutant, "timeout") == "timeout":
                copy = Path(shutil.copytree(core, Path(folder, core.name), dirs_exist_ok=True), name)
                copy.write_text(text[:place] + new + text[place + len(old) :], encoding="utf-8")
                results[mutant] = outcome(Path(folder), tests, longest)
                print(mutant, results[mutant], sep="\t", file=log, flush=True)
    test = binomtest(Counter(results.values())["killed"], len(results))
    low, high = test.proportion_ci(method="wilson")
    share = f"{test.k} of {test.n} killed: {test.statistic:.1%} ({low:.1%} to {high:.1%})"
    print(f"{share}; {len(every)} mutants in all")


if __name__ == "__main__":
    main()
