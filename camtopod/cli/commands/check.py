"""`camtopod check`: list all mistakes in a configuration; with --probe, open its cameras and the
bus.
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
    parser = subparsers.add_parser(
        "check",
        help="check a configuration and list all mistakes",
        description="Checks a configuration and lists all mistakes in one pass.",
        epilog="example: camtopod check camtopod.toml --probe",
    )
    parser.add_argument(
        "file",
        nargs="?",
        type=Path,
        metavar="CONFIG",
        help="the configuration file (default: that of --config)",
    )
    parser.add_argument(
        "--example",
        action="store_true",
        help="print an example configuration with every setting, its default and its unit",
    )
    parser.add_argument(
        "--probe", action="store_true", help="also open each of its cameras, and the bus"
    )
    parser.add_argument(
        "--pictures",
        metavar="DIR",
        type=Path,
        help="with --probe: store a picture of each camera as DIR/NAME.jpg, replacing an older "
        "one; `camtopod web` and `report` draw zones on it. It is stored only there and not sent",
    )
    parser.add_argument(
        "--schema",
        action="store_true",
        help="print the JSON Schema of the configuration, for editors",
    )


def run(args: argparse.Namespace) -> int:
    """Check the configuration.

    Mistakes go to standard error as ``file:line: what``, as do warnings of files and a bus that are
    open to others.
    """
    if args.example:
        from camtopod.cli.generated import example

        sys.stdout.write(example())
        return exits.DONE
    if args.schema:
        from camtopod.cli.generated import text

        sys.stdout.write(text())
        return exits.DONE

    # Load the configuration, or list its mistakes.
    if args.pictures is not None and not args.probe:
        raise CommandError(
            "--pictures needs --probe, which opens the cameras: give both", exits.USAGE
        )
    path = args.file or args.config
    if path is None:
        raise CommandError("no configuration given: camtopod check CONFIG", exits.USAGE)
    try:
        loaded = with_options(args, settings.load(path))
    except settings.ConfigError as error:
        print(error, file=sys.stderr)
        return exits.CONFIG
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from None

    # Warn of files and a bus that are open to others.
    warnings = secret_files.find_exposed(loaded.secrets(path))
    warnings += [] if (open_to := access.openness_warning(loaded)) is None else [open_to]
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
