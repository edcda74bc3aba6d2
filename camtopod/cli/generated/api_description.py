"""Description of the HTTP API of `camtopod web`, in the form of OpenAPI 3.1."""

from __future__ import annotations

import json
from typing import Any

from camtopod import __version__
from camtopod.cli.generated.message_schemas import described_types
from camtopod.records import CAMERA_PATTERN, Prediction, Topology

_CAMERA = {"type": "string", "pattern": CAMERA_PATTERN.replace(r"\Z", "$")}
_NUMBER = {"type": "number"}
_PLACE = (
    ("zone", {"type": "string"}, "Id of the zone where the object left; or give `x` and `y`."),
    ("x", _NUMBER, "Where it left, as a fraction of the picture's width from the left."),
    ("y", _NUMBER, "Where it left, as a fraction of the picture's height from the top."),
    ("t", _NUMBER, "When it left, seconds since the Unix epoch; without it, as of the topology."),
    ("now", _NUMBER, "Moment of the question if it is later than `t`, by the same clock."),
)
_HEALTH = {
    "type": "object",
    "required": ["now", "live", "daemon", "cameras"],
    "properties": {
        "now": {"type": "number", "description": "Unix time of the server, seconds."},
        "live": {
            "type": "object",
            "description": "Whether the daemon is reached; if not, why, and since when.",
            "required": ["live", "reason", "since"],
            "properties": {
                "live": {"type": "boolean"},
                "reason": {"type": "string"},
                "since": _NUMBER,
            },
        },
        "daemon": {"type": "object", "description": "The daemon's counters; they may change."},
        "cameras": {
            "type": "array",
            "items": {
                "type": "object",
                "required": ["id", "state", "reason"],
                "properties": {
                    "id": _CAMERA,
                    "state": {"type": "string"},
                    "reason": {"type": "string", "description": "Empty if nothing is wrong."},
                    "events": {"type": ["integer", "null"]},
                    "newest": {
                        "type": ["number", "null"],
                        "description": "Time of the newest event, seconds since the Unix epoch.",
                    },
                },
            },
        },
    },
}
_VERSIONS = {
    "type": "array",
    "items": {
        "type": "object",
        "required": ["version", "as_of"],
        "properties": {
            "version": {"type": "integer"},
            "as_of": {"type": "number", "description": "Event time, seconds since the Unix epoch."},
        },
    },
}


_ERROR = {
    "type": "object",
    "required": ["error"],
    "properties": {"error": {"type": "string", "description": "What is wrong."}},
}


def api_description_text() -> str:
    """Return the OpenAPI document, as JSON."""
    return json.dumps(api_description(), indent=1, ensure_ascii=False) + "\n"


def api_description() -> dict[str, Any]:
    """Return the OpenAPI document."""
    references, schemas = described_types([Topology, Prediction], "#/components/schemas/{name}")
    topology, prediction = references
    camera = _parameter("camera", _CAMERA, "Id of a camera.")
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "camtopod",
            "version": __version__,
            "description": "What a site's daemon has learned, and its predictions. Read-only. "
            "Objects may have further fields, which a reader ignores.",
            "license": {"name": "Apache-2.0", "identifier": "Apache-2.0"},
        },
        "servers": [{"url": "/", "description": "The server of `camtopod web`."}],
        "security": [{}, {"token": []}],
        "paths": {
            "/api/topology": _get(
                "The newest topology, or an older version of its epoch.",
                topology,
                [_parameter("version", {"type": "integer", "minimum": 0}, "Number of a version.")],
                {
                    400: "The version is not a number.",
                    404: "It is not kept, or nothing is learned.",
                },
            ),
            "/api/versions": _get(
                "The versions that are known without a query, oldest first.", _VERSIONS
            ),
            "/api/status": _get("State of the daemon and of the cameras.", _HEALTH),
            "/api/predict": _get(
                "Where an object that leaves a camera's view appears next.",
                prediction,
                [{**camera, "required": True}, *(_parameter(*one) for one in _PLACE)],
                {400: "The exit is not described rightly.", 503: "The daemon does not answer."},
            ),
            "/api/predictions": _get(
                "The daemon's predictions, one for each exit, as server-sent events of the type "
                "`prediction`, each with a prediction as its data. A slow reader misses some.",
                {"type": "string"},
                [camera],
                {400: "Not the id of a camera.", 503: "Too many programs read."},
                "text/event-stream",
            ),
        },
        "components": {
            "schemas": {**schemas, "Error": _ERROR},
            "securitySchemes": {
                "token": {
                    "type": "http",
                    "scheme": "bearer",
                    "description": "The token of `[web] token_file`, if there is a password.",
                }
            },
        },
    }


def _parameter(name: str, schema: dict[str, Any], description: str) -> dict[str, Any]:
    return {"name": name, "in": "query", "description": description, "schema": schema}


def _get(
    summary: str,
    schema: dict[str, Any],
    parameters: list[dict[str, Any]] | None = None,
    errors: dict[int, str] | None = None,
    media_type: str = "application/json",
) -> dict[str, Any]:
    """Return the description of one path."""
    refused = {401: "A token is needed.", 403: "The API is open to its own machine only."}
    answer = {"description": "As asked.", "content": {media_type: {"schema": schema}}}
    error = {"application/json": {"schema": {"$ref": "#/components/schemas/Error"}}}
    return {
        "get": {
            "summary": summary,
            "parameters": parameters or [],
            "responses": {
                "200": answer,
                **{
                    str(status): {"description": what, "content": error}
                    for status, what in sorted({**refused, **(errors or {})}.items())
                },
            },
        }
    }
