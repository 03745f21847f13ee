# SPDX-License-Identifier: Apache-2.0
"""`fjr watch` without a terminal: data it collects, text it renders, topics of real nodes it receives."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable

import pytest
from rclpy.node import Node
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from fjr_monitor.watch.app import FjrWatch
from fjr_monitor.watch.state import JointLine, LoopEvent, LoopTiming, NodeHealth, View, Watched
from fjr_monitor.watch.terminal import log_bar, signed_bar, sparkline
from fjr_msgs_py.node.reports import labelled
from nodes.harness import Ros
from watch_text import text

MS = 1_000_000  # ns
NAN = float("nan")

FULL = View(
    title="fjr watch /left",
    joints=(
        JointLine("joint1", 0.5, -0.25, 0.01, -2e-4, -88.0, 176.0, 120.0),
        JointLine("joint2", 1.0, 0.0, None, None, 3.0, None, 6.0),
    ),
    silence=0.01,
    timing=LoopTiming(999.6, (1e-3, 1.1e-3, 2e-3), (2e-4, 3e-4, 4e-4), 2),
    certificate={
        "stamp sec": 1.0,
        "V": 0.125,
        "dV_predicted": -2.5,
        "dV_measured": -2.4,
        "bound": 0.25,
        "H": float("nan"),
    },
    history=(1.0, 0.1, 0.01),
    health=(
        NodeHealth("fjr_controller", 0, "ok", "tracking"),
        NodeHealth("fjr_controller: certificate", 2, "violated: delay"),
        NodeHealth("fjr_plant", 1, "states lost"),
    ),
    events=(LoopEvent(3.25, 1, "holds", "the reference stands still"),),
    missing=("/left/robot_description",),
)


@pytest.mark.parametrize("width", [80, 120])
def test_view_is_complete_at_any_width_and_long_names_truncate_no_value(width: int) -> None:
    said = text(FULL, width)
    for words in (
        "fjr watch /left   999.6 states/s",
        "joint1",
        " 0.2 ",
        "-88.000",
        "50 %",
        "peak 6",
        "V 0.125 J",
        "bound 0.25 J",
        "dV/dt measured -2.4 W",
        "H -",
        "█▅▁",
        "error fjr_controller: certificate  violated: delay",
        "ok    fjr_controller [tracking]  ok",
        "warn  fjr_plant  states lost",
        "3.2 s ago  holds  the reference stands still",
        "no publisher of /left/robot_description",
    ):
        assert words in said, words
    assert ("dq_l" in said) == (width >= 118)
    long = [dataclasses.replace(each, name=f"left_shoulder_of_the_arm_{each.name}") for each in FULL.joints]
    truncated = text(dataclasses.replace(FULL, joints=tuple(long)), width)
    for words in ("left_sh", "+0.5000", " 0.2 ", "-88.000", "of limit", "50 %", "peak 6"):
        assert words in truncated, words
    for screen in (said, truncated):
        assert max(map(len, screen.splitlines())) <= width
        assert "…" not in screen


def test_missing_data_are_reported() -> None:
    assert "waiting for joint states" in text(View("t"))
    assert "no certificate received" in text(View("t"))
    assert "no state for 2.5 s" in text(dataclasses.replace(FULL, silence=2.5))


def test_a_bound_that_has_vanished_is_not_shown_as_a_number_and_lines_fit_a_narrow_terminal() -> None:
    certificate = {**(FULL.certificate or {}), "bound": 4.2e-88}
    shown = text(dataclasses.replace(FULL, certificate=certificate, history=tuple(0.8**k for k in range(90))))
    assert "bound below 1e-20 J" in shown
    assert "e-88" not in shown


def test_bars_show_decades_of_errors_and_the_sign_of_efforts_up_to_the_limit() -> None:
    for value, bar in ((0.0, "    "), (1e-7, "    "), (1e-6, "    "), (1e-3, "██  "), (1.0, "████"), (50.0, "████")):
        assert log_bar(value, 4) == bar
    for value, bar in ((0.0, "   │   "), (-10.0, "███│   "), (5.0, "   │██ "), (1e9, "   │███"), (NAN, "   │   ")):
        assert signed_bar(value, 10.0, 7) == bar
    assert sparkline((1.0, 1e-7), 10) == "█▁"
    assert sparkline((1.0, 1.0, 0.0), 2) == "█▁"
    assert sparkline((1.0, 0.99), 2) == "██", "less than a decade is a low bar"
    assert sparkline((), 5) == ""


def test_names_and_sentences_of_other_nodes_do_not_steer_the_terminal() -> None:
    evil = "a\x1b[2J\x1b]0;title\x07\x9b2Jé"
    view = View("t", (JointLine(evil, 0.0),), health=(NodeHealth(evil, 1, evil, evil),))
    shown = text(dataclasses.replace(view, events=(LoopEvent(1.0, 1, evil, evil),)), 120)
    assert shown.count("a?[2J?]0;title??2Jé") == 6
    assert not re.search(r"[\x00-\x09\x0b-\x1f\x7f-\x9f]", shown)


def received(times: Iterable[tuple[int, int]], ahead: int = 0, delay: int = 50_000) -> list[tuple[int, int, int]]:
    """Return stamps and send times [ns] with receive times `delay` later; ahead [ns]: of the sender's clock."""
    return [(stamp, time + ahead, time + delay) for stamp, time in times]


@pytest.mark.parametrize("ahead", [5000 * MS, -5000 * MS, 2 * MS])
def test_the_latency_does_not_depend_on_the_clock_of_the_controllers_machine(ahead: int) -> None:
    watched, sent = Watched("t"), [(k * MS, k * MS + 100) for k in range(1, 5001)]
    for some in (sent[:700], sent[700:]):
        watched.sent(received(some))
        watched.answered(received(((stamp, time + 200_000) for stamp, time in some), ahead))
    assert watched.view(5.0).timing.latency == pytest.approx((2e-4, 2e-4, 2e-4))


def test_on_one_machine_the_latency_does_not_depend_on_the_delays_to_the_watching_process() -> None:
    watched, sent = Watched("t"), [(k * MS, k * MS + 100) for k in range(1, 101)]
    watched.sent(received(sent))
    watched.answered(received(((stamp, time + 200_000) for stamp, time in sent), delay=300_000))
    assert watched.view(5.0).timing.latency == pytest.approx((2e-4, 2e-4, 2e-4))


def test_timing_covers_the_last_seconds() -> None:
    watched = Watched("t")
    sent = [(k * MS, k * MS + 100) for k in range(1, 5001)]
    watched.sent(received(sent))
    watched.answered(received((stamp, time + 200_000) for stamp, time in sent if stamp % (100 * MS)))
    timing = watched.view(5.0).timing
    assert timing is not None
    assert timing.rate == pytest.approx(1000.0)
    assert timing.period == pytest.approx((1e-3, 1e-3, 1e-3))
    assert timing.latency == pytest.approx((2e-4, 2e-4, 2e-4))
    assert timing.unanswered == 20


def test_only_states_after_the_first_answer_that_was_heard_count_as_unanswered() -> None:
    """The commands may be matched later than the states; a controller that ends leaves its states unanswered."""
    watched = Watched("t")
    watched.sent(received((k * MS, k * MS) for k in range(1000)))
    assert watched.view(1.0).timing.unanswered == 0, "no controller was heard"
    watched.answered(received((k * MS, k * MS + 200_000) for k in range(600, 1000)))
    assert watched.view(1.0).timing.unanswered == 0
    watched.sent(received((k * MS, k * MS) for k in range(1000, 6001)))
    timing = watched.view(6.0).timing
    assert (timing.latency, timing.unanswered) == (None, 2000)
    watched.state(6.0, {"a": 0.0}, {"a": 0.0})
    assert "unanswered 2000" in text(watched.view(6.0), 120)


@pytest.mark.parametrize("states", [0, 100])
def test_commands_without_states_fill_no_memory(states: int) -> None:
    """A robot that is not seen, or has died, beside a controller that goes on."""
    watched = Watched("t")
    watched.sent(received((k * MS, k * MS) for k in range(states)))
    for begin in range(0, 60_000, 100):
        watched.answered(received((k * MS, k * MS + 200_000) for k in range(begin, begin + 100)))
    assert len(watched._answered) <= 4100


def test_a_clock_that_is_set_back_restarts_the_timing() -> None:
    watched, hour = Watched("t"), 3_600_000 * MS
    watched.sent(received((k * MS, hour + k * MS) for k in range(100)))
    watched.sent(received((k * MS, k * MS) for k in range(100, 5000)))
    timing = watched.view(5.0).timing
    assert timing.rate == pytest.approx(1000.0)
    assert timing.period == pytest.approx((1e-3, 1e-3, 1e-3))
    assert len(watched._sent) < 2100


def test_repeated_state_counts_once_and_a_reset_restarts_the_timing() -> None:
    watched = Watched("t")
    watched.sent(received([(10 * MS, 1), (10 * MS, 50 * MS), (11 * MS, 51 * MS)]))
    assert watched.view(0.0).timing.period[2] == pytest.approx(0.051, rel=1e-3)
    watched.sent(received([(1 * MS, 100 * MS), (2 * MS, 101 * MS)]))
    assert watched.view(0.0).timing.period == pytest.approx((1e-3, 1e-3, 1e-3))


def test_joints_are_shown_with_errors_efforts_and_limits() -> None:
    watched = Watched("t", {"b": 2.0})
    assert watched.view(0.0).silence is None
    watched.state(1.0, {"a": 0.1, "b": 0.2, "a_motor": 0.3, "c_motor": 1.0}, {"a": 1.0})
    watched.error({"a": 1e-3})
    watched.effort({"a": -4.0, "b": 1.0})
    watched.effort({"a": 1.0, "b": 1.0})
    limits = "".join(f'<joint name="{name}"><limit effort="{n}"/></joint>' for name, n in (("a", 8), ("b", 9)))
    watched.description(f"<robot>{limits}</robot>")
    view = watched.view(1.5)
    assert view.silence == 0.5
    a, b, motor = view.joints
    assert a == JointLine("a", 0.1, 1.0, pytest.approx(0.2), 1e-3, 1.0, 8.0, 4.0)
    assert (b.limit, b.deflection, b.velocity, b.error) == (2.0, None, None, None)
    assert motor.name == "c_motor", "without a joint c, c_motor is a joint name"


@pytest.mark.parametrize("urdf", ["", "<robot", "<robot><joint name='a'><limit effort='many'/></joint></robot>"])
def test_invalid_description_gives_no_limits(urdf: str) -> None:
    watched = Watched("t")
    watched.state(0.0, {"a": 0.0}, {})
    watched.description(urdf)
    assert watched.view(0.0).joints[0].limit is None


def test_silent_node_is_stale() -> None:
    watched = Watched("t")
    watched.health(1.0, NodeHealth("fjr_plant", 0, "ok"))
    assert watched.view(2.0).health[0].level == 0
    assert watched.view(9.0).health[0] == NodeHealth("fjr_plant", 3, "no diagnostics for 8 s; the last: ok")


def array(labels: list[str], data: list[float]) -> Float64MultiArray:
    message = Float64MultiArray(data=data)
    message.layout.dim = [MultiArrayDimension(label=label, size=1, stride=1) for label in labels]
    return message


def test_labels_assign_values_one_by_one_or_as_a_list() -> None:
    for labels in (["V", "H"], ["V,H"]):
        assert labelled(array(labels, [1.0, 2.0])) == {"V": 1.0, "H": 2.0}
    for labels in (["V, H"], []):  # not as many as values
        assert labelled(array(labels, [1.0])) == {}


def test_plant_and_controller_are_found_under_any_names(ros: Ros) -> None:
    rules = ["--ros-args", "-r", "__ns:=/left", "-r", "joint_states:=/robot/states"]
    watched = Watched("t")
    node = ros.add(Node("watch", context=ros.context, cli_args=rules))
    watch = FjrWatch(node, watched)
    for arguments in (None, rules):
        ros.plant(arguments=arguments, publish_rate=250.0)
        ros.controller(arguments=arguments)

    def complete() -> bool:
        watch.listen(0.0)
        view = watched.view(0.0)
        seen = view.joints and view.joints[0].error is not None and view.joints[0].effort is not None
        nodes = {status.name for status in view.health}
        return bool(seen and view.timing and view.timing.latency and {"left/fjr_plant", "left/fjr_controller"} <= nodes)

    ros.until(complete, "states, answers, errors and reports")
    (joint,) = watched.view(0.0).joints
    assert joint.name == "joint1"
    assert joint.position is not None
    assert joint.peak > 0
    assert all(status.name.startswith("left/") for status in watched.view(0.0).health), "no data of the other robot"
    assert set(watch.missing()) <= {"/left/fjr_controller/certificate"}
