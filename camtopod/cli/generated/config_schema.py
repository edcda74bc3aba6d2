"""JSON Schema of the configuration, made from the settings' own types, defaults and docstrings."""

from __future__ import annotations

import json
from typing import Any

import msgspec
from msgspec import Struct

from camtopod.cli.generated.example_config import attribute_docs
from camtopod.config import FLOAT_MAX, RESERVED, TABLES, CameraSettings, fields, polygons
from camtopod.records import CAMERA_PATTERN
from camtopod.vision.settings import DetectorSettings, VisionSettings


def text() -> str:
    """Return the content of ``camtopod.schema.json``, which the first line of the example refers
    to.
    """
    return json.dumps(schema(), indent=1) + "\n"


def schema() -> dict[str, Any]:
    """Return the schema (draft 7, which every editor supports).

    It describes tables and keys; `camtopod check` finds more mistakes.
    """
    tables = {name: _table(name, kind) for name, kind in TABLES.items()}
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
    """Return the schema of ``[cameras.ID]``, which takes the keys of ``[vision]`` as well.

    It has one of source and source_file, or neither.
    """
    camera = _table("cameras", CameraSettings)
    del camera["properties"]["vision"]
    detector = _table("detector", DetectorSettings)
    camera["properties"]["detector"] = {
        "description": attribute_docs(CameraSettings)["detector"],
        "anyOf": [{"const": False}, {"type": "object", **detector}],
    }
    camera["properties"] |= _table("vision", VisionSettings)["properties"]
    sources = ("source", "source_file")
    camera["oneOf"] = [
        *({"required": [key], "properties": {key: {"minLength": 1}}} for key in sources),
        {"not": {"anyOf": [{"required": [key]} for key in sources]}},
    ]
    return {
        "description": "[cameras.ID]: the cameras of this machine, a table each; "
        "the ID is the camera's name on the bus.",
        "type": "object",
        "propertyNames": {"pattern": _everywhere(CAMERA_PATTERN), "not": {"enum": list(RESERVED)}},
        "additionalProperties": camera,
    }


def _table(name: str, kind: type[Struct]) -> dict[str, Any]:
    """Return the schema of one table, each key with its description.

    A number may not be negative unless its default is.
    """
    table: dict[str, Any] = msgspec.json.schema(kind)["$defs"][kind.__name__]
    documents = attribute_docs(kind)
    table["description"] = " ".join(table["description"].split()).replace("`", "")
    del table["title"], table["required"]
    keys = table["properties"]
    table["properties"] = {field.name: keys[field.name] for field in fields(name, kind)}
    for field in fields(name, kind):
        key = table["properties"][field.name]
        key["description"] = documents[field.name].replace("`", "")
        if points_min := polygons.points_min(field):
            key |= _polygons(points_min)
        for texts in (key, key.get("items", {})):
            if "pattern" in texts:
                texts["pattern"] = _everywhere(texts["pattern"])
        if (
            key.get("type") in ("number", "integer")
            and field.default >= 0
            and "exclusiveMinimum" not in key
        ):
            key.setdefault("minimum", 0)
        if key.get("type") == "number" and "exclusiveMaximum" not in key:
            key.setdefault("maximum", FLOAT_MAX)
    return table


def _polygons(points_min: int) -> dict[str, Any]:
    """Return the schema of a list of polygons; see `camtopod.config.polygons`."""
    number = {"type": "number", "minimum": 0, "maximum": 1}
    point = {"type": "array", "items": number, "minItems": 2, "maxItems": 2}
    polygon = {"type": "array", "items": point, "minItems": 3}
    forms = [polygon, {"type": "string"}] + ([point] if points_min == 1 else [])
    return {"type": ["array", "string"], "items": {"anyOf": forms}}


def _everywhere(pattern: str) -> str:
    r"""Return a pattern that JavaScript accepts, too: it has no ``\Z``."""
    return pattern.replace(r"\Z", "$")
