"""`camtopod forget`: a camera and all that was learned of it leaves the site."""

from __future__ import annotations

import argparse
from typing import Any

from camtopod.admin import Forget, TakeBack
from camtopod.cli.common import camera_id
from camtopod.cli.operator.carry_out import carry_out


def add_parser(subparsers: Any) -> None:
    """Add `forget`."""
    parser = subparsers.add_parser(
        "forget",
        help="remove a camera and all that was learned of it",
        description="Removes a camera from the site: its zones, links, counters and events. The "
        "next version, made at once, is without it. Events that still come under its name are "
        "refused until the name is taken back. For a camera with a new name, use "
        "rename.",
        epilog="example: camtopod --site hq forget lobby",
    )
    parser.add_argument("camera", type=camera_id, metavar="CAMERA", help="the camera")
    parser.add_argument(
        "--take-back",
        action="store_true",
        help="accept events of this forgotten name again, as of a new camera",
    )


def run(args: argparse.Namespace) -> int:
    """Forget the camera, or take that back."""
    if args.take_back:
        return carry_out(args, TakeBack(args.camera))
    return carry_out(args, Forget(args.camera))
