"""`camtopod completion`: the file that makes a shell complete camtopod's commands and options.

The files are made from the parser by `deploy/generate.py`, so that nothing has to be installed for
them.
"""

from __future__ import annotations

import argparse
import sys
from importlib import resources
from typing import Any

from camtopod.cli import exits

SHELLS = {
    "bash": "~/.local/share/bash-completion/completions/camtopod",
    "zsh": "a folder of $fpath, as _camtopod",
    "fish": "~/.config/fish/completions/camtopod.fish",
}
"""Shell -> where it looks for the file."""


def add_parser(subparsers: Any) -> None:
    """Add `completion`."""
    places = "; ".join(f"{shell}: {place}" for shell, place in SHELLS.items())
    parser = subparsers.add_parser(
        "completion",
        help="makes the shell complete commands and options",
        description=f"Writes what completes camtopod's commands and options in a shell. It belongs into: {places}.",
    )
    parser.add_argument("shell", choices=tuple(SHELLS), help="for which shell")


def run(args: argparse.Namespace) -> int:
    """The file as it is."""
    file = resources.files("camtopod.cli") / "completions" / f"camtopod.{args.shell}"
    sys.stdout.write(file.read_text(encoding="utf-8"))
    return exits.DONE
