"""`camtopod completion`: print a script that completes camtopod's commands and options in a shell.

`deploy/generate.py` makes the scripts from the parser, so nothing has to be installed to use them.
"""

from __future__ import annotations

import argparse
import sys
from importlib import resources
from typing import Any

from camtopod.cli import exits

SHELLS = {
    "bash": "~/.local/share/bash-completion/completions/camtopod",
    "zsh": "_camtopod, in a directory of $fpath",
    "fish": "~/.config/fish/completions/camtopod.fish",
}
"""Shell -> where it looks for the script."""


def add_parser(subparsers: Any) -> None:
    """Add `completion`."""
    places = "; ".join(f"{shell}: {place}" for shell, place in SHELLS.items())
    parser = subparsers.add_parser(
        "completion",
        help="print a script that completes commands and options in a shell",
        description="Prints a script that completes camtopod's commands and options in a shell. "
        f"Save it as: {places}.",
        epilog=f"example: camtopod completion fish > {SHELLS['fish']}",
    )
    parser.add_argument("shell", choices=tuple(SHELLS), help="shell to print the script for")


def run(args: argparse.Namespace) -> int:
    """Print the script."""
    file = resources.files("camtopod.cli") / "completions" / f"camtopod.{args.shell}"
    sys.stdout.write(file.read_text(encoding="utf-8"))
    return exits.DONE
