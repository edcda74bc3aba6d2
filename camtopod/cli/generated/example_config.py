"""Example configuration, made from the settings' own defaults and docstrings."""

from __future__ import annotations

import ast
import inspect
import itertools
import json
import textwrap
from typing import Any

from msgspec import Struct

from camtopod.config import TABLES, CameraSettings, OtherSite, fields

_HEAD = """\
#:schema ./camtopod.schema.json
# camtopod: example configuration with every setting; a line with a leading # shows the default.
# Made by `camtopod check --example`; check your own file with `camtopod check FILE`.
"""
_CAMERAS = """\
# One table a camera; the name is the camera's id on the bus.
# Each key of [vision] may stand in it as well, for this camera alone.
[cameras.lobby]
source = "rtsp://user:password@192.0.2.10:554/stream1"
# ignore = [[[0.0, 0.0], [0.3, 0.0], [0.3, 0.1], [0.0, 0.1]]]
# min_height = 0.1
# detector = false
"""
_SITES = "# One table for each other site to which cameras of this one deliver, too.\n"
_ANNEX = {"connect": ["tcp/192.0.2.20:7447"]}
_HALL = {"source": "rtsp://user:password@192.0.2.11:554/stream1"}


def example() -> str:
    """Return a valid configuration file in which every setting is explained."""
    parts = [_HEAD, table("site", TABLES["site"], {"name": "hq"})]
    parts += [table(name, TABLES[name]) for name in ("bus", "bus.tls", "state", "keep")]
    parts += [_SITES + table("sites.annex", OtherSite, _ANNEX)]
    parts += [_CAMERAS, table("cameras.hall", CameraSettings, _HALL)]
    names = ("vision", "detector", "learn", "topology", "limits", "health", "web", "map")
    parts += [table(name, TABLES[name]) for name in names]
    return "\n".join(part.rstrip("\n") + "\n" for part in parts)


def table(name: str, kind: type[Struct], values: dict[str, Any] | None = None) -> str:
    """Return one table with every setting: its explanation, and its value.

    Those that are not in ``values`` are comments with the default.
    """
    values = values or {}
    documents = attribute_docs(kind)
    own_fields = inspect.get_annotations(kind)
    lines = [f"[{name}]"]
    for field in fields(name, kind):
        if field.name not in own_fields or isinstance(field.default, Struct):  # a table of its own
            continue
        lines += [f"# {line}" for line in textwrap.wrap(documents[field.name], 110 - 2)]
        if field.name in values:
            lines.append(f"{field.name} = {json.dumps(values[field.name])}")  # the same in TOML
        else:
            lines.append(f"# {field.name} = {json.dumps(field.default)}")
    return "\n".join(lines)


def attribute_docs(kind: type[Struct]) -> dict[str, str]:
    """Return field -> docstring (the string literal below each field in the source of a Struct)."""
    documents = {}
    for base in [*kind.__bases__, kind]:
        if base is Struct:
            continue
        body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0]
        assert isinstance(body, ast.ClassDef)
        for statement, next_statement in itertools.pairwise(body.body):
            if (
                isinstance(statement, ast.AnnAssign)
                and isinstance(statement.target, ast.Name)
                and isinstance(next_statement, ast.Expr)
                and isinstance(next_statement.value, ast.Constant)
            ):
                documents[statement.target.id] = " ".join(str(next_statement.value.value).split())
    return documents
