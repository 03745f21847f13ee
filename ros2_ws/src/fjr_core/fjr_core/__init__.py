# SPDX-License-Identifier: Apache-2.0
"""Virtual differential passivity based tracking control of flexible-joint robots (v-dPBC), without ROS.

    import fjr_core as fjr
    robot = fjr.single_link(stiffness=31.0)
    law = fjr.TrackingLaw(robot, fjr.PAPER_GAINS)
    run = fjr.simulate(fjr.Plant(robot), law, fjr.Sine(1.0, 1.0), robot.state(0.5, 0.5, 0, 0), 5.0)

Paper: R. Reyes-Baez, A. van der Schaft, B. Jayawardhana, "Virtual Differential Passivity based Control for
Tracking of Flexible-joints Robots", IFAC LHMNC 2018. Equation numbers in docstrings are its.
"""

import re
from pathlib import Path
from typing import Any

from .version import __version__ as __version__

_STUB = Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")
_HOME = {name: module for module, name in re.findall(r"^from (\S+) import (\w+) as \2$", _STUB, re.MULTILINE)}
"""Public names and their modules, from the stub that type checkers read, as in SPEC 1 of Scientific Python."""
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    """Return the object of a public name, whose module is imported when the name is used (PEP 562).

    Raises MissingPackageError if the name is one of another package, which is not installed.
    """
    if name not in _HOME:
        raise AttributeError(f"module 'fjr_core' has no attribute {name!r}")
    from .files import importing

    home = re.sub(r"^\.", "fjr_core.", _HOME[name])
    found = getattr(importing.module(home), name, None) or importing.module(f"{home}.{name}")  # a name may be a module
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted(__all__)
