# SPDX-License-Identifier: Apache-2.0
"""Parameters reference.*: each type builds its reference; each parameter has an effect; each error is one sentence."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.config import builders
from fjr_core.config.parameter import complete
from fjr_core.config.reference import reference_parameters
from fjr_core.motions.reference import Reference

T = np.array([0.3, 1.3, 2.2, 7.7])
OFFSET = {"offset": (0.4, -0.3)}
TYPES: dict[str, tuple[dict[str, Any], Reference]] = {
    "sine": (
        {"amplitude": (0.5, 0.2), "frequency": (2.0, 3.0), "phase": (0.1, 0.2), **OFFSET},
        fjr.Sine((0.5, 0.2), (2.0, 3.0), (0.4, -0.3), (0.1, 0.2)),
    ),
    "multi_sine": (
        {
            "multi_sine.amplitude": (0.5, 0.2, 0.1, 0.3),
            "multi_sine.frequency": (2.0, 3.0, 1.0, 0.5),
            "multi_sine.phase": (0.1, 0.2, 0.3, 0.4),
            **OFFSET,
        },
        fjr.MultiSine([[0.5, 0.2], [0.1, 0.3]], [[2.0, 3.0], [1.0, 0.5]], [[0.1, 0.2], [0.3, 0.4]], (0.4, -0.3)),
    ),
    "point_to_point": (
        {
            "point_to_point.start": (0.1, 0.2),
            "point_to_point.goal": (1.5, -0.4),
            "point_to_point.duration": 1.6,
            "point_to_point.dwell": 0.2,
            "point_to_point.returns": False,
        },
        fjr.PointToPoint((0.1, 0.2), (1.5, -0.4), 1.6, 0.2),
    ),
    "circle": (
        {"circle.radius": 0.3, "circle.frequency": -2.0, "circle.phase": 0.4, "circle.ramp": 1.7, **OFFSET},
        fjr.Circle((0.4, -0.3), 0.3, -2.0, 0.4, 1.7),
    ),
    "hold": (OFFSET, fjr.Hold((0.4, -0.3))),
}
types = pytest.mark.parametrize(("kind", "given", "expected"), [(k, *v) for k, v in TYPES.items()], ids=TYPES)


def made(n: int = 2, **given: Any) -> Reference:
    values = complete(reference_parameters(n), {f"reference.{name}": value for name, value in given.items()})
    return builders.reference(values, n)


@types
def test_each_type_is_built_from_its_parameters(kind: str, given: dict[str, Any], expected: Reference) -> None:
    found = made(type=kind, **given)
    assert type(found) is type(expected)
    np.testing.assert_array_equal(found.jets(T), expected.jets(T))


@types
def test_each_parameter_of_a_type_changes_the_reference(kind: str, given: dict[str, Any], expected: Reference) -> None:
    returns = {"point_to_point.returns": True} if kind == "point_to_point" else {}  # a dwell has an effect only then
    whole = made(type=kind, **given | returns)
    for name in given:
        left_out = {key: value for key, value in given.items() if key != name or key in returns}
        if name.startswith("multi_sine"):
            left_out[name] = tuple(2.0 * value for value in given[name])
        assert name in returns or not np.array_equal(made(type=kind, **left_out | returns).jets(T), whole.jets(T)), name


def test_the_default_is_the_sine_of_the_paper() -> None:
    np.testing.assert_array_equal(made(1).jets(T), fjr.Sine(1.0, 1.0).jets(T))


@pytest.mark.parametrize("n", [1, 2, 7])
@pytest.mark.parametrize("kind", TYPES)
def test_every_type_has_defaults_for_any_number_of_joints(kind: str, n: int) -> None:
    if (kind, n) != ("circle", 1):
        assert made(n, type=kind).n == n


@types
def test_parameters_of_other_types_have_no_effect(kind: str, given: dict[str, Any], expected: Reference) -> None:
    wrong = {"amplitude": (1.0,), "multi_sine.phase": (1.0,), "point_to_point.goal": (1.0,)}
    own = {"sine": "amplitude", "multi_sine": "multi_sine.phase", "point_to_point": "point_to_point.goal"}
    others = {name: value for name, value in wrong.items() if name != own.get(kind)}
    np.testing.assert_array_equal(made(type=kind, **given, **others).jets(T), expected.jets(T))


def test_all_parameters_but_those_of_files_are_dynamic_and_all_have_units() -> None:
    for parameter in reference_parameters(2):
        assert parameter.dynamic != parameter.name.startswith("reference.file.")
        without = ("reference.type", "reference.point_to_point.returns", "reference.file.path")
        assert parameter.unit or parameter.name in without


BAD: dict[str, tuple[int, dict[str, Any], tuple[str, ...]]] = {
    "type": (2, {"type": "square"}, ("reference.type", "square", "multi_sine", "hold")),
    "amplitude": (2, {"amplitude": (1.0,)}, ("reference.amplitude", "1 entries", "2")),
    "rows": (2, {"type": "multi_sine", "multi_sine.phase": (1.0,) * 3}, ("multi_sine.phase", "3", "multiple of 2")),
    "counts": (2, {"type": "multi_sine", "multi_sine.phase": (1.0,) * 4}, ("multi_sine", "2, 2 and 4", "equally many")),
    "goal": (2, {"type": "point_to_point", "point_to_point.goal": (1.0,)}, ("point_to_point.goal", "1 entries")),
    "duration": (2, {"point_to_point.duration": 0.0}, ("point_to_point.duration", "0.0 s", "at least")),
    "dwell": (2, {"point_to_point.dwell": -1.0}, ("point_to_point.dwell", "-1.0 s", "at least 0.0")),
    "ramp": (2, {"circle.ramp": 0.0}, ("circle.ramp", "0.0 s", "at least")),
    "circle": (1, {"type": "circle"}, ("reference.type", "circle", "1 joint", "2 joints")),
    "hold": (2, {"type": "hold", "offset": (1.0,)}, ("reference.offset", "1 entries")),
}


@pytest.mark.parametrize(("n", "given", "words"), BAD.values(), ids=BAD)
def test_invalid_values_are_rejected_in_one_sentence(n: int, given: dict[str, Any], words: tuple[str, ...]) -> None:
    with pytest.raises(fjr.ParameterError) as caught:
        made(n, **given)
    assert all(word in str(caught.value) for word in words), caught.value
    assert "\n" not in str(caught.value)
