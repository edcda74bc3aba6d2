"""Description of the bus for programs in other languages, in the form of AsyncAPI 3.

The keys are those of `deploy/protocol.md`, the messages those of `message_schemas`.
"""

from __future__ import annotations

import json
from typing import Any, Literal

from msgspec import Struct

from camtopod import __version__
from camtopod.cli.generated.message_schemas import MESSAGES, described_types
from camtopod.config import DEFAULT_ENDPOINT
from camtopod.keys import PREFIX
from camtopod.records import CAMERA_PATTERN


class _Key(Struct, frozen=True):
    """A key on the bus, seen by a program that is neither daemon nor grabber.

    key: below the site's.
    message: name of the published message.
    action: send or receive.
    parameters: those of a query for the same content; None if it cannot be queried.
    """

    key: str
    message: str
    action: Literal["send", "receive"]
    summary: str
    parameters: str | None = None


_KEYS = (
    _Key("event/{camera}", "event", "send", "Publish an event of a camera."),
    _Key("ack/{camera}", "ack", "receive", "Events of a camera are safely stored."),
    _Key(
        "topology",
        "topology",
        "receive",
        "The whole topology. A late joiner queries it.",
        "`version`: a number, for an older version",
    ),
    _Key("topology/delta", "delta", "receive", "The difference between two successive versions."),
    _Key("prediction/{camera}", "prediction", "receive", "A prediction for each exit."),
    _Key(
        "predict/{camera}",
        "prediction",
        "receive",
        "A prediction for an exit that the query describes. Nothing is published here.",
        "`zone`, or `x` and `y`: where the object left; `t`: when; `now`: the moment of the query",
    ),
    _Key("status/{camera}", "status", "receive", "State of the program at a camera.", ""),
    _Key("status/daemon", "status", "receive", "State of the daemon.", ""),
)


def bus_description_text() -> str:
    """Return the AsyncAPI document of the bus, as JSON."""
    return json.dumps(bus_description(), indent=1, ensure_ascii=False) + "\n"


def bus_description() -> dict[str, Any]:
    """Return the AsyncAPI document of the bus."""
    references, schemas = described_types(list(MESSAGES.values()), "#/components/schemas/{name}")
    host, _, port = DEFAULT_ENDPOINT.partition("/")[2].rpartition(":")
    return {
        "asyncapi": "3.0.0",
        "info": {
            "title": "camtopod on the bus",
            "version": __version__,
            "description": "Events, topology and predictions of a site, as zenoh keys. Messages "
            "are MessagePack with the structure of the JSON Schemas; a query with the parameter "
            "`format=application/json` is answered in JSON. Messages may have further fields, "
            "which a reader ignores.",
            "license": {"name": "Apache-2.0"},
        },
        "defaultContentType": "application/msgpack",
        "servers": {
            "daemon": {
                "host": f"{host}:{port}",
                "protocol": "zenoh",
                "description": "The daemon, unless `[bus] listen` says otherwise.",
            }
        },
        "channels": {_name(one): _channel(one) for one in _KEYS},
        "operations": {
            f"{one.action}-{_name(one)}": {
                "action": one.action,
                "channel": {"$ref": f"#/channels/{_name(one)}"},
                "summary": one.summary,
            }
            for one in _KEYS
        },
        "components": {
            "schemas": _draft_7(schemas),
            "messages": {
                name: {
                    "name": name,
                    "contentType": f"application/msgpack;schema=camtopod.{name}.1",
                    "payload": reference,
                }
                for name, reference in zip(MESSAGES, references, strict=True)
            },
        },
    }


def _draft_7(node: Any) -> Any:
    """Return a schema in the terms of draft 7, on which AsyncAPI is based."""
    if isinstance(node, list):
        return [_draft_7(one) for one in node]
    if not isinstance(node, dict):
        return node
    older = {key: _draft_7(value) for key, value in node.items()}
    if "prefixItems" in older:
        older |= {"items": older.pop("prefixItems"), "additionalItems": older["items"]}
    if "dependentRequired" in older:
        older["dependencies"] = older.pop("dependentRequired")
    return older


def _name(one: _Key) -> str:
    """Return the name of a key's channel."""
    return one.key.replace("/{camera}", "-of-camera").replace("/", "-")


def _channel(one: _Key) -> dict[str, Any]:
    """Return the channel of a key."""
    parameters = {"site": {"description": "Name of the site; `site` unless configured."}}
    if "{camera}" in one.key:
        pattern = CAMERA_PATTERN.replace(r"\Z", "$")
        parameters["camera"] = {"description": f"Id of the camera; it matches `{pattern}`."}
    queried = ""
    if one.parameters is not None:
        names = f" Parameters: {one.parameters}." if one.parameters else ""
        queried = f" It can be queried.{names}"
    return {
        "address": f"{PREFIX}/{{site}}/{one.key}",
        "description": f"{one.summary}{queried}",
        "messages": {one.message: {"$ref": f"#/components/messages/{one.message}"}},
        "parameters": parameters,
    }
