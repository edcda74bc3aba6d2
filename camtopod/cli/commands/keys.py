"""`camtopod keys`: create a private authority for a site and certificates for its bus."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from camtopod.cli import exits
from camtopod.cli.common import configuration
from camtopod.cli.exits import CommandError
from camtopod.config import Config
from camtopod.keys import rules
from camtopod.serve.runtime import clock

if TYPE_CHECKING:
    from camtopod.keys.authority import Authority

DEFAULT_FOLDER = Path("camtopod-keys")
"""Folder of the authority and the certificates."""
DAYS = 5 * 365
"""Default validity of a certificate."""
AUTHORITY_DAYS = 20 * 365
"""Default validity of the authority."""
_DAYS_MAX = 100 * 365
"""Longest validity."""
_INSTALLED = "keys"
"""Directory beside the configuration to which certificate folders are copied."""

_ROLES: dict[str, rules.Role] = {
    "init": "daemon",
    "daemon": "daemon",
    "camera": "camera",
    "reader": "reader",
}
"""Subcommand -> role of the certificate that it issues."""


SUBCOMMANDS = {
    "init": (
        "create an authority and the daemon's certificate",
        "camtopod keys init --host 192.0.2.10",
    ),
    "daemon": (
        "issue a new certificate for the daemon, or for a zenoh router",
        "camtopod keys daemon --host 192.0.2.10 --replace",
    ),
    "camera": ("issue a certificate for each camera", "camtopod keys camera lobby hall"),
    "reader": (
        "issue a certificate for a program that reads topology and predictions",
        "camtopod keys reader web",
    ),
    "revoke": ("revoke the certificate of a camera or reader", "camtopod keys revoke camera lobby"),
    "list": ("list all certificates and when they expire", "camtopod keys list"),
}
"""Help and example of each subcommand."""


def add_parser(subparsers: Any) -> list[argparse.ArgumentParser]:
    """Add `keys` with its subcommands; return their parsers."""
    parser = subparsers.add_parser(
        "keys",
        help="create a private certificate authority and certificates for the bus",
        description="Creates a private certificate authority for a site and issues certificates. "
        "Each has a folder of its own; copy only this folder to the machine that uses it. The "
        "daemon needs the list of who may do what (access.json): copy it again and restart the "
        "daemon after every change.",
        epilog="example: camtopod keys camera lobby hall",
    )
    commands = parser.add_subparsers(dest="keys_command", metavar="WHAT", required=True)
    inner = {
        name: commands.add_parser(name, help=text, epilog=f"example: {example}")
        for name, (text, example) in SUBCOMMANDS.items()
    }
    _add_own_options(inner)
    _add_shared_options(inner)

    # The folder may be given before or after the subcommand.
    for its, folder in [
        (parser, DEFAULT_FOLDER),
        *((x, argparse.SUPPRESS) for x in inner.values()),
    ]:
        its.add_argument(
            "--keys",
            type=Path,
            default=folder,
            metavar="FOLDER",
            help=f"folder of the authority and the certificates (default: {DEFAULT_FOLDER})",
        )
    return [*inner.values()]


def _add_own_options(inner: dict[str, argparse.ArgumentParser]) -> None:
    """Add the options of single subcommands."""
    inner["init"].add_argument(
        "--authority-days",
        type=_days,
        default=AUTHORITY_DAYS,
        metavar="N",
        help="validity of the authority, days (default: %(default)s)",
    )
    inner["camera"].add_argument(
        "--for",
        dest="cameras",
        action="append",
        default=[],
        metavar="CAMERA",
        help="NAME is a program that publishes events of several cameras (`camtopod ingest`), and "
        "CAMERA is one of them; may be repeated",
    )
    inner["revoke"].add_argument(
        "role", choices=("camera", "reader"), help="role of the certificate"
    )


def _add_shared_options(inner: dict[str, argparse.ArgumentParser]) -> None:
    """Add the options that several subcommands have."""
    for name in ("camera", "reader", "revoke"):
        inner[name].add_argument(
            "names", nargs="+", metavar="NAME", help="the camera's id, or any name for a reader"
        )
    for name, default in (("init", ""), ("daemon", " (default: as before)")):
        inner[name].add_argument(
            "--host",
            action="append",
            default=[],
            metavar="NAME",
            help="host name or address at which others connect to the daemon; may be "
            f"repeated{default}",
        )
    for name in ("init", "daemon", "camera", "reader"):
        inner[name].add_argument(
            "--days",
            type=_days,
            default=DAYS,
            metavar="N",
            help="validity of the certificate, days (default: %(default)s)",
        )
        inner[name].add_argument(
            "--replace",
            action="store_true",
            help="replace the existing one, which loses its rights",
        )


def run(args: argparse.Namespace) -> int:
    """Run a subcommand; messages go to standard error, the list to standard output."""
    config = configuration(args)
    try:
        from camtopod.keys.authority import KeysError
    except ModuleNotFoundError as error:  # the help works without it
        raise CommandError(
            f"keys needs the package {error.name!r}, which is not installed; see README, 'Packages'"
        ) from None
    try:
        return _run(args, config)
    except KeysError as error:
        raise CommandError(str(error)) from None
    except OSError as error:
        raise CommandError(f"{error.filename or args.keys}: {error.strerror}") from None


def _run(args: argparse.Namespace, config: Config) -> int:
    """Open or create the authority, then issue, revoke or list certificates."""
    from camtopod.keys.authority import (
        ACCESS,
        DAEMON,
        Authority,
        KeysError,
        check_cameras,
        check_hosts,
    )

    what = args.keys_command
    folder = args.keys
    now = clock.wall()
    if what == "init":
        check_hosts(args.host)
        if args.days > args.authority_days:
            raise KeysError(
                "the daemon's certificate cannot outlive the authority: give fewer --days"
            )
        authority = Authority.create(
            folder, config.site.name, now, args.authority_days, args.replace
        )
        _say(
            f"created an authority for site {authority.site} in {folder / 'authority'}: "
            f"its private key need never leave this folder"
        )
    else:
        authority = Authority(folder, now)
        if args.site is not None and args.site != authority.site:
            raise KeysError(
                f"{folder} is the authority of site {authority.site}, not of {args.site}"
            )

    # Check all names before the first certificate is issued or revoked.
    if what == "list":
        return _list(authority, now)
    names = [DAEMON] if what in ("init", "daemon") else args.names
    if len(set(names)) < len(names):
        raise KeysError("the same name is given twice")
    if what == "camera" and args.cameras:
        check_cameras(args.cameras)
        if len(names) > 1:
            raise KeysError("--for needs exactly one NAME: the program that publishes the events")
    for name in names:
        if what == "revoke":
            authority.require_certificate(args.role, name)
        else:
            authority.next_name(_ROLES[what], name, args.days, args.replace)

    # Issue or revoke; the access list is written even if this fails half-way.
    try:
        for name in names:
            if what == "revoke":
                authority.revoke(args.role, name)
            else:
                _give(authority, args, config, _ROLES[what], name)
    finally:
        _write_access(authority, config)
    if what not in ("init", "daemon"):
        _say(f"now copy {folder / DAEMON / ACCESS} to the daemon and restart it")
    return exits.DONE


def _give(
    authority: Authority, args: argparse.Namespace, config: Config, role: rules.Role, name: str
) -> None:
    """Issue one certificate, with an example configuration in its folder."""
    from camtopod.keys.authority import LOCAL_HOSTS, date_text, write_public

    hosts = getattr(args, "host", [])
    cameras = getattr(args, "cameras", [])
    folder = authority.issue(role, name, args.days, args.replace, hosts, cameras)
    several = bool(authority.issued[-1].certificate.cameras)
    write_public(folder / "camtopod.toml", _example(authority.site, config, role, name, several))
    who = name if role == "daemon" else f"{role} {name}"
    expires = date_text(authority.issued[-1].certificate.expires)
    _say(
        f"{who}: {folder}, valid until {expires}; copy this folder to the machine that "
        f"uses it (camtopod.toml in it is an example)"
    )
    if role == "daemon":
        where = ", ".join(host for host in authority.hosts if host not in LOCAL_HOSTS)
        if where:
            _say(f"valid for connections to {where}")
        else:
            _say("valid on this machine only: add host names or addresses with --host")


def _write_access(authority: Authority, config: Config) -> None:
    """Write the access list, for the daemon and for a separate zenoh router."""
    from camtopod.keys.authority import ACCESS, DAEMON, write_public

    folder = authority.folder / DAEMON
    write_public(
        folder / ACCESS,
        msgspec.json.format(msgspec.json.encode(authority.access), indent=1).decode(),
    )
    listen = [endpoint for endpoint in config.bus.listen if endpoint.startswith("tls/")] or [
        "tls/[::]:7447"
    ]
    text = rules.router_json5(authority.access, listen, config.bus.message_bytes_max)
    write_public(folder / "router.json5", text)


def _example(site: str, config: Config, role: rules.Role, name: str, several: bool) -> str:
    """Return an example configuration for the machine that a certificate folder is copied to.

    several: the certificate is for a program with events of several cameras.
    """
    from camtopod.keys.authority import ACCESS, DAEMON

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
            f"\n[cameras.{_toml_key(name)}]\n"
            f'source_file = "secrets/{name}"   # contains the rtsp:// URL; mode 600'
        )
    return "\n".join(lines) + "\n"


_FILES = {"ca": "ca.pem", "certificate": "certificate.pem", "private_key": "private.key"}


def _toml_key(name: str) -> str:
    """Return a camera's id as a TOML key."""
    return f'"{name}"' if "." in name else name


def _list(authority: Authority, now: float) -> int:
    """Print all certificates, with a warning for those that expire soon."""
    from camtopod.keys.authority import date_text

    ending = {
        certificate.name for certificate, _ in rules.expiring_certificates(authority.access, now)
    }
    print(f"{'name':<20} {'role':<7} {'certificate':<24} {'until':<10} {'days':>6}")
    for issued in authority.issued:
        certificate = issued.certificate
        days = (certificate.expires - now) / 86400.0
        remark = ""
        if not issued.valid:
            remark = "revoked"
        elif certificate.name in ending:
            remark = "EXPIRED" if days < 0 else "EXPIRES SOON"
            _say(
                f"warning: {certificate.role} {issued.of}: {remark.lower()}, "
                f"{date_text(certificate.expires)}; renew it with --replace"
            )
        line = (
            f"{issued.of:<20} {certificate.role:<7} {certificate.name:<24} "
            f"{date_text(certificate.expires):<10} {days:>6.0f}"
        )
        if certificate.cameras:
            line += f" for {', '.join(certificate.cameras)}"
        print(f"{line} {remark}".rstrip())
    return exits.DONE


def _days(text: str) -> int:
    """Parse a number of days."""
    if not text.isdigit() or not 1 <= int(text) <= _DAYS_MAX:
        raise argparse.ArgumentTypeError(f"must be a whole number of days from 1 to {_DAYS_MAX}")
    return int(text)


def _say(message: str) -> None:
    print(message, file=sys.stderr)
