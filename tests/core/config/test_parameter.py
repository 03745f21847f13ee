# SPDX-License-Identifier: Apache-2.0
"""Parameter declarations: one per field, expanded for n joints, read back in the declared shape."""

from __future__ import annotations

from collections import Counter
from dataclasses import MISSING, dataclass, fields
from typing import Any

import numpy as np
import pytest

import fjr_core as fjr
from fjr_core.config import builders
from fjr_core.config.parameter import MATRIX, POINT, ROWS, VECTOR, complete, read, table
from fjr_core.numerics.parameter_field import declared, parameter_field
from fjr_core.robust.law import Robust
from fjr_core.runtime.safety_settings import Settings
from fjr_core.simulation.nonideal_parameters import ChannelErrors, Nonidealities, SensorErrors

MODELS: dict[str, dict[str, Any]] = {
    "single_link": {},
    "planar_two_link": {"robot.model": "planar_two_link"},
    "urdf": {"robot.model": "urdf", "joints": ["a", "b", "c"]},
}


@dataclass(frozen=True)
class Example:
    gain: Any = parameter_field(MISSING, "Gain", "1/s", name="own_name", shape=MATRIX)
    computed: int = 3
    rate: float = parameter_field(2.0, "Rate", "Hz", minimum=1.0)
    limit: Any = parameter_field(np.inf, "Limit", "N m", name="limits.", infinite=True, shape=VECTOR)
    sines: Any = parameter_field(1.0, "Sines", shape=ROWS)
    place: Any = parameter_field(0.0, "Place", "m", shape=POINT)


DEFAULTS = Example(gain=4.0)


def test_fields_declare_names_units_and_defaults() -> None:
    found = declared(Example, "group.", DEFAULTS)
    names = {field: parameter.name for field, parameter in found.items()}
    assert names == {
        "gain": "group.own_name",
        "rate": "group.rate",
        "limit": "group.limits.limit",
        "sines": "group.sines",
        "place": "group.place",
    }
    assert [parameter.default for parameter in table(found, 2)] == [
        (4.0,) * 2,
        2.0,
        (np.inf,) * 2,
        (1.0,) * 2,
        (0.0,) * 3,
    ]
    assert (found["rate"].unit, found["rate"].minimum, Example(gain=1.0).rate) == ("Hz", 1.0, 2.0)


def test_values_are_read_in_the_declared_shape() -> None:
    declarations = declared(Example, "", DEFAULTS)
    given = {"own_name": [1.0, 2.0, 3.0, 4.0], "sines": [1.0] * 6, "place": [1.0, 2.0, 3.0]}
    found = read(declarations, complete(table(declarations, 2), given), 2)
    assert found["rate"] == 2.0
    assert np.array_equal(found["limit"], [np.inf, np.inf])
    assert np.array_equal(found["gain"], [[1.0, 2.0], [3.0, 4.0]])
    assert found["sines"].shape == (3, 2)
    assert np.array_equal(found["place"], given["place"])


@pytest.mark.parametrize("name", ["limits.limit", "own_name", "sines", "place"])
def test_a_wrong_length_is_rejected_by_name(name: str) -> None:
    declarations = declared(Example, "", DEFAULTS)
    values = complete(table(declarations, 2), {name: [1.0] * 5})
    with pytest.raises(fjr.ParameterError, match=f"'{name}' has 5 entries"):
        read(declarations, values, 2)


@pytest.mark.parametrize("kind", [Settings, Robust, Nonidealities, SensorErrors, ChannelErrors])
def test_field_and_parameter_have_the_same_default(kind: type) -> None:
    declarations = declared(kind)
    assert declarations
    assert {field.name: field.default for field in fields(kind) if field.name in declarations} == {
        field: parameter.default for field, parameter in declarations.items()
    }


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("own", [builders.plant_parameters, builders.controller_parameters])
def test_every_parameter_of_a_node_is_declared_once(own: builders.OwnParameters, model: str) -> None:
    found = builders.all_parameters(own, MODELS[model])
    assert [name for name, count in Counter(p.name for p in found).items() if count > 1] == []
    assert all(p.description and (not isinstance(p.default, tuple) or len(p.default)) for p in found)
