"""JSON Schemas of the messages on the bus, made from the types that the program itself uses."""

from __future__ import annotations

import json
import re
from typing import Any

import msgspec
from msgspec import Struct

from camtopod import records
from camtopod.cli.generated.config_schema import schema as configuration_schema
from camtopod.cli.generated.example_config import attribute_docs
from camtopod.records import (
    DELTA_SCHEMA,
    TOPOLOGY_SCHEMA,
    Delta,
    Event,
    Prediction,
    Status,
    Topology,
)
from camtopod.serve.requests import Answer, Batch, Hello

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_NONE = re.compile(r"\bNone\b")

MESSAGES: dict[str, list[Any]] = {
    "event": [Event],
    "topology": [Topology],
    "delta": [Delta],
    "prediction": [Prediction],
    "status": [Status],
    "store": [Hello | Batch, Answer],
}
"""The messages on the bus, by name; ``store`` is a request of a spool, or its answer."""
_TYPES: dict[str, type[Struct]] = {
    **vars(records),
    **{kind.__name__: kind for kind in (Hello, Batch, Answer)},
}
NAMES = (*MESSAGES, "configuration")
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
    references, types = msgspec.json.schema_components(
        MESSAGES[name], ref_template="#/$defs/{name}"
    )
    for kind, described in types.items():
        _describe(described, _TYPES[kind])

    # Rules that the types cannot express.
    if "Event" in types:  # a position has both coordinates
        types["Event"]["dependentRequired"] = {"x": ["y"], "y": ["x"]}
    for kind, schema in (("Topology", TOPOLOGY_SCHEMA), ("Delta", DELTA_SCHEMA)):
        if kind in types:
            types[kind]["properties"]["schema"] = {"const": schema}
    reference = references[0] if len(references) == 1 else {"anyOf": list(references)}
    content: dict[str, Any] = _portable({**reference, "$defs": types})
    return {"$schema": _DIALECT, "title": f"camtopod {name}", **content}


def _describe(described: dict[str, Any], kind: type[Struct]) -> None:
    """Add the docstrings of a type's fields to its schema."""
    documents = attribute_docs(kind)
    for field in msgspec.structs.fields(kind):
        if field.name in documents:
            described["properties"][field.encode_name]["description"] = documents[field.name]


def _portable(node: Any) -> Any:
    r"""Return a schema without what only Python reads.

    Patterns end with ``$`` instead of ``\Z``. Descriptions have no markup of docstrings, and null
    for None.
    """
    if isinstance(node, list):
        return [_portable(one) for one in node]
    if not isinstance(node, dict):
        return node
    portable = {key: _portable(value) for key, value in node.items()}
    if isinstance(pattern := portable.get("pattern"), str):
        portable["pattern"] = pattern.replace(r"\Z", "$")
    if isinstance(text := portable.get("description"), str):
        lines = (line.strip() for line in text.splitlines())  # Python 3.13 indents less
        portable["description"] = _NONE.sub("null", "\n".join(lines).replace("`", ""))
    return portable
