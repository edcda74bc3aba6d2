"""The JSON Schema of the configuration, for editors; made from the settings' own types, defaults
and docstrings.
"""

from __future__ import annotations

import json
from typing import Any

import msgspec
from msgspec import Struct

from camtopod.cli.generated.example_config import attribute_docs
from camtopod.config import FLOAT_MAX, RESERVED, TABLES, CameraSettings
from camtopod.records import CAMERA_PATTERN


def text() -> str:
    """The file ``camtopod.schema.json``, which an editor finds by the first line of the example."""
    return json.dumps(schema(), indent=1) + "\n"


def schema() -> dict[str, Any]:
    """Draft 7, which every editor knows. It says what a table or a key is; `camtopod check` finds
    more.
    """
    tables = {name: _table(kind) for name, kind in TABLES.items()}
    for name in [name for name in tables if "." in name]:
        parent, _, key = name.partition(".")
        tables[parent]["properties"][key] = tables.pop(name)
    return {
        "$schema": "http://json-schema.org/draft-07/schema#",
        "title": "camtopod configuration",
        "type": "object",
        "properties": {**tables, "cameras": _cameras()},
        "additionalProperties": False,
    }


def _cameras() -> dict[str, Any]:
    camera = _table(CameraSettings)
    camera["oneOf"] = [
        {"required": [key], "properties": {key: {"minLength": 1}}}
        for key in ("source", "source_file")
    ]
    return {
        "description": "[cameras.ID]: the cameras of this box, a table each; the ID is the camera's name on the bus.",
        "type": "object",
        "propertyNames": {"pattern": _everywhere(CAMERA_PATTERN), "not": {"enum": list(RESERVED)}},
        "additionalProperties": camera,
    }


def _table(kind: type[Struct]) -> dict[str, Any]:
    """The schema of one table; each key has its description, and no number may be negative if its
    default is not.
    """
    table: dict[str, Any] = msgspec.json.schema(kind)["$defs"][kind.__name__]
    documents = attribute_docs(kind)
    table["description"] = " ".join(table["description"].split()).replace("`", "")
    del table["title"], table["required"]
    for field in msgspec.structs.fields(kind):
        key = table["properties"][field.name]
        key["description"] = documents[field.name].replace("`", "")
        for texts in (key, key.get("items", {})):
            if "pattern" in texts:
                texts["pattern"] = _everywhere(texts["pattern"])
        if (
            key.get("type") in ("number", "integer")
            and field.default >= 0
            and "exclusiveMinimum" not in key
        ):
            key.setdefault("minimum", 0)
        if key.get("type") == "number":
            key["maximum"] = FLOAT_MAX
    return table


def _everywhere(pattern: str) -> str:
    r"""A pattern as JavaScript has it, too, which has no ``\Z``."""
    return pattern.replace(r"\Z", "$")
