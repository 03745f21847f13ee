# SPDX-License-Identifier: Apache-2.0
"""Sensor and channel errors without ROS: seeded, repeatable, each error separately."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import stats

from fjr_core import ParameterError
from fjr_core.simulation.imperfections import ChannelErrors, SensorErrors
from fjr_plant.channel import COMMANDS, PERIOD, SENSORS, SPARE, STATES, Channel, SampleTimes, generator
from fjr_plant.native import plant_program
from fjr_plant.simulated_robot import NO_VELOCITIES, Sensors

MS = 1_000_000  # ns
N = 20_000
A = np.array([1.0])
CHANCE = 1e-9  # probability that a fair sequence fails a test; the seeds are fixed, so none does


def arrivals(link: Channel, pushes: int = 200) -> list[tuple[int, int]]:
    """Return (time, item) of all arrivals if item k is pushed at k ms and items are taken when due."""
    seen = []
    for k in range(pushes):
        while (due := link.next_due) is not None and due <= k * MS:
            seen += [(due, int(item)) for (item,) in link.due(due)]
        link.push(k * MS, np.array([float(k)]))
    while (due := link.next_due) is not None:
        seen += [(due, int(item)) for (item,) in link.due(due)]
    return seen


def within(count: int, probability: float, trials: int = N) -> bool:
    fair = stats.binom(trials, probability)
    return bool(min(fair.cdf(count), fair.sf(count - 1)) >= CHANCE)


# Channels.


def test_a_delay_is_exact_and_items_are_delivered_once() -> None:
    assert arrivals(Channel(ChannelErrors(delay=3.25e-3))) == [(k * MS + 3_250_000, k) for k in range(200)]
    link = Channel(ChannelErrors(delay=2e-3))
    link.push(0, A)
    assert [link.due(2 * MS - 1), link.due(2 * MS), link.due(10 * MS), link.next_due] == [[], [A], [], None]


@pytest.mark.parametrize("probability", [0.0, 0.01, 0.1, 0.5, 1.0])
def test_loss_and_duplication_have_their_probabilities(probability: float) -> None:
    lost = N - len(arrivals(Channel(ChannelErrors(delay=1e-3, loss=probability), seed=3), N))
    assert within(lost, probability)
    more = len(arrivals(Channel(ChannelErrors(delay=1e-3, repetition=probability), seed=3), N)) - N
    assert within(more, probability)


def test_losses_are_independent() -> None:
    """Two consecutive items are both lost with the product of their probabilities."""
    kept = {item for _, item in arrivals(Channel(ChannelErrors(loss=0.3), seed=5), N)}
    pairs = sum(k not in kept and k + 1 not in kept for k in range(0, N, 2))
    assert within(pairs, 0.09, N // 2)


def test_jitter_is_uniform() -> None:
    late = [due - item * MS for due, item in arrivals(Channel(ChannelErrors(jitter=0.9e-3), seed=1), N)]
    assert min(late) >= 0
    assert max(late) <= 900_000
    assert stats.kstest(late, stats.uniform(0, 900_000).cdf).pvalue > 1e-6


def test_jitter_preserves_the_order_unless_reordering_is_allowed() -> None:
    errors = ChannelErrors(delay=1e-3, jitter=5e-3, repetition=0.2)
    kept = [item for _, item in arrivals(Channel(errors, seed=2))]
    assert kept == sorted(kept)
    mixed = [item for _, item in arrivals(Channel(replace(errors, in_order=False), seed=2))]
    assert mixed != sorted(mixed)
    assert sorted(mixed) == kept
    times = [due for due, _ in arrivals(Channel(replace(errors, in_order=False), seed=2))]
    assert times == sorted(times)


EVERYTHING = ChannelErrors(delay=2e-3, jitter=4e-3, loss=0.2, repetition=0.3, in_order=False)


def test_sequence_is_repeatable_and_differs_for_another_seed_or_stream() -> None:
    link = Channel(EVERYTHING, seed=7, stream=COMMANDS)
    first = arrivals(link)
    link.push(0, A)
    link.reset()
    assert link.next_due is None
    assert arrivals(link) == first
    assert arrivals(Channel(EVERYTHING, seed=7, stream=COMMANDS)) == first
    assert arrivals(Channel(EVERYTHING, seed=8, stream=COMMANDS)) != first
    assert len({generator(7, stream).random() for stream in (STATES, COMMANDS, SENSORS, PERIOD)}) == 4


def test_each_error_does_not_affect_the_others() -> None:
    lost = set(range(200)) - {item for _, item in arrivals(Channel(ChannelErrors(loss=0.2)))}
    late = {item: due - item * MS for due, item in arrivals(Channel(ChannelErrors(jitter=1e-3)))}
    both = arrivals(Channel(ChannelErrors(delay=5e-3, jitter=1e-3, loss=0.2)))
    assert {item for _, item in both} == set(range(200)) - lost
    assert {item: due - item * MS - 5 * MS for due, item in both} == {k: late[k] for k in late if k not in lost}
    twice = [item for _, item in arrivals(Channel(ChannelErrors(repetition=0.2)))]
    repeated = {item for item in twice if twice.count(item) == 2}
    all_of_it = [item for _, item in arrivals(Channel(ChannelErrors(loss=0.2, repetition=0.2)))]
    assert {item for item in all_of_it if all_of_it.count(item) == 2} == repeated - lost


def test_change_applies_only_to_items_pushed_later() -> None:
    slow, held_back_by_the_order, quick = (np.array([float(k)]) for k in range(3))
    link = Channel(ChannelErrors(delay=3e-3))
    link.push(0, slow)
    link.change(ChannelErrors())
    link.push(MS, held_back_by_the_order)
    link.change(ChannelErrors(in_order=False))
    link.push(2 * MS, quick)
    assert link.due(2 * MS) == [quick]
    assert link.next_due == 3 * MS
    assert link.due(3 * MS) == [slow, held_back_by_the_order]


def test_a_longer_delay_makes_place_and_more_items_than_that_are_counted_and_lost() -> None:
    link = Channel(ChannelErrors(delay=1e-3))
    for k in range(3):
        link.push(0, np.array([float(k)]))
    link.change(ChannelErrors(delay=1.0))
    for k in range(3, 3000):
        link.push(1, np.array([float(k)]))
    found = [int(item) for (item,) in link.due(2 * 10**9)]
    assert found == list(range(len(found)))
    assert (len(found), link.pointer.overflows) == (SPARE + 2000, 3000 - SPARE - 2000)


# Sample times.


def test_sample_delays_are_whole_inner_steps_and_do_not_accumulate() -> None:
    times = SampleTimes(MS, 50_000, 0.9e-3, seed=1)
    instants = np.array([0] + [times.next() for _ in range(N)])
    late = instants[1:] - MS * np.arange(1, N + 1)
    assert np.all(instants % 50_000 == 0)
    assert np.all(np.diff(instants) >= 50_000)
    assert 0 <= late.min() < late.max() <= 900_000
    counts = np.bincount(late // 50_000, minlength=18)[:18]
    assert all(within(int(count), 1 / 18) for count in counts)


def test_sample_times_repeat_after_a_reset_and_differ_for_another_seed() -> None:
    times = SampleTimes(MS, 250_000, 0.5e-3, seed=4)
    first = [times.next() for _ in range(100)]
    times.reset()
    assert [times.next() for _ in range(100)] == first
    assert [SampleTimes(MS, 250_000, 0.5e-3, seed=5).next() for _ in range(100)] != first


# Sensors.

POSITION, VELOCITY = np.array([0.3, -1.2, 0.31, -1.19]), np.array([0.5, -0.25, 0.4, 0.1])


def read(sensor: Sensors, instant: int, position: np.ndarray, velocity: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return measured positions and velocities; no velocities: (0,)."""
    program, values = plant_program(), (position.copy(), velocity.copy())
    pointers = [program.array(each) for each in values]
    program.lib.fjr_sensors_disturb(sensor.pointer, len(position) // 2, instant, *pointers)
    return values[0], values[1] if sensor.velocities else NO_VELOCITIES


def measured(sensor: Sensors, instants: int = N) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and velocities (k, 4) at k instants."""
    pairs = [read(sensor, k, POSITION, VELOCITY) for k in range(instants)]
    return np.array([q for q, _ in pairs]), np.array([dq for _, dq in pairs])


def test_encoder_rounds_to_its_nearest_step() -> None:
    sensor = Sensors(SensorErrors(2, bits_l=(12, 0), bits_m=(16.5, 8)))
    turn, q = 2 * np.pi, np.linspace(-4, 4, 501)
    for value in q:
        position, velocity = read(sensor, 0, np.full(4, value), VELOCITY)
        for seen, bits in zip(position[[0, 2, 3]], (12, 16.5, 8), strict=True):
            step = turn / 2**bits
            assert abs(seen - value) <= step / 2 * (1 + 1e-9)
            assert seen / step == pytest.approx(round(seen / step), abs=1e-6)
        assert position[1] == value
        assert np.array_equal(velocity, VELOCITY)


def test_noise_has_zero_mean_and_its_standard_deviation() -> None:
    deviations = {"position_l": (1e-3, 0.0), "position_m": 2e-3, "velocity_l": 0.1, "velocity_m": (0.0, 0.3)}
    q, dq = measured(Sensors(SensorErrors(2, **deviations), seed=2))
    wanted = np.array([1e-3, 0, 2e-3, 2e-3, 0.1, 0.1, 0, 0.3])
    noise = np.hstack([q - POSITION, dq - VELOCITY])
    assert np.array_equal(noise[:, wanted == 0], np.zeros((N, 2)))
    for column, deviation in zip(noise.T[wanted > 0], wanted[wanted > 0], strict=True):
        assert stats.kstest(column, stats.norm(0, deviation).cdf).pvalue > 1e-6
    correlation = np.corrcoef(noise[:, wanted > 0].T) - np.eye(6)
    assert np.max(np.abs(correlation)) < 6 / np.sqrt(N)


def test_noise_is_added_before_quantisation() -> None:
    q, _ = measured(Sensors(SensorErrors(2, bits_l=10, bits_m=10, position_l=0.01, position_m=0.01)), 100)
    counts = q / (2 * np.pi / 2**10)
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)
    assert len(np.unique(counts[:, 0])) > 3


def test_repeated_reads_of_an_instant_are_equal() -> None:
    errors = SensorErrors(2, position_l=0.01, velocity_m=0.1)
    often, once = Sensors(errors), Sensors(errors)
    for time in range(0, 50):
        seen = [np.concatenate(read(often, time, POSITION, VELOCITY)) for _ in range(1 + time % 3)]
        wanted = np.concatenate(read(once, time, POSITION, VELOCITY))
        assert all(np.array_equal(one, wanted) for one in seen)


@pytest.mark.parametrize(
    "name", ["bits_l", "bits_m", "position_l", "position_m", "velocity_l", "velocity_m", "velocities"]
)
def test_each_sensor_error_affects_only_its_own_signal(name: str) -> None:
    """The other errors remain, with the same random numbers as without it."""
    base = SensorErrors(2, **dict.fromkeys(("position_l", "position_m", "velocity_l", "velocity_m"), 0.01))
    value: Any = {"bits_l": 8, "bits_m": 8, "velocities": False}.get(name, 0.02)
    q, dq = measured(Sensors(base), 20)
    q_other, dq_other = measured(Sensors(replace(base, **{name: value})), 20)
    touched = {"bits_l": 0, "position_l": 0, "bits_m": 1, "position_m": 1, "velocity_l": 2, "velocity_m": 3}.get(name)
    if touched is None:
        assert dq_other.shape == (20, 0)
        dq_other = dq
    changed = [not np.array_equal(a, b) for a, b in zip(blocks(q, dq), blocks(q_other, dq_other), strict=True)]
    assert changed == [k == touched for k in range(4)]


def blocks(q: np.ndarray, dq: np.ndarray) -> list[np.ndarray]:
    return [*np.split(q, 2, axis=1), *np.split(dq, 2, axis=1)]


INVALID = (
    *((ChannelErrors, {name: value}) for name, value in (("delay", -1e-3), ("delay", np.inf), ("jitter", np.nan))),
    *((ChannelErrors, {name: value}) for name, value in (("loss", 1.5), ("repetition", -0.1))),
    *((SensorErrors, {"n": 2, name: value}) for name, value in (("bits_l", -1), ("bits_m", 60))),
    *((SensorErrors, {"n": 2, name: value}) for name, value in (("position_l", [1.0] * 3), ("velocity_m", np.nan))),
)


@pytest.mark.parametrize(("kind", "bad"), INVALID)
def test_invalid_errors_are_named(kind: type, bad: dict[str, Any]) -> None:
    with pytest.raises(ParameterError, match=f"^{list(bad)[-1]} .*; expected"):
        kind(**bad)
