"""What has one place in the package: decoding other programs' bytes, writing files."""

from __future__ import annotations

import re

import pytest
from paths import ROOT

PLACES = {
    r"(msgpack|json)\.(decode|Decoder|loads?|JSONDecoder|unpackb)\(": {
        "codec.py": "all that other programs send",
        "learn/snapshot.py": "the learner's own state, whose digest is checked",
        "serve/storage/witness.py": "the journal's own",
        "keys/authority.py": "the authority's own ledger",
        "keys/rules.py": "the authority's own list",
        "cli/cameras/probe.py": "the answer of a process of its own",
        "vision/source/probe.py": "what that process is asked",
    },
    r"""\bopen\([^)\n]*["'][rb+]*[wax]|\.write_(bytes|text)\(|os\.(replace|rename)\(|O_CREAT""": {
        "files.py": "all files that are whole or not at all",
        "cli/common.py": "a stream's lines, which have no end",
        "serve/storage/sqlite_file.py": "SQLite's files",
    },
}
"""By pattern: the modules of the package in which it may stand, and why."""


@pytest.mark.parametrize("pattern", PLACES)
def test_it_stands_nowhere_else(pattern: str) -> None:
    package = ROOT / "camtopod"
    found = {
        path.relative_to(package).as_posix()
        for path in package.rglob("*.py")
        if re.search(pattern, path.read_text("utf-8"))
    }
    assert found <= {*PLACES[pattern]}, "by `codec.read` and `files.writing` instead"
