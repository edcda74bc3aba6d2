"""`camtopod rename`: rename a camera and keep everything learned about it."""

from __future__ import annotations

import argparse
from typing import Any

from camtopod.admin import Rename
from camtopod.cli.common import camera_id
from camtopod.cli.operator.forget import carry_out


def add_parser(add: Any) -> None:
    """Add `rename`."""
    parser = add(
        description="Renames a camera. Its zones, links, events and clock offset are kept under "
        "the new name. Events that still come under the old name count for the new one, until the "
        "first comes under the new name; from then on the old name is refused, as after forget.",
        epilog="example: camtopod --site hq rename lobby entrance",
    )
    parser.add_argument("old", type=camera_id, metavar="OLD", help="the camera's name so far")
    parser.add_argument(
        "new", type=camera_id, metavar="NEW", help="its new name, which no other has"
    )


def run(args: argparse.Namespace) -> None:
    """Rename the camera."""
    carry_out(args, Rename(args.old, args.new))
