"""`camtopod web`: serve the web page."""

from __future__ import annotations

import argparse
import contextlib
import logging
import os
import re
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from camtopod.cli import exits
from camtopod.cli.common import (
    configuration,
    ends_within,
    reporting_to_systemd,
    start_logging,
    until_signal,
)
from camtopod.cli.exits import CommandError, InputError
from camtopod.cli.site_choice import add_districts, dial_sites
from camtopod.config import ADDRESS_PATTERN, Config, secret_files
from camtopod.serve.bus import access
from camtopod.serve.runtime import Progress, clock

if TYPE_CHECKING:
    from camtopod.web import login as logins

log = logging.getLogger(__name__)

LEAVE_SECONDS = 5.0
"""Time that a blocking part may delay the end after a signal."""


def add_parser(add: Any) -> None:
    """Add `web`."""
    parser = add(
        description="Serves a web page with the learned topology and with predictions as they "
        "arrive. The page is read-only and loads nothing from other sites. Several sites are one "
        "map: a camera's data comes from the site that owns it.",
        epilog="example: camtopod --config camtopod.toml web --listen 127.0.0.1:8780",
    )
    add_address(parser)
    add_districts(parser)


def add_address(parser: argparse.ArgumentParser) -> None:
    """Add the options of the page's address."""
    parser.add_argument(
        "--listen",
        metavar="HOST:PORT",
        help="address to listen on; port 0: a free one (default: [web] listen)",
    )
    parser.add_argument(
        "--name",
        metavar="NAME",
        action="append",
        default=[],
        help="additional host name to accept, for example behind a reverse proxy (addresses need "
        "none); may be repeated",
    )


def run(args: argparse.Namespace) -> None:
    """Serve the page until SIGTERM or SIGINT."""
    start_logging(args)
    from camtopod.web import app  # needs starlette and uvicorn

    # Check the options.
    config = configuration(args)
    listen = args.listen or config.web.listen
    host, port = address(listen)
    is_public = not access.is_local(f"tcp/{listen}")
    pictures = config.web.pictures_folder
    if pictures is not None and not os.access(pictures, os.R_OK | os.X_OK):
        reason = "no permission to read it" if pictures.exists() else "no such directory"
        log.warning("[web] pictures %s: %s; cameras are shown without pictures", pictures, reason)

    login = _login(config)
    if (plan := config.map.plan) and not os.access(plan, os.R_OK):
        raise InputError(f"cannot read [map] plan {plan}: no such file, or no permission")

    # Listen, connect to the bus and serve.
    with contextlib.ExitStack() as stack:
        stop = stack.enter_context(until_signal())
        stack.enter_context(ends_within(stop, LEAVE_SECONDS, args.with_parent))
        listener = stack.enter_context(listening(host, port))
        bus, config = dial_sites(args, config)
        stack.enter_context(bus)
        progress = Progress()
        is_running = stack.enter_context(
            app.serving(
                bus,
                listener,
                names(host, args.name),
                clock.wall,
                config,
                is_public,
                progress,
                login,
            )
        )
        stack.enter_context(
            reporting_to_systemd(progress, f"the page is at http://{_shown(listener)}/")
        )
        log.info("the page is at http://%s/", _shown(listener))
        if is_public:
            warning = "the password crosses the network unencrypted without a proxy with https"
            if login is None:
                warning = "there is no password ([web] password_file): anyone can read the page"
            log.warning("%s listens beyond this machine: %s", _shown(listener), warning)
        while not stop.wait(1.0):
            if not is_running():  # it has printed its traceback
                raise CommandError("the web server has failed, see above; start it again")


def _login(config: Config) -> logins.Login | None:
    """Return the login of the configured password and token, if any.

    Raises `OSError`, `CommandError`.
    """
    from camtopod.web import login as logins

    if not config.web.password_file:
        return None
    files = (config.web.password_file, config.web.token_file)
    paths = [Path(file) for file in files if file]
    if sentences := secret_files.find_exposed(paths):
        raise CommandError(f"[web]: {sentences[0]}", exits.CONFIG)
    password, *token = [secret_files.read(path) for path in paths]
    try:
        return logins.Login(password, token[0] if token else None)
    except ValueError as error:
        raise CommandError(f"[web]: {error}", exits.CONFIG) from None


def address(text: str) -> tuple[str, int]:
    """Parse HOST:PORT (``[::1]:8780`` for IPv6). Raises `CommandError`."""
    match = re.match(ADDRESS_PATTERN, text)
    if match is None or int(match[2]) > 65535:
        raise CommandError(
            f"--listen {text!r}: write it like 127.0.0.1:8780 or 0.0.0.0:8780", exits.USAGE
        )
    return match[1].strip("[]"), int(match[2])


def names(host: str, further: Sequence[str] = ()) -> list[str]:
    """Return the host names to answer to, besides IP addresses.

    Others are refused: through a name that resolves to this machine, the page of another site could
    read this one (DNS rebinding).
    """
    host_name = socket.gethostname()
    return ["localhost", host_name, f"{host_name}.local", host, *further]


def listening(host: str, port: int) -> socket.socket:
    """Return a listening socket. Raises `CommandError`."""
    try:
        return socket.create_server(
            (host, port), family=socket.AF_INET6 if ":" in host else socket.AF_INET
        )
    except OSError as error:
        raise CommandError(
            f"--listen {host}:{port}: {error.strerror}; choose another port, or 0"
        ) from None


def _shown(listener: socket.socket) -> str:
    """Return the socket's address as HOST:PORT."""
    host, port = listener.getsockname()[:2]
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
