"""`camtopod judge`: mark links with an operator's word on them."""

from __future__ import annotations

import argparse
import re
from typing import Any

from camtopod.admin import Judge
from camtopod.cli.operator.carry_out import add_state_option, carry_out
from camtopod.soundness import PLACE_PATTERN

VERDICTS = ("right", "wrong", "none")
"""Words on a link; ``none`` takes one back."""


def add_parser(subparsers: Any) -> None:
    """Add `judge`."""
    parser = subparsers.add_parser(
        "judge",
        help="mark a link as right or wrong",
        description="Marks the links from one zone, or all from one camera, to another with your "
        "word on them. It is shown wherever links are shown, and stays with the zones; it does not "
        "change what is learned and predicted. Passages through one view are not marked.",
        epilog="example: camtopod --site hq judge lobby/1 hall/2 wrong",
    )
    parser.add_argument("source", type=_place, metavar="FROM", help="a camera, or a zone CAMERA/N")
    parser.add_argument("target", type=_place, metavar="TO", help="a camera, or a zone CAMERA/N")
    parser.add_argument("verdict", choices=VERDICTS, help="none takes an earlier word back")
    add_state_option(parser)


def run(args: argparse.Namespace) -> int:
    """Mark the links."""
    return carry_out(args, Judge(args.source, args.target, args.verdict))


def _place(text: str) -> str:
    if not re.match(PLACE_PATTERN, text):
        raise argparse.ArgumentTypeError(f"{text!r} is neither a camera nor a zone like lobby/1")
    return text
