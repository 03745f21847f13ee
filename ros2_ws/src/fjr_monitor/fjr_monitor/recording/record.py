# SPDX-License-Identifier: Apache-2.0
"""`fjr record`: record topics into an MCAP bag until Ctrl-C, without ros2cli."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

from fjr_core.errors import FjrError
from fjr_monitor.recording.echo import absolute
from fjr_monitor.recording.recorder import Recorder
from fjr_monitor.recording.run_folder import FolderError
from fjr_msgs_py.console.output import Result

POLL = 0.05  # s


class RecordError(FjrError):
    """The recorder failed."""


def record(topics: Sequence[str], folder: Path | None, duration: float | None, stop: threading.Event) -> Result:
    """Record the named topics, or all, for `duration` [s] or until `stop`; return what was recorded.

    folder: new folder of the bag; None: one named after the time. Raise FjrError.
    """
    wanted = [absolute(topic) for topic in topics]
    folder = folder or Path(f"bag_{datetime.now():%Y_%m_%d-%H_%M_%S}")
    if folder.exists():
        raise FolderError(f"{folder} exists: not overwritten; expected the name of a new folder")
    what = ", ".join(wanted) or "all topics"
    end = "Ctrl-C ends" if duration is None else f"for {duration:g} s"
    print(f"fjr: records {what} into {folder}; {end}", file=sys.stderr, flush=True)
    with Recorder(folder, topics=wanted) as recorder:
        _wait(recorder, duration, stop)
    return _summary(recorder, wanted, folder)


def _wait(recorder: Recorder, duration: float | None, stop: threading.Event) -> None:
    end = None if duration is None else time.monotonic() + duration
    while not recorder.loss and not stop.wait(POLL) and (end is None or time.monotonic() < end):
        if recorder.failure:
            raise RecordError(f"the recorder failed: {recorder.failure}")


def _summary(recorder: Recorder, wanted: Sequence[str], folder: Path) -> Result:
    """Return one line per topic, then missing topics and the total."""
    channels = sorted(recorder.writer.channels, key=lambda channel: channel.topic)
    lines = [f"{each.count:9} {each.topic} ({each.type_name})" for each in channels if each.count]
    recorded = {channel.topic for channel in channels if channel.count}
    lines += [f"not recorded: {topic}, {reason}" for topic, reason in sorted(recorder.skipped.items())]
    lines += [f"not complete: {recorder.loss}"] if recorder.loss else []
    lines += [f"nothing came on {topic}" for topic in wanted if topic not in recorded | set(recorder.skipped)]
    total = sum(channel.count for channel in channels)
    text = "\n".join([*lines, f"{total} messages of {len(recorded)} topics in {folder}"])
    counts = {channel.topic: channel.count for channel in channels}
    values = {"folder": folder, "messages": counts, "not_recorded": recorder.skipped, "loss": recorder.loss}
    return Result(text, values, code=1 if recorder.loss else 0)
