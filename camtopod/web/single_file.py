"""The page as one self-contained HTML file with styles, scripts and data."""

from __future__ import annotations

import base64
import hashlib
import re
from importlib import resources
from typing import Any

import msgspec

STATIC = resources.files("camtopod.web").joinpath("static")
FIRST = "main.js"
"""Module that the page starts with."""
_IMPORT = re.compile(r'^import (\{[^}]*\}) from "\./([a-z]+\.js)";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?:async )?(?:function|class|const) (\w+)", re.MULTILINE)


def page(data: Any) -> str:
    """Return the HTML of a report that shows ``data`` (from `camtopod.web.report`).

    Its content security policy allows this script and this style sheet and nothing else.
    """
    style = (STATIC / "app.css").read_text("utf-8")
    script = f'"use strict";\n{scripts()}'
    icon = base64.b64encode((STATIC / "icon.svg").read_bytes()).decode()
    policy = (
        f"default-src 'none'; script-src '{_hash(script)}'; style-src '{_hash(style)}'; "
        "img-src data:; base-uri 'none'; form-action 'none'"
    )
    # Escaped so that no text in the data can end the script element.
    content = msgspec.json.encode(data).decode().replace("<", "\\u003c")
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>camtopod</title>
<link rel="icon" href="data:image/svg+xml;base64,{icon}">
<style>{style}</style>
</head>
<body>
<script type="application/json" id="report">{content}</script>
<script type="module">{script}</script>
</body>
</html>
"""


def scripts() -> str:
    """Return all modules as one script, each a function that returns its exports.

    The order is that of their dependencies.
    """
    modules: dict[str, str] = {}
    _add(FIRST, modules)
    return "\n".join(modules.values())


def _add(name: str, modules: dict[str, str]) -> None:
    """Add a module after those it imports; imports have no cycles."""
    if name in modules:
        return
    source = (STATIC / name).read_text("utf-8")
    for _, dependency in _IMPORT.findall(source):
        _add(dependency, modules)
    exports = ", ".join(_EXPORT.findall(source))
    body = _IMPORT.sub(lambda match: f"const {match[1]} = {_variable(match[2])};\n", source)
    body = re.sub(r"^export ", "", body, flags=re.MULTILINE)
    modules[name] = f"const {_variable(name)} = (() => {{\n{body}\nreturn {{ {exports} }};\n}})();"


def _variable(name: str) -> str:
    return f"module_{name.removesuffix('.js')}"


def _hash(text: str) -> str:
    """Return the source of a content security policy that allows this text."""
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
