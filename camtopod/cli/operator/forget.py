"""`camtopod forget`: a camera and all that was learned of it leaves the site.

`carry_out` sends this and every other command of an operator to the daemon.
"""

from __future__ import annotations

import argparse
import contextlib
import shlex
from typing import Any

from camtopod import codec
from camtopod.admin import Command, Forget, TakeBack
from camtopod.cli import exits
from camtopod.cli.common import camera_id, configuration, start_logging
from camtopod.cli.exits import CommandError
from camtopod.cli.site_choice import right_site
from camtopod.config import Config
from camtopod.records import GrabberStatus
from camtopod.serve.admin_queries import Done, parameters_of
from camtopod.serve.bus import Bus, QueryError, dial
from camtopod.visible import visible

ANSWER_SECONDS = 30.0
"""Longest wait for the daemon's answer; it answers when the command is on its disk."""


def add_parser(add: Any) -> None:
    """Add `forget`."""
    parser = add(
        description="Removes a camera from the site: its zones, links, counters and events. The "
        "next version, made at once, is without it. Events that still come under its name are "
        "refused until the name is taken back. For a camera with a new name, use "
        "rename.",
        epilog="example: camtopod --site hq forget lobby",
    )
    parser.add_argument("name", type=camera_id, metavar="CAMERA", help="the camera")
    parser.add_argument(
        "--take-back",
        action="store_true",
        help="accept events of this forgotten name again, as of a new camera",
    )


def run(args: argparse.Namespace) -> None:
    """Forget the camera, or take that back."""
    command: Command = Forget(args.name)
    if args.take_back:
        command = TakeBack(args.name)
    carry_out(args, command)


def carry_out(args: argparse.Namespace, command: Command) -> None:
    """Send a command to the daemon; print its answer, and the command for other sites it concerns.

    The site is that of ``--site`` or of the configuration, never another one. Raises
    `CommandError`.
    """
    start_logging(args)
    config = configuration(args)
    key, parameters = parameters_of(command)
    with dial(config) as bus:
        sites = _other_sites(bus, config, parameters.get("camera") or parameters.get("old"))
        try:
            answers = bus.query(key, parameters, ANSWER_SECONDS, one=True)
        except QueryError as error:
            raise CommandError(str(error)) from None
        if not answers:
            message = f"no daemon of site {bus.site} answers at {bus.endpoint}"
            message += right_site(bus, config)
            if config.bus.tls.ca:
                message += "; with certificates, only that of the daemon may do this"
            raise CommandError(message, exits.BUS)
    try:
        print(visible(codec.read(Done, answers[0][1], pack=True).done))
    except codec.Rejected as error:
        raise CommandError(f"the answer of the daemon cannot be read: {error}") from None

    # No site's certificate may act in another.
    words = [args.command, *parameters.values()]
    words += ["--take-back"] if isinstance(command, TakeBack) else []
    for site in sites:
        connect = config.sites[site].connect if site in config.sites else ()
        options = ["--site", site, *(word for place in connect for word in ("--connect", place))]
        print(f"site {site} is unchanged; with its certificate: ", end="")
        print(shlex.join(["camtopod", *options, *words]))


def _other_sites(bus: Bus, config: Config, camera: str | None) -> list[str]:
    """Return the other sites to which ``camera``, or without one any camera of the site, delivers.

    The configuration says so, and the statuses of the grabbers that run.
    """
    cameras = config.cameras if camera is None else [camera]
    sites = {site for name in cameras for site in config.sites_of(name)}
    with contextlib.suppress(QueryError):
        for _, payload in bus.query(f"status/{camera or '*'}"):
            with contextlib.suppress(codec.Rejected):
                sites.update(codec.read(GrabberStatus, payload, pack=True).sites)
    return sorted(sites - {bus.site})
