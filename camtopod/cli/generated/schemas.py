"""JSON Schemas of the messages on the bus, and of the configuration.

They are made from the types that the program itself uses, and their docstrings.
"""

from __future__ import annotations

import json
import re
from typing import Any

import msgspec
from msgspec import Struct

from camtopod import records
from camtopod.cli.generated.example_config import attribute_docs
from camtopod.config import TABLES, CameraSettings, Config, OtherSite, fields
from camtopod.records import (
    DELTA_SCHEMA,
    MODEL_SCHEMA,
    RESERVED,
    TOPOLOGY_SCHEMA,
    Delta,
    Event,
    Match,
    Prediction,
    Status,
    Topology,
    VersionModel,
)
from camtopod.serve.requests import Answer, Batch, Hello

_TYPES_OF: dict[str, list[Any]] = {
    "event": [Event],
    "topology": [Topology],
    "model": [VersionModel],
    "delta": [Delta],
    "prediction": [Prediction],
    "match": [Match],
    "status": [Status],
    "store": [Hello | Batch, Answer],
    "configuration": [Config],
}
"""Types by the name of the schema; ``store`` is a request of a spool, or its answer."""
_SCHEMAS = {
    "Topology": TOPOLOGY_SCHEMA,
    "VersionModel": MODEL_SCHEMA,
    "Delta": DELTA_SCHEMA,
}
NAMES = tuple(_TYPES_OF)
"""Names of the schemas."""
_TABLES: dict[type[Struct], str] = {kind: name for name, kind in TABLES.items()} | {
    CameraSettings: "cameras",
    OtherSite: "sites",
}
_OTHERS: list[type[Struct]] = [Hello, Batch, Answer, Config, *_TABLES]
_KINDS: dict[str, type[Struct]] = vars(records) | {kind.__name__: kind for kind in _OTHERS}


def schema_text(name: str) -> str:
    r"""Return the JSON Schema of one of `NAMES` as a text, without what only Python reads.

    Patterns end with ``$`` instead of ``\Z``. Descriptions have no markup of docstrings, and null
    for None.
    """
    text = json.dumps(schema(name), indent=1, ensure_ascii=False)
    text = text.replace(r"\\Z", "$").replace("`", "").replace("None", "null")
    return re.sub(r"\\n +", r"\\n", text) + "\n"  # without the indentation of docstrings


def schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema of one of `NAMES`.

    Messages may have further fields, which a reader ignores: fields are added, never changed. Of
    the configuration, `camtopod check` finds more mistakes.
    """
    references, types = msgspec.json.schema_components(
        _TYPES_OF[name], ref_template="#/$defs/{name}"
    )
    for kind, description in types.items():
        _describe(description, _KINDS[kind])

    # Rules that the types cannot express.
    if "Event" in types:  # a position has both coordinates
        types["Event"]["dependentRequired"] = {"x": ["y"], "y": ["x"]}
    for kind, constant in _SCHEMAS.items():
        if kind in types:
            types[kind]["properties"]["schema"] = {"const": constant}
    if name == "configuration":  # keywords of draft 7 only, which every editor supports
        types["Config"]["properties"]["cameras"]["propertyNames"]["not"] = {"enum": [*RESERVED]}
        for kind in ("CameraSettings", "VisionSettings"):
            _allow_further_forms(types[kind]["properties"])
        camera = types["CameraSettings"]
        sources = dict.fromkeys(("source", "source_file"), True)
        camera["not"] = {"properties": sources, "required": [*sources]}
        camera["properties"]["detector"] = {
            "anyOf": [{"const": False}, {"$ref": "#/$defs/DetectorSettings"}]
        }
    reference = references[0] if len(references) == 1 else {"anyOf": list(references)}
    if name == "store":
        del reference["anyOf"][0]["discriminator"]  # of OpenAPI, which validators refuse
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": f"camtopod {name}"}
    return {**head, **reference, "$defs": types}


def _describe(description: dict[str, Any], kind: type[Struct]) -> None:
    """Add the docstrings of a type's fields to its schema; leave out what no file may set."""
    documents = attribute_docs(kind)
    properties = description["properties"]
    for field in msgspec.structs.fields(kind):
        if field.name in documents:
            properties[field.encode_name]["description"] = documents[field.name]
        if isinstance(field.default, Struct):  # its own fields have defaults
            del properties[field.encode_name]["default"]
    if kind in _TABLES:
        settable = [field.name for field in fields(_TABLES[kind], kind)]
        description["properties"] = {key: properties[key] for key in settable}


def _allow_further_forms(properties: dict[str, Any]) -> None:
    """Allow polygons to be texts, and a door to be a point."""
    for key in ("ignore", "doors"):
        field = properties[key]
        del field["type"]
        polygon = field.pop("items")
        point = polygon["items"]
        point["items"] = point.pop("prefixItems")[0]  # which draft 7 does not know
        forms = [polygon, {"type": "string"}]
        if key == "doors":
            forms.append(point)
        polygons = {"type": "array", "items": {"anyOf": forms}}
        field |= {"if": {"type": "string"}, "else": polygons}
