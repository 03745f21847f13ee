# SPDX-License-Identifier: Apache-2.0
"""Services of running nodes: `fjr call`, `fjr set`, `fjr lifecycle`, and the clients with which a run starts."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator

import pytest
from rcl_interfaces.srv import GetParameters

from fjr_bringup import clients
from fjr_bringup.clients import PlantClient
from nodes.harness import Listener, Ros
from system.documented import documented_keys
from system.executables import SLOW, Start, fjr_here, running, wait_for

pytestmark = pytest.mark.system
WAIT = ("--timeout", "600")
CONTROLLER, PLANT = "/left/fjr_controller", "/left/fjr_plant"


@pytest.fixture(scope="module")
def loop() -> Iterator[None]:
    """Plant and controller under a namespace."""
    with running(SLOW, "-r", "__ns:=/left"):
        yield


def test_request_is_a_mapping_or_the_only_value(loop: None) -> None:
    said = json.loads(fjr_here("call", "left/fjr_plant/pause", "{data: true}", "--json", *WAIT))
    assert said["success"] is True
    assert "paused" in said["message"]
    assert "running" in fjr_here("call", "left/fjr_plant/pause", "false", *WAIT)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("3", "data is 3; expected boolean"),
        ("{dat: true}", "'dat' is not a field of SetBool_Request; expected data (boolean)"),
    ],
)
def test_request_of_the_wrong_kind_is_not_sent(loop: None, text: str, sentence: str) -> None:
    assert sentence in fjr_here("call", f"{PLANT}/pause", text, *WAIT, code=2)


def test_refused_request_fails_with_the_message_of_the_server(loop: None) -> None:
    said = fjr_here("call", f"{PLANT}/advance", *WAIT, code=1)  # the robot is not paused
    assert f"fjr: {PLANT}/advance refused: " in said


@pytest.mark.parametrize(
    ("parameter", "text", "sent"),
    [
        ("imperfections.state_loss", "0", 0.0),  # an integer where the node declares a double
        ("imperfections.motor_coulomb_friction", "[0.01]", [0.01]),
        ("advance_samples", "7", 7),
    ],
)
def test_parameter_takes_the_value_in_the_declared_type(
    loop: None, ros: Ros, parameter: str, text: str, sent: object
) -> None:
    said = json.loads(fjr_here("set", PLANT, parameter, text, "--json", *WAIT))
    assert said == {"node": PLANT, "parameter": parameter, "value": sent}
    assert set(said) == documented_keys()["set"]
    (found,) = Listener(ros, only=[]).call(GetParameters, f"{PLANT}/get_parameters", names=[parameter]).values
    assert sent in (found.double_value, list(found.double_array_value), found.integer_value)


@pytest.mark.parametrize(
    ("parameter", "text", "code", "sentence"),
    [
        ("imperfections.state_loss", "1.5", 1, f"{PLANT} refused imperfections.state_loss: "),
        ("no_parameter", "1", 1, f"{PLANT} refused no_parameter: unknown parameter 'no_parameter'"),
        ("imperfections.state_loss", "lots", 2, "imperfections.state_loss is lots; expected a number"),
        ("imperfections.motor_coulomb_friction", "0.1", 2, "expected a list of numbers, e.g. [0.5]"),
    ],
)
def test_refused_value_ends_in_one_sentence(loop: None, parameter: str, text: str, code: int, sentence: str) -> None:
    said = fjr_here("set", PLANT, parameter, text, *WAIT, code=code)
    assert sentence in said
    assert len(said.strip().splitlines()) == 1


def test_lifecycle_reads_and_changes_the_state_and_refuses_what_is_not_offered(loop: None) -> None:
    assert f"{CONTROLLER} is active; transitions: deactivate, shutdown" in fjr_here("lifecycle", CONTROLLER, *WAIT)
    for transition, state in (("deactivate", "inactive"), ("activate", "active")):
        said = json.loads(fjr_here("lifecycle", CONTROLLER, transition, "--json", *WAIT))
        assert said["state"] == state
        assert set(said) == documented_keys()["lifecycle"]
    said = fjr_here("lifecycle", CONTROLLER, "configure", *WAIT, code=1)
    assert f"{CONTROLLER} is active and has no transition 'configure'; expected deactivate, shutdown" in said


def test_a_node_that_is_not_there_or_has_no_valid_name_is_named() -> None:
    for arguments in (["call", "{}/hold"], ["set", "{}", "a", "1"], ["lifecycle", "{}"]):
        absent, invalid = ([each.format(name) for each in arguments] for name in ("/nobody", "/a b"))
        assert "no node offers the service /nobody/" in fjr_here(*absent, "--timeout", "0.3", code=1)
        assert "'/a b" in fjr_here(*invalid, code=2)


@pytest.fixture
def plant_client(ros: Ros) -> Iterator[PlantClient]:
    client = PlantClient(ros.context, "fjr_plant")
    yield client
    client.close()


def test_node_that_stands_still_has_not_discovered_new_subscriptions(
    plant_client: PlantClient, start: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(clients, "RETRY_AFTER", 0.5)
    assert not plant_client.discovered_by("nobody")
    plant = start("plant", "--ros-args", "-p", "start_paused:=true", "-p", "compile:=false")
    wait_for(lambda: plant_client.discovered_by("fjr_plant"), "the answer of the plant")
    plant.signal(signal.SIGSTOP)
    assert not plant_client.discovered_by("fjr_plant")
    plant.signal(signal.SIGCONT)
    wait_for(lambda: plant_client.discovered_by("fjr_plant"), "the answer of the plant after its pause")
