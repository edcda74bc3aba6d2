"""`camtopod keys`: a private authority for a site, and a certificate for each that may be on its
bus.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import msgspec

from camtopod.cli import exits
from camtopod.cli.common import configuration
from camtopod.cli.exits import CommandError
from camtopod.config import Config
from camtopod.keys import (
    ACCESS,
    DAEMON,
    LOCAL_HOSTS,
    Authority,
    KeysError,
    check_cameras,
    check_hosts,
    day,
    rules,
    write_public,
)
from camtopod.serve.runtime import clock

DEFAULT_FOLDER = Path("camtopod-keys")
DAYS = 5 * 365
AUTHORITY_DAYS = 20 * 365
_DAYS_MAX = 100 * 365
_INSTALLED = "keys"
"""Where the folders are copied to, beside the configuration."""

_ROLES: dict[str, rules.Role] = {
    "init": "daemon",
    "daemon": "daemon",
    "camera": "camera",
    "reader": "reader",
}
"""The certificates that a command gives out."""


def add_parser(subparsers: Any) -> list[argparse.ArgumentParser]:
    """Add `keys` with its own commands, which it returns."""
    parser = subparsers.add_parser(
        "keys",
        help="certificates for the bus",
        description="Makes a private authority for a site and gives out certificates. Each has a folder of its own, "
        "which is all that is copied to where it is used. The daemon has the list of who may do what (access.json): "
        "copy it again and restart the daemon after every change.",
    )
    commands = parser.add_subparsers(dest="keys_command", metavar="WHAT", required=True)
    init = commands.add_parser("init", help="a new authority, and the daemon's certificate")
    init.add_argument(
        "--authority-days",
        type=_days,
        default=AUTHORITY_DAYS,
        metavar="N",
        help="default: %(default)s",
    )
    daemon = commands.add_parser("daemon", help="a new certificate for the daemon, or for a router")
    camera = commands.add_parser("camera", help="a certificate for each camera")
    camera.add_argument(
        "--for",
        dest="cameras",
        action="append",
        default=[],
        metavar="CAMERA",
        help="NAME is no camera but a program with events of several (`camtopod ingest`), of which this is one; "
        "may be repeated",
    )
    reader = commands.add_parser(
        "reader", help="a certificate for a program that reads topology and predictions"
    )
    revoke = commands.add_parser("revoke", help="take a camera's or a reader's rights away")
    listing = commands.add_parser("list", help="who has what, and until when")
    revoke.add_argument("role", choices=("camera", "reader"))
    for named in (camera, reader, revoke):
        named.add_argument(
            "names", nargs="+", metavar="NAME", help="the camera's id, or any name for a reader"
        )
    for hosted, default in ((init, ""), (daemon, " (default: as before)")):
        hosted.add_argument(
            "--host",
            action="append",
            default=[],
            metavar="NAME",
            help=f"name or address under which the others dial the daemon; may be repeated{default}",
        )
    for made in (init, daemon, camera, reader):
        made.add_argument(
            "--days",
            type=_days,
            default=DAYS,
            metavar="N",
            help="valid for so long (default: %(default)s)",
        )
        made.add_argument(
            "--replace", action="store_true", help="make it anew; the old one loses its rights"
        )
    inner = [init, daemon, camera, reader, revoke, listing]
    for its, folder in [(parser, DEFAULT_FOLDER), *((each, argparse.SUPPRESS) for each in inner)]:
        its.add_argument(
            "--keys", type=Path, default=folder, metavar="FOLDER", help=f"default: {DEFAULT_FOLDER}"
        )
    return inner


def run(args: argparse.Namespace) -> int:
    """What it did goes to standard error, the list to standard output."""
    config = configuration(args)
    try:
        return _run(args, config)
    except KeysError as error:
        raise CommandError(str(error)) from None
    except OSError as error:
        raise CommandError(f"{error.filename or args.keys}: {error.strerror}") from None


def _run(args: argparse.Namespace, config: Config) -> int:
    what, folder, now = args.keys_command, args.keys, clock.wall()
    if what == "init":
        check_hosts(args.host)
        if args.days > args.authority_days:
            raise KeysError(
                "the daemon's certificate cannot outlive the authority: give fewer --days"
            )
        authority = Authority.make(folder, config.site.name, now, args.authority_days, args.replace)
        _say(
            f"a new authority for site {authority.site} in {folder / 'authority'}: its key never has to leave it"
        )
    else:
        authority = Authority(folder, now)
        if args.site is not None and args.site != authority.site:
            raise KeysError(
                f"{folder} is the authority of site {authority.site}, not of {args.site}"
            )
    if what == "list":
        return _list(authority, now)
    names = [DAEMON] if what in ("init", "daemon") else args.names
    if len(set(names)) < len(names):
        raise KeysError("the same name is given twice")
    if what == "camera" and args.cameras:
        check_cameras(args.cameras)
        if len(names) > 1:
            raise KeysError("--for goes with one NAME: that of the program which has the events")
    for name in names:  # all or none
        if what == "revoke":
            authority.must_have(args.role, name)
        else:
            authority.next_name(_ROLES[what], name, args.days, args.replace)
    try:
        for name in names:
            if what == "revoke":
                authority.revoke(args.role, name)
            else:
                _give(authority, args, config, _ROLES[what], name)
    finally:  # the list is never behind what has been given out or taken away
        _write_access(authority, config)
    if what not in ("init", "daemon"):
        _say(f"now copy {folder / DAEMON / ACCESS} to the daemon and restart it")
    return exits.DONE


def _give(
    authority: Authority, args: argparse.Namespace, config: Config, role: rules.Role, name: str
) -> None:
    hosts = args.host if role == "daemon" else []
    cameras = args.cameras if role == "camera" else []
    folder = authority.issue(role, name, args.days, args.replace, hosts, cameras)
    several = bool(authority.issued[-1].certificate.cameras)
    write_public(folder / "camtopod.toml", _example(authority.site, config, role, name, several))
    who = name if role == "daemon" else f"{role} {name}"
    expires = authority.issued[-1].certificate.expires
    _say(
        f"{who}: {folder}, until {day(expires)}; copy this folder, with camtopod.toml as an example"
    )
    if role == "daemon":
        where = ", ".join(host for host in authority.hosts if host not in LOCAL_HOSTS)
        _say(
            f"to be dialled as {where}"
            if where
            else "good on its own machine only: name others with --host"
        )


def _write_access(authority: Authority, config: Config) -> None:
    """Who may do what, for the daemon that is the meeting point, and for a router of its own."""
    folder = authority.folder / DAEMON
    write_public(
        folder / ACCESS,
        msgspec.json.format(msgspec.json.encode(authority.access), indent=1).decode(),
    )
    listen = [endpoint for endpoint in config.bus.listen if endpoint.startswith("tls/")] or [
        "tls/[::]:7447"
    ]
    text = rules.router_json5(
        authority.access, listen, config.bus.message_bytes_max, config.limits.pull_events_max
    )
    write_public(folder / "router.json5", text)


def _example(site: str, config: Config, role: rules.Role, name: str, several: bool) -> str:
    """A configuration for where the folder is copied to; ``several``: of a program with several
    cameras.
    """
    own = {"daemon": DAEMON, "camera": name if several else "{camera}", "reader": name}[role]
    lines = [f'[site]\nname = "{site}"\n', "[bus]"]
    if role == "daemon":
        lines.append('listen = ["tls/0.0.0.0:7447"]   # or the address of one interface')
    else:
        endpoints = [
            f'"{endpoint}"' for endpoint in config.bus.connect if endpoint.startswith("tls/")
        ]
        lines.append(f"connect = [{', '.join(endpoints) or chr(34) + 'tls/DAEMON:7447' + chr(34)}]")
    lines += [
        f"\n# The folders of `camtopod keys` are copied to {_INSTALLED}/ beside this file.",
        "[bus.tls]",
        *(f'{key} = "{_INSTALLED}/{own}/{file}"' for key, file in _FILES.items()),
    ]
    if role == "daemon":
        lines.append(f'access = "{_INSTALLED}/{own}/{ACCESS}"')
    if role == "camera" and not several:
        lines.append(
            f'\n[cameras.{_toml_key(name)}]\nsource_file = "secrets/{name}"   # holds the rtsp:// URL; mode 600'
        )
    return "\n".join(lines) + "\n"


_FILES = {"ca": "ca.pem", "certificate": "certificate.pem", "private_key": "private.key"}


def _toml_key(name: str) -> str:
    return f'"{name}"' if "." in name else name


def _list(authority: Authority, now: float) -> int:
    ending = {certificate.name for certificate, _ in rules.expiring(authority.access, now)}
    print(f"{'name':<20} {'role':<7} {'certificate':<24} {'until':<10} {'days':>6}")
    for issued in authority.issued:
        certificate = issued.certificate
        days = (certificate.expires - now) / 86400.0
        remark = "withdrawn" if not issued.valid else ""
        if issued.valid and certificate.name in ending:
            remark = "EXPIRED" if days < 0 else "EXPIRES SOON"
            _say(
                f"warning: {certificate.role} {issued.of}: {remark.lower()}, {day(certificate.expires)}; use --replace"
            )
        line = f"{issued.of:<20} {certificate.role:<7} {certificate.name:<24} {day(certificate.expires):<10} {days:>6.0f}"
        several = f"for {', '.join(certificate.cameras)}" if certificate.cameras else ""
        print(" ".join(filter(None, (line, several, remark))))
    return exits.DONE


def _days(text: str) -> int:
    if not text.isdigit() or not 1 <= int(text) <= _DAYS_MAX:
        raise argparse.ArgumentTypeError(f"a whole number of days from 1 to {_DAYS_MAX}")
    return int(text)


def _say(message: str) -> None:
    print(message, file=sys.stderr)
