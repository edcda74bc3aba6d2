"""JSON Schemas of the messages on the bus, made from the types that the program itself uses."""

from __future__ import annotations

import json
from typing import Any

import msgspec
from msgspec import Struct

from camtopod.cli.generated.config_schema import schema as configuration_schema
from camtopod.records import (
    DELTA_SCHEMA,
    TOPOLOGY_SCHEMA,
    Ack,
    Delta,
    Event,
    Prediction,
    Topology,
)

_DIALECT = "https://json-schema.org/draft/2020-12/schema"


class Status(Struct):
    """State of the daemon or of the program that publishes a camera's events.

    state: running or degraded for the daemon; connecting, running, stalled, failed and others for
        a camera.
    reason: why it is not running as it should; empty if it is.
    t (Unix seconds): when the status was made.
    camera: the camera; the daemon's status has none.
    site, epoch, version: site of the daemon, and the version of the topology that it published
        last; 0 if there is none.

    Counters and other fields follow; which ones, and what they mean, may change.
    """

    state: str
    reason: str
    t: float
    camera: str | None = None
    site: str | None = None
    epoch: str | None = None
    version: int | None = None


_MESSAGES: dict[str, type[Struct]] = {
    "event": Event,
    "topology": Topology,
    "delta": Delta,
    "prediction": Prediction,
    "status": Status,
    "ack": Ack,
}
NAMES = (*_MESSAGES, "configuration")
"""Names of the schemas."""


def schema_text(name: str) -> str:
    """Return the JSON Schema of one of `NAMES` as a text."""
    return json.dumps(message_schema(name), indent=1, ensure_ascii=False) + "\n"


def message_schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema of one of `NAMES`.

    Messages may have further fields, which a reader ignores: fields are added, never changed.
    """
    if name == "configuration":
        return configuration_schema()
    kind = _MESSAGES[name]
    made = _portable(msgspec.json.schema(kind))
    described = made["$defs"][kind.__name__]
    properties = described["properties"]
    if name == "event":  # a position has both coordinates
        described["dependentRequired"] = {"x": ["y"], "y": ["x"]}
    elif name == "topology":
        properties["schema"] = {"const": TOPOLOGY_SCHEMA}
    elif name == "delta":
        properties["schema"] = {"const": DELTA_SCHEMA}
    return {"$schema": _DIALECT, "title": f"camtopod {name}", **made}


def _portable(node: Any) -> Any:
    r"""Return a schema without what only Python reads.

    Patterns end with ``$`` instead of ``\Z``. Descriptions have no markup of docstrings.
    """
    if isinstance(node, list):
        return [_portable(one) for one in node]
    if not isinstance(node, dict):
        return node
    portable = {key: _portable(value) for key, value in node.items()}
    if isinstance(pattern := portable.get("pattern"), str):
        portable["pattern"] = pattern.replace(r"\Z", "$")
    if isinstance(text := portable.get("description"), str):
        lines = (line.removeprefix("    ") for line in text.splitlines())
        portable["description"] = "\n".join(lines).replace("`", "")
    return portable
