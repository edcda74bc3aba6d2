"""Command-line options of an MQTT broker: URL, password and trusted authorities."""

from __future__ import annotations

import argparse
import contextlib
import logging
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from camtopod import mqtt
from camtopod.cli import exits
from camtopod.cli.exits import CommandError
from camtopod.config import secret_files

log = logging.getLogger(__name__)

PASSWORD_VARIABLE = "CAMTOPOD_MQTT_PASSWORD"
"""Environment variable with the password."""


def add_options(group: Any) -> None:
    """Add the options beside the URL to a parser or a group."""
    group.add_argument(
        "--password-file",
        type=Path,
        metavar="FILE",
        help=f"file with the MQTT user's password (default: ${PASSWORD_VARIABLE})",
    )
    group.add_argument(
        "--ca",
        metavar="FILE",
        help="mqtts: file of the certificate authorities to trust (default: the system's)",
    )


def broker_of(args: argparse.Namespace, url: str, prefix: str = "") -> mqtt.Broker:
    """Return the broker at ``url``; ``prefix`` as for `mqtt.broker`.

    Raises `OSError`, `CommandError`.
    """
    password = os.environ.get(PASSWORD_VARIABLE) or None
    if args.password_file is not None:
        password = secret_files.read(args.password_file)
        for sentence in secret_files.find_exposed([args.password_file]):
            log.warning("%s", sentence)
    try:
        return mqtt.broker(url, password, args.ca, prefix)
    except ValueError as error:
        raise CommandError(str(error), exits.USAGE) from None


@contextlib.contextmanager
def connecting(status: int) -> Iterator[None]:
    """Turn an unreachable broker into a `CommandError` with ``status``, and a missing paho-mqtt,
    too.
    """
    try:
        yield
    except mqtt.MqttError as error:
        raise CommandError(str(error), status) from None
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] != "paho":
            raise
        raise CommandError(
            "MQTT needs the package paho-mqtt: pip install 'camtopod[mqtt]'"
        ) from None
