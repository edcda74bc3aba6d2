"""Send an operator's command to the daemon."""

from __future__ import annotations

import argparse

from camtopod import codec
from camtopod.admin import Command
from camtopod.cli import exits
from camtopod.cli.common import configuration, start_logging
from camtopod.cli.exits import CommandError
from camtopod.cli.site_choice import right_site
from camtopod.config import Config
from camtopod.serve.admin_queries import Done, parameters_of
from camtopod.serve.bus import Bus, QueryError, dial

ANSWER_SECONDS = 30.0
"""Longest wait for the daemon's answer; it answers when the command is on its disk."""


def carry_out(args: argparse.Namespace, command: Command) -> int:
    """Execute a command, print the result, and return the exit status.

    The site is that of ``--site`` or of the configuration, never another one. Raises
    `CommandError`.
    """
    start_logging(args)
    config = configuration(args)
    with dial(config) as bus:
        print(_asked(bus, config, command))
    return exits.DONE


def _asked(bus: Bus, config: Config, command: Command) -> str:
    """Return the daemon's answer to a command. Raises `CommandError`."""
    key, parameters = parameters_of(command)
    try:
        answers = bus.query(key, parameters, ANSWER_SECONDS, one=True)
    except QueryError as error:
        raise CommandError(str(error)) from None
    if answers:
        return codec.read(Done, answers[0][1], pack=True).done
    certificate = (
        "; with certificates, only that of the daemon may do this" if config.bus.tls.ca else ""
    )
    raise CommandError(
        f"no daemon of site {bus.site} answers at {bus.endpoint}{right_site(bus, config)}"
        f"{certificate}",
        exits.BUS,
    )
