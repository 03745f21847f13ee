# SPDX-License-Identifier: Apache-2.0
"""Ctrl-C ends a command wherever it finds its main thread."""

from __future__ import annotations

import os
import signal
import threading

import pytest

from fjr_msgs_py.console.ending import stoppable
from time_limits import HANG


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_sets_the_event_where_the_main_thread_holds_its_lock(number: signal.Signals) -> None:
    """The lock is held for a part of each `wait`: half of the signals during a loop of waits would end nothing."""
    before = signal.getsignal(number)
    with stoppable() as stop:
        with stop._cond:
            os.kill(os.getpid(), number)
            assert signal.getsignal(number) is not before  # by now Python has called the handler
        assert stop.wait(HANG)
    assert signal.getsignal(number) is before


def test_without_a_signal_nothing_is_set_and_no_thread_stays() -> None:
    with stoppable() as stop:
        assert "signals" in [each.name for each in threading.enumerate()]
    for each in threading.enumerate():
        if each.name == "signals":
            each.join(HANG)
            assert not each.is_alive()
    assert not stop.is_set()
