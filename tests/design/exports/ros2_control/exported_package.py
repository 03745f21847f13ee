# SPDX-License-Identifier: Apache-2.0
"""Export packages for ros2_control, compile them against the stand-ins and run their driver."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from design.exports.c_program import C99, CPP, built, program_output
from fjr_core.config.scenario import Scenario
from fjr_design.exports.project import write
from fjr_design.exports.ros2_control.package import export_package, package_name_of

HERE = Path(__file__).parent
SOURCES = ("tracking_controller", "reports", "parameters", "elastic_arm")


def exported(scenario: Scenario, folder: Path, samples: int = 200) -> Path:
    """Export the package of a scenario to a folder and return the folder."""
    write(export_package(scenario, package_name_of(scenario.name), samples), folder)
    return folder


def step_objects(folder: Path) -> list[Path]:
    """Compile the control step of a package as C99 with warnings as errors."""
    sources = [folder / "step" / f"{name}.c" for name in ("control_step", "model", "casadi")]
    return [built(C99, [source], source.with_suffix(".o"), "-c") for source in sources]


def driver(folder: Path, package: str) -> Path:
    """Compile both plugins against the stand-ins, with warnings as errors, and link them to the driver."""
    return linked(folder, package, SOURCES, HERE / "drive.cpp")


def linked(folder: Path, package: str, names: Sequence[str], main: Path) -> Path:
    """Compile sources of a package and a main program against the stand-ins; return the program."""
    where = [f"-I{each}" for each in (folder / "step", folder / "src", _headers(folder), HERE, main.parent)]
    defined = [f"-DPACKAGE={package}", f'-DCLOCK="{package}_clock"']
    sources = [*(folder / "src" / f"{name}.cpp" for name in names), main]
    objects = [built(CPP, [source], folder / f"{source.stem}.o", *where, "-c", *defined) for source in sources]
    return built(CPP, [*objects, *step_objects(folder)], folder / main.stem)


def replayed(folder: Path, package: str) -> tuple[int, int]:
    """Replay the recorded samples of a package; return their number and that of the different efforts."""
    main = folder / "main.cpp"
    main.write_text(
        f'#include "step_replay.hpp"\n#include <cstdio>\nint main(int, char ** v) {{\n'
        f'  const auto r = {package}::replay(v[1]);\n  std::printf("%d %d\\n", r.samples, r.different);\n}}\n'
    )
    program = built(CPP, [main, *step_objects(folder)], folder / "main", f"-I{folder / 'test'}", f"-I{folder / 'step'}")
    samples, different = program_output(program, str(folder / "test" / "case.txt")).split()
    return int(samples), int(different)


def values(output: str) -> dict[str, float]:
    """Return the numbers of the driver's output by name."""
    pairs = (line.split() for line in output.splitlines())
    return {pair[0]: float(pair[1]) for pair in pairs if len(pair) == 2 and re.fullmatch(r"[-+.\dinfae]+", pair[1])}


def _headers(folder: Path) -> Path:
    """Write the headers that the plugins include; each is the file of the stand-ins."""
    texts = [path.read_text() for path in (folder / "src").iterdir()]
    for name in set(re.findall(r"#include <(\w+/[\w/]+\.hpp)>", "".join(texts))):
        (folder / "stand_ins" / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / "stand_ins" / name).write_text('#include "stand_ins.hpp"\n')
    return folder / "stand_ins"
