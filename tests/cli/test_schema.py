"""`camtopod schema`: valid for what the program publishes and reads, and wrong where that is."""

from __future__ import annotations

import functools
import json
import re
import threading
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import msgspec
import pytest
from fake_bus_daemon import LEFT, NOW, learned, put, running
from rendered_scenes import Scene
from serving import (
    WAIT_SECONDS,
    camtopod,
    closing_event,
    free_endpoint,
    numbered,
    small_config,
    wait_for,
    walkers,
)

from camtopod.cli.generated import NAMES, example, schema_text
from camtopod.cli.main import main
from camtopod.codec import to_json
from camtopod.records import Event
from camtopod.serve.bus import dial
from camtopod.serve.requests import Answer, Batch, Hello


@functools.cache
def validator(name: str) -> Any:
    schema = json.loads(schema_text(name))
    kind = jsonschema.validators.validator_for(schema)
    kind.check_schema(schema)
    return kind(schema)


@pytest.mark.parametrize("name", NAMES)
def test_it_is_a_schema_and_is_printed(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    validator(name)
    assert main(["schema", name]) == 0
    out = capsys.readouterr().out
    assert out == schema_text(name)
    assert r"\Z" not in out, "JavaScript does not know it"


def subschemas(schema: Any) -> Iterator[dict[str, Any]]:
    """Yield a schema, and all within it."""
    if isinstance(schema, dict):
        yield schema
        for key in ("properties", "patternProperties", "$defs"):
            for part in schema.get(key, {}).values():
                yield from subschemas(part)
        for key in ("items", "additionalProperties", "propertyNames", "not", "if", "else"):
            yield from subschemas(schema.get(key))
        for key in ("anyOf", "prefixItems"):
            for part in schema.get(key, []):
                yield from subschemas(part)


@pytest.mark.parametrize("name", NAMES)
def test_strict_validators_take_it(name: str) -> None:
    """As ajv with `strict: true`: known keywords of one draft, one type, required properties."""
    kind = jsonschema.Draft202012Validator
    remarks = {"$schema", "$defs", "title", "description", "default", "examples"}
    assert type(validator(name)) is kind
    for schema in subschemas(validator(name).schema):
        assert set(schema) <= {*kind.VALIDATORS, *remarks, "else", "contentEncoding"}
        assert not isinstance(schema.get("type"), list)
        assert set(schema.get("required", [])) <= set(schema.get("properties", {}))


def test_what_is_on_the_bus_is_valid(tmp_path: Path) -> None:
    heard: dict[str, list[Any]] = {name: [] for name in NAMES}
    added = threading.Lock()

    def hear(name: str) -> Any:
        def on_message(key: str, payload: bytes) -> None:
            with added:
                heard[name].append(msgspec.msgpack.decode(payload))

        return on_message

    film = Scene([]).film(tmp_path / "yard.mp4", 3.0)
    events = [*numbered(walkers(60)), closing_event()]
    with (
        running(tmp_path, free_endpoint()) as daemon,
        dial(small_config(tmp_path, daemon.endpoint)) as bus,
    ):
        for name, key in {
            "event": "event/*",
            "topology": "topology",
            "model": "topology/model",
            "delta": "topology/delta",
            "prediction": "prediction/*",
            "match": "match/*",
            "status": "status/*",
        }.items():
            bus.subscribe(key, hear(name))
        # The daemon has the subscriptions once it has answered.
        assert bus.query("status/daemon", seconds=WAIT_SECONDS, one=True)
        put(bus, *events)
        learned(daemon, events)
        put(bus, Event("a", "entry", NOW, 0.1, 0.5), Event(kind="exit", **LEFT))
        endpoint, state = daemon.endpoint, str(tmp_path / "grabber")
        grab = camtopod("--connect", endpoint, "grab", "--camera", "yard",
                        str(film), "--realtime", "--state", state)  # fmt: skip
        try:
            wait_for(
                lambda: (
                    all(
                        heard[name]
                        for name in NAMES
                        if name not in ("configuration", "store", "topology")
                    )
                    and any("camera" in status for status in heard["status"])
                ),
                f"one message of each kind, {[name for name in NAMES if not heard[name]]}",
            )
        finally:
            grab.terminate()
            grab.wait(60)
        [(_, whole)] = bus.query("topology", one=True)
        heard["topology"].append(msgspec.msgpack.decode(whole))

    assert any("version" in status for status in heard["status"])
    heard["store"] = [
        msgspec.json.decode(to_json(one))
        for one in (
            Hello("n1", ["b1"]),
            Batch("n1", "b1", 0, [(1, b"event")], 2),
            Answer({"b1": 1}, 500, "held", "a sentence", 1, 1),
        )
    ]
    for name, messages in heard.items():
        for message in messages:
            validator(name).validate(json.loads(msgspec.json.encode(message)))


@pytest.mark.parametrize(
    ("given", "wrong"),
    [
        ({}, False),
        ({"y": None}, True),
        ({"x": 1.5}, True),
        ({"camera": "a b"}, True),
        ({"kind": "passes"}, True),
        ({"t": None}, True),
        ({"track": 17, "new": "ignored"}, False),
    ],
)
def test_mistakes_in_an_event_are_found(given: dict[str, Any], wrong: bool) -> None:
    event = json.loads(to_json(Event("a", "exit", 1.5, 0.5, 0.5))) | given
    event = {key: value for key, value in event.items() if value is not None}
    assert validator("event").is_valid(event) != wrong


def wrong(toml: str) -> list[str]:
    """Return the places where the schema of the configuration finds mistakes."""
    found = validator("configuration").iter_errors(tomllib.loads(toml))
    return sorted(".".join(map(str, error.path)) for error in found)


def test_the_example_configuration_is_valid_with_and_without_its_defaults() -> None:
    everything = re.sub(r"(?m)^# (\w+ = )", r"\1", example())
    everything = re.sub(r'(?m)^source_file = ""\n', "", everything)  # beside a source

    assert wrong(example()) == wrong(everything) == []


@pytest.mark.parametrize(
    ("toml", "where"),
    [
        ("[sight]\n", ""),
        ('[site]\nnmae = "hq"', "site"),
        ('[site]\nname = "a/b"', "site.name"),
        ("[limits]\ncommit_seconds = -1", "limits.commit_seconds"),
        ('[bus]\nlisten = ["localhost"]', "bus.listen.0"),
        ("[cameras.lobby]\nspeed = 2", "cameras.lobby"),
        ("[cameras.lobby]\nignore = [[[0, 0], [1, 0]]]", "cameras.lobby.ignore.0"),
        ("[cameras.lobby]\nignore = [[0.5, 0.5]]", "cameras.lobby.ignore.0"),
        ('[cameras.lobby]\nsource = "a"\nsource_file = "b"', "cameras.lobby"),
        ('[cameras."a b"]\nsource = "0"', "cameras"),
        ('[cameras.daemon]\nsource = "0"', "cameras"),
    ],
)
def test_a_mistake_in_a_configuration_is_found_where_it_is(toml: str, where: str) -> None:
    assert wrong(toml) == [where]
