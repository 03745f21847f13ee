# SPDX-License-Identifier: Apache-2.0
"""The native loops answer while another thread holds Python's lock (GIL), from the first state on.

Other Python threads hold it for milliseconds, NumPy and imports for longer. Here it is held until a number of further
states has been answered: a loop that waited for Python would never answer them. States are counted, not timed.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from design.exports.c_program import built
from nodes.harness import PATIENCE, Ros, stamped
from nodes.managed import Manager
from time_limits import HANG

HELD, EARLY, LATER = 300, 1500, 3000  # states: of a hold, of the first and the later instants
Hold = Callable[[Any, int], bool]


@pytest.fixture(scope="module")
def hold(tmp_path_factory: pytest.TempPathFactory) -> Hold:
    """Hold the GIL until a loop has answered a number of states in total; return whether it did."""
    source = Path(__file__).with_name("hold_gil.c")
    library = built(("cc", "-shared", "-fPIC", "-O1"), [source], tmp_path_factory.mktemp("gil") / "hold_gil.so")
    holding = ctypes.PyDLL(str(library)).hold_gil  # unlike CDLL, PyDLL does not release the GIL
    holding.argtypes = [ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64]

    def until(loop: Any, answered: int) -> bool:
        ffi = loop.program.ffi
        address = int(ffi.cast("uintptr_t", ffi.addressof(loop._struct, "answered")))
        return bool(holding(address, answered, round(1000 * HANG / 20)))

    return until


@pytest.mark.parametrize("lockstep", [True, False], ids=["lock-step", "real time"])
def test_every_state_is_answered_while_the_lock_is_held(ros: Ros, hold: Hold, lockstep: bool) -> None:
    rng = np.random.default_rng(0)
    early, later = rng.integers(1, EARLY, 4), rng.integers(EARLY, LATER, 2)
    node = ros.controller(executor="native", compile=True, use_sim_time=lockstep)
    ros.plant(executor="native", compile=True, lockstep=lockstep, command_timeout=PATIENCE)
    loop = node._control._command_loop
    for instant in sorted([*early, *later]):
        ros.until(lambda instant=instant: loop._struct.answered >= instant, f"state {instant}")
        assert hold(loop, loop._struct.answered + HELD), f"no states were answered after state {instant}"
    assert node.state == "active"
    assert loop._struct.received - loop._struct.answered in (0, 1)  # the newest may be on its way


def test_the_first_state_is_answered_while_the_lock_is_held(ros: Ros, hold: Hold) -> None:
    manager = Manager(ros)
    node = manager.controller(executor="native", compile=True)
    loop = node._control._command_loop
    manager.state_publisher.publish(stamped(0.0))
    assert hold(loop, 1)
