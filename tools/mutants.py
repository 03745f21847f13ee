# SPDX-License-Identifier: Apache-2.0
"""Change one operator or number at a time in model, law, control step and certificate, and see whether a test fails.

. ros2_ws/install/setup.sh && .venv/bin/python tools/mutants.py [SECONDS [SIZE [SEED]]]

A uniform sample of SIZE mutants, in an order that SEED fixes, is tried in a copy of fjr_core by the tests of TESTS.
A mutant is killed if a test fails, survived if all pass, unfinished after SECONDS of the processor. Each result is
added to build/mutants.tsv with the last test. The next run continues there and repeats what is unfinished. Remove the
file after a change of fjr_core, or a line to try its mutant again; a line may get a word of yours, as equivalent.

Tests that killed mutants near by come first. Tests are collected once for all mutants of C, which is read when a test
runs. The library is compiled with -O0, and hypothesis shrinks no example. None of this changes which test fails; at the
end, those that killed a mutant have to pass without one.
"""

from __future__ import annotations

import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
from ast import literal_eval
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import casadi  # noqa: F401  # loaded once, for all mutants
import hypothesis
import pytest
from scipy.stats import binomtest

ROOT = Path(__file__).resolve().parents[1]
SOURCES, BUILD = ROOT / "ros2_ws" / "src", ROOT / "build"
CORE, LOG, COMPILER = SOURCES / "fjr_core" / "fjr_core", BUILD / "mutants.tsv", BUILD / "mutants" / "cc"
LONGEST, SIZE, SEED = 300, 300, 25  # s of the processor for a mutant; all take an hour or more
ENDED = (-signal.SIGXCPU, -signal.SIGTERM, -signal.SIGKILL)  # exit codes of tests that something else ended
STEP = " ".join(f"tracking/test_{name}.py" for name in ("limits", "observer", "transitions", "stamps", "stop_damping"))
STEP += " core/monitoring/test_contact.py tracking core/monitoring core/runtime core/extensions"
TESTS = {
    "model/*.py": "core/model core/law core/urdf core/simulation core/config nodes/test_simulated_robot.py core/robust "
    "design/tuning/test_equal_bandwidth.py engines/test_engines.py design/batch",
    "law/*.py": "core/law core/model core/extensions core/simulation design/baselines "
    "design/tuning/test_equal_bandwidth.py core/robust design/stability",
    "monitoring/certificate.py": "core/monitoring core/runtime/test_certificate.py",
    "runtime/control_step.py": STEP,
    "runtime/[!w]*.c": STEP,
    "runtime/wiring*.c": "core/runtime/test_wiring_rows.py system/test_wiring_faults.py core/runtime/test_step.py "
    "tracking",
}
SAME = re.compile(r'""".*?"""|"[^"\n]*"|\'[^\'\n]*\'|/\*.*?\*/|^ *[@#](?!define)[^\n]*|(?<= )#[^\n]*', re.S | re.M)
SWAPPED = {"+": "-", "*": "/", "<": "<=", ">": ">=", "==": "!=", "and": "or", "&&": "||", "+=": "-=", "is": "is not"}
SWAPPED |= {new: old for old, new in SWAPPED.items()} | {"@": "*", "not": "", "True": "False", "False": "True"}
OPERATOR = re.compile(r"(?<= )(?:is not|and|or|is|&&|\|\||[<>=!+-]=|[-+*/@<>])(?= )|\bnot(?= )|\bTrue\b|\bFalse\b")
NUMBER = re.compile(r"(?<![\w.])\d+(?:\.\d+)?(?:e-?\d+)?(?![\w.])")


class Mutant(NamedTuple):
    """A file of fjr_core with another text at one place; name: file, row and column, change."""

    file: Path
    tests: str
    name: tuple[str, str, str]
    text: str

    @property
    def is_open(self) -> bool:
        """Whether the mutant has not been tried, or not to the end."""
        return logged().get(self.name, ["unfinished"])[0] == "unfinished"


def mutants(file: Path, tests: str) -> Iterator[Mutant]:
    """Yield all mutants of a file: operators are exchanged, numbers one larger."""
    text = file.read_text(encoding="utf-8")
    code = SAME.sub(lambda found: re.sub(r"[^\n]", " ", found[0]), text)
    changes = [(found, SWAPPED[found[0]]) for found in OPERATOR.finditer(code) if found[0] in SWAPPED]
    changes += [(found, str(literal_eval(found[0]) + 1)) for found in NUMBER.finditer(code)]
    for found, new in changes:
        place = f"{text.count(chr(10), 0, found.start()) + 1}:{found.start() - text.rfind(chr(10), 0, found.start())}"
        name = str(file.relative_to(CORE)), place, f"{found[0]} -> {new}"
        yield Mutant(file, tests, name, text[: found.start()] + new + text[found.end() :])


def logged() -> dict[tuple[str, ...], list[str]]:
    """Return outcome and last test of each mutant by its name."""
    rows = (line.split("\t") for line in LOG.read_text(encoding="utf-8").splitlines())
    return {tuple(row[:3]): row[3:] for row in rows}


def log(mutant: Mutant, end: str, test: str) -> None:
    """Add an outcome with the last test."""
    with LOG.open("a", encoding="utf-8") as file:
        print(*mutant.name, end, test, sep="\t", file=file)


class Trial:
    """Plugin of pytest: try each mutant by the collected tests, in a copy of this process."""

    def __init__(self, folder: Path, mutants: Sequence[Mutant]) -> None:
        self.folder, self.mutants, self.note = folder, mutants, folder / "test.txt"

    @pytest.hookimpl(trylast=True)
    def pytest_configure(self) -> None:
        """Let hypothesis stop at the first example that fails."""
        phases = (hypothesis.Phase.explicit, hypothesis.Phase.generate)
        hypothesis.settings.register_profile("mutants", hypothesis.settings(), phases=phases)
        hypothesis.settings.load_profile("mutants")

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        """Add the outcome of each mutant to the log; return None in its process, which goes on with the tests."""
        from fjr_core.numerics.jit import source_digest

        source_digest()  # the key of functions of Python code, which changes in C do not concern
        for mutant in (each for each in self.mutants if each.is_open):
            place(mutant, self.folder)
            self.note.write_text("", encoding="utf-8")
            if not (child := os.fork()):
                os.setsid()
                session.items[:] = nearest(mutant, session.items)
                return None
            code = exit_code(child, partial(os.killpg, child, signal.SIGKILL))
            end = "survived" if code == 0 else "unfinished" if code in ENDED else "killed"
            log(mutant, end, self.note.read_text(encoding="utf-8"))
        return True

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Note which test runs."""
        self.note.write_text(nodeid, encoding="utf-8")


def place(mutant: Mutant, folder: Path) -> None:
    """Write fjr_core with a change to a folder."""
    shutil.copytree(CORE, folder / CORE.name, dirs_exist_ok=True)
    (folder / CORE.name / mutant.name[0]).write_text(mutant.text, encoding="utf-8")


def nearest(mutant: Mutant, tests: Sequence[pytest.Item]) -> list[pytest.Item]:
    """Begin with tests that killed mutants near by, then those that killed most, then as TESTS lists them."""
    row, listed = int(mutant.name[1].partition(":")[0]), mutant.tests.split()
    kills, distance = Counter[str](), defaultdict[str, float](lambda: float("inf"))
    for (file, place, _), (end, test) in logged().items():
        if end == "killed" and file == mutant.name[0]:
            distance[test] = min(distance[test], abs(int(place.partition(":")[0]) - row))
        kills[test] += end == "killed"
    order = {item: [item.nodeid.startswith(f"tests/{each}") for each in listed].index(True) for item in tests}
    return sorted(tests, key=lambda item: (distance[item.nodeid], -kills[item.nodeid], order[item]))


def exit_code(child: int, end: Callable[[], None]) -> int:
    """Wait for a process; return its exit code; end what is left, also if this process is to end."""
    try:
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    finally:
        with suppress(ProcessLookupError):
            end()


def tested(folder: Path, tests: Sequence[str], longest: int, *plugins: Trial) -> int:
    """Run pytest with the fjr_core in a folder, in a process of its own; return its exit code."""
    if child := os.fork():
        return exit_code(child, partial(os.kill, child, signal.SIGTERM))
    resource.setrlimit(resource.RLIMIT_CPU, (longest, resource.RLIM_INFINITY))
    output = os.open(folder / "output.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(output, 1)
    os.dup2(output, 2)
    path = [str(folder), *map(str, SOURCES.iterdir())]
    sys.path[:0], sys.dont_write_bytecode, tempfile.tempdir = path, True, None
    os.environ |= {
        "PYTHONPATH": os.pathsep.join([*path, os.environ["PYTHONPATH"]]),  # entry points last
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
        "TMPDIR": str(folder),
        "PATH": os.pathsep.join([str(COMPILER.parent), os.environ["PATH"]]),
    }
    options = ["-x", "-q", "-m", "not full", "-p", "timeout", "-p", "hypothesispytest", "-p", "no:cacheprovider"]
    os._exit(pytest.main([*options, *tests], plugins))


def main() -> None:
    """Try what is left of the sample; print the share of killed mutants with its 95 % interval (Clopper-Pearson)."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that `finally` ends the tests
    os.chdir(ROOT)
    given = [int(word) for word in sys.argv[1:]]
    longest, size, seed = given + [LONGEST, SIZE, SEED][len(given) :]
    every = [m for p, tests in TESTS.items() for file in sorted(CORE.glob(p)) for m in mutants(file, tests)]
    sample, together = random.Random(seed).sample(every, size), defaultdict[object, list[Mutant]](list)
    for mutant in sample:
        together[mutant.tests if mutant.file.suffix == ".c" else mutant].append(mutant)
    COMPILER.parent.mkdir(parents=True, exist_ok=True)
    COMPILER.write_text(f'#!/bin/bash\nexec {shutil.which("cc")} "${{@/#-O3/-O0}}"\n', encoding="utf-8")
    COMPILER.chmod(0o755)
    LOG.touch()
    with tempfile.TemporaryDirectory(prefix="fjr-mutants-") as name:
        folder = Path(name)
        for group in together.values():
            if left := [mutant for mutant in group if mutant.is_open]:
                place(left[0], folder)  # Python is read when the tests are collected
                tests = [f"tests/{each}" for each in left[0].tests.split()]
                code = tested(folder, tests, longest, Trial(folder, left))
                if code and (left[0].file.suffix == ".c" or code in (pytest.ExitCode.USAGE_ERROR, *ENDED)):
                    sys.exit((folder / "output.txt").read_text(encoding="utf-8"))
                if code:
                    log(left[0], "killed", "")  # no test can be collected
        results = [logged()[mutant.name] for mutant in sample]
        killers = {test for end, test in results if end == "killed"} - {""}
        shutil.copytree(CORE, folder / CORE.name, dirs_exist_ok=True)
        if tested(folder, sorted(killers), size * longest):
            sys.exit((folder / "output.txt").read_text(encoding="utf-8"))
    ends = Counter(end for end, _ in results)
    low, high = binomtest(ends["killed"], size).proportion_ci()
    print(f"{ends['killed'] / size:.1%} killed ({low:.1%} to {high:.1%}); {dict(ends)} of {len(every)} mutants")


if __name__ == "__main__":
    main()
