"""The description of the bus: valid by somebody else's validator, and true of the bus."""

from __future__ import annotations

import copy
import re
import warnings
from collections.abc import Callable
from typing import Any

import jsonschema
import msgspec
import pytest
from pages import PAGES
from serving import walkers

from camtopod.cli.generated.bus_description import bus_description
from camtopod.codec import to_json
from camtopod.keys import rules

with warnings.catch_warnings():
    warnings.filterwarnings("ignore", message="Field name", category=UserWarning)
    from asyncapi3.models import AsyncAPI3

DESCRIPTION = bus_description()


def test_it_is_asyncapi() -> None:
    AsyncAPI3.model_validate(DESCRIPTION)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda one: one["info"].pop("title"),
        lambda one: one["operations"]["receive-topology"].update(action="hear"),
        lambda one: one["channels"]["topology"].update(adress="topology"),
        lambda one: one["channels"]["topology"].update(messages={"topology": 3}),
    ],
)
def test_the_validator_sees_what_is_wrong(spoil: Callable[[dict[str, Any]], None]) -> None:
    spoiled = copy.deepcopy(DESCRIPTION)
    spoil(spoiled)
    with pytest.raises(ValueError, match="validation error"):
        AsyncAPI3.model_validate(spoiled)


def references(node: Any) -> list[str]:
    if isinstance(node, dict):
        return [
            found
            for key, value in node.items()
            for found in ([value] if key == "$ref" else references(value))
        ]
    return [found for one in node for found in references(one)] if isinstance(node, list) else []


def test_every_reference_leads_somewhere() -> None:
    found = set(references(DESCRIPTION))
    assert len(found) > 30
    for reference in found:
        node: Any = DESCRIPTION
        for part in reference.removeprefix("#/").split("/"):
            node = node[part]


def test_events_are_valid_by_the_schema_of_draft_7() -> None:
    message = DESCRIPTION["components"]["messages"]["event"]
    kind = jsonschema.Draft7Validator
    validator = kind({**message["payload"], "components": DESCRIPTION["components"]})
    event = msgspec.json.decode(to_json(walkers(1)[0]))
    assert validator.is_valid(event)
    del event["y"]
    assert not validator.is_valid(event)
    delta = DESCRIPTION["components"]["schemas"]["Delta"]["properties"]["gone_pairs"]["items"]
    assert kind(delta).is_valid(["a", "b"])
    assert not kind(delta).is_valid(["a", "b", "c"])


def test_keys_and_encodings_are_those_of_the_bus() -> None:
    addresses = {one["address"] for one in DESCRIPTION["channels"].values()}
    keys = {address.removeprefix("camtopo/{site}/") for address in addresses}
    assert all(address.startswith(f"{rules.PREFIX}/") for address in addresses)
    [protocol] = [page.read_text() for page in PAGES if page.name == "protocol.md"]
    rows = re.findall(r"^\| (`.*?`) \|", protocol, re.MULTILINE)
    told = {key for row in rows for key in re.findall(r"`([a-z]+/[^`]+|topology)`", row)}
    internal = {key for key in told if key.split("/")[0] in ("spool", "alive", "admin")}
    assert told - internal == keys
