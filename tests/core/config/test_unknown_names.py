# SPDX-License-Identifier: Apache-2.0
"""A name in a parameter file that no node reads is refused: a parameter, a key at the top, a section."""

from __future__ import annotations

import pytest

import fjr_core as fjr
from fjr_core.config import builders
from fjr_core.config.parameter import refuse_unknown
from fjr_core.config.scenario import OWN_PARAMETERS, parse_scenario

NAMES = {node: {each.name for each in builders.all_parameters(own, {})} for node, own in OWN_PARAMETERS.items()}
EVERY = sorted(set().union(*NAMES.values()))


def misspelled(name: str) -> str:
    """Return the name with two letters of its last word exchanged, or one left out if that changes nothing."""
    k = (name.rfind(".") + 1 + len(name)) // 2
    swapped = f"{name[: k - 1]}{name[k]}{name[k - 1]}{name[k + 1 :]}"
    return swapped if swapped != name else name[:k] + name[k + 1 :]


@pytest.mark.parametrize("name", EVERY)
def test_each_misspelled_parameter_of_a_file_is_refused_with_a_suggestion(name: str) -> None:
    wrong = misspelled(name)
    assert wrong not in EVERY
    with pytest.raises(fjr.ParameterError, match=rf"unknown parameter '{wrong}'.*did you mean") as found:
        refuse_unknown(NAMES["fjr_plant"], [wrong], NAMES["fjr_controller"])
    assert "\n" not in str(found.value)
    with pytest.raises(fjr.ParameterError, match=f"unknown parameter '{wrong}'"):
        parse_scenario("mine", f"/**: {{ros__parameters: {{{wrong}: 1.0}}}}")


REFUSED = {
    "{robot: {joint_stiffness: [3.1]}}": "has 'robot' at the top, where only sections of nodes are read",
    "{joints: [a]}": "has 'joints' at the top",
    "{/**: {ros__parameters: {}}, limits: {effort: [1.0]}}": "has 'limits' at the top",
    "{/**: {joints: [a]}}": "section '/**' has no 'ros__parameters' mapping",
    "{/**/fjr_controler: {ros__parameters: {}}}": "section '/**/fjr_controler', of another node; did you mean",
    "{fjr_plnat: {ros__parameters: {}}, /**: {ros__parameters: {}}}": "did you mean '/**/fjr_plant'",
    "{/left/fjr_plant: {ros__parameters: {}}}": "has no section of these nodes (/left/fjr_plant); expected /**,",
    "{driver: {ros__parameters: {}}}": "has no section of these nodes (driver)",
    "{/**/fjr_plant: {ros__parameters: {gains.K_ld: [1.0]}}}": "'gains.K_ld'; it is a parameter of another node",
    "{/**: {ros__parameters: {limits.efort: [1.0], gain.K_ld: [1.0]}}}": "'gain.K_ld' (and limits.efort); did you mean",
    "{/**: {ros__parameters: {camera: {rate: 5.0}}}}": "'camera.rate'; expected one of, or a name in,",
}


@pytest.mark.parametrize("text", REFUSED)
def test_what_no_node_would_read_is_refused_in_one_sentence(text: str) -> None:
    with pytest.raises(fjr.ParameterError) as found:
        parse_scenario("mine", text)
    assert REFUSED[text] in str(found.value)
    assert "\n" not in str(found.value)


def test_sections_of_other_nodes_and_namespaces_are_left_to_them() -> None:
    scenario = parse_scenario(
        "mine",
        "{/**: {ros__parameters: {robot.joint_stiffness: [3.1]}}, driver: {ros__parameters: {limits.efort: 1}},"
        " /left/fjr_plant: {ros__parameters: {publish_rate: 5.0}}, right: {arm: {driver: {ros__parameters: {a: 1}}}}}",
    )
    assert scenario.robot.K.tolist() == [[3.1]]
    assert scenario.sample_period == parse_scenario("default", "{}").sample_period
