"""`camtopod check`: every mistake in a configuration, in one pass, and what of it is there; or an
example.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from camtopod.cli import exits
from camtopod.cli.common import with_options
from camtopod.cli.exits import CommandError, InputError
from camtopod.config import secret_files, settings
from camtopod.serve.bus import access


def add_parser(subparsers: Any) -> None:
    """Add `check`."""
    summary = "every mistake in a configuration, in one pass"
    parser = subparsers.add_parser("check", help=summary, description=summary.capitalize() + ".")
    parser.add_argument(
        "file", nargs="?", type=Path, metavar="CONFIG", help="the configuration (or --config)"
    )
    parser.add_argument(
        "--example",
        action="store_true",
        help="write an example with every setting, its default and its unit",
    )
    parser.add_argument(
        "--probe", action="store_true", help="also open every camera of it, and the bus"
    )
    parser.add_argument(
        "--pictures",
        metavar="DIR",
        type=Path,
        help="with --probe: keep a picture of each camera here, DIR/NAME.jpg instead of an older one, which "
        "`camtopod web` and `report` draw on; it is stored here only and not sent",
    )
    parser.add_argument(
        "--schema", action="store_true", help="write the configuration's JSON Schema, for editors"
    )


def run(args: argparse.Namespace) -> int:
    """Mistakes go to standard error as ``file:line: what``, and so do warnings of what is open to
    others.
    """
    if args.example:
        from camtopod.cli.generated import example

        sys.stdout.write(example())
        return exits.DONE
    if args.schema:
        from camtopod.cli.generated import text

        sys.stdout.write(text())
        return exits.DONE
    if args.pictures is not None and not args.probe:
        raise CommandError(
            "--pictures is for --probe, which opens the cameras: give both", exits.USAGE
        )
    path = args.file or args.config
    if path is None:
        raise CommandError("which configuration? camtopod check CONFIG", exits.USAGE)
    try:
        loaded = with_options(args, settings.load(path))
    except settings.ConfigError as error:
        print(error, file=sys.stderr)
        return exits.CONFIG
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from None
    warnings = secret_files.exposed(loaded.secrets(path))
    warnings += [] if (open_to := access.openness(loaded)) is None else [open_to]
    for warning in warnings:
        print(f"{path}: warning: {warning}", file=sys.stderr)
    print(
        f"{path}: no mistakes; site {loaded.site.name}, {_cameras(len(loaded.cameras))}",
        file=sys.stderr,
    )
    if not args.probe:
        return exits.DONE
    from camtopod.cli.cameras import check_site

    return check_site(path, loaded, args.pictures)


def _cameras(number: int) -> str:
    return f"{number} {'camera' if number == 1 else 'cameras'}"
