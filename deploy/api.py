"""Builds the pages of the Python API from the docstrings, as HTML.

.venv/bin/python deploy/api.py [FOLDER]

FOLDER/index.html is the first page; FOLDER is build/api if none is given. Needs the extra [dev].
"""

from __future__ import annotations

import sys
from pathlib import Path

import pdoc

import camtopod

MODULES = (
    "camtopod",
    "camtopod.adapt.tracks",
    "camtopod.client",
    "camtopod.learn.settings",
    "camtopod.records",
)
"""What `import camtopod` offers, what else a program may import, the types of what these return."""


def main() -> None:
    for name in camtopod.__all__:  # pdoc sees only what is loaded
        setattr(camtopod, name, getattr(camtopod, name))
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else "build/api")
    pdoc.pdoc(*MODULES, output_directory=folder)


if __name__ == "__main__":
    main()
