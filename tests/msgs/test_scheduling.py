# SPDX-License-Identifier: Apache-2.0
"""What a node says when the system refuses real-time scheduling."""

from __future__ import annotations

import os

import pytest

from fjr_msgs_py.scheduling import take_priority


def test_zero_asks_for_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_setscheduler", lambda *_: pytest.fail("asked"))
    assert take_priority(0) == ""


def test_a_refusal_is_one_sentence_that_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    sentence = take_priority(50)
    assert "realtime_priority 50 is refused" in sentence
    assert "rtprio" in sentence
    assert "\n" not in sentence
