"""`camtopod reset`: start the site from scratch."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from camtopod.admin import Reset
from camtopod.cli import exits
from camtopod.cli.common import configuration
from camtopod.cli.exits import CommandError
from camtopod.cli.operator.forget import carry_out


def add_parser(add: Any) -> None:
    """Add `reset`."""
    parser = add(
        description="Begins the site anew: nothing is learned, no camera is known, no name is "
        "forgotten, and the versions count from 1 in a new epoch. Earlier events are not "
        "learned, wherever they still are. The journal keeps them as long as others.",
        epilog="example: camtopod --site hq reset --yes",
    )
    parser.add_argument("--yes", action="store_true", help="do not ask for confirmation")


def run(args: argparse.Namespace) -> None:
    """Begin the site anew, once that is confirmed."""
    if not args.yes:
        _confirm(args)
    carry_out(args, Reset())


def _confirm(args: argparse.Namespace) -> None:
    """Ask for the site's name on the terminal. Raises `CommandError` without the right answer."""
    warning = "everything that was learned is forgotten"
    if not sys.stdin.isatty():
        raise CommandError(f"{warning}: confirm it with --yes", exits.USAGE)
    site = configuration(args).site.name
    print(f"{warning} of site {site}; type its name to go on: ", end="", flush=True)
    if sys.stdin.readline().strip() != site:
        raise CommandError("not confirmed: nothing was changed")
