"""`camtopod keys`: create a private authority for a site and certificates for its bus."""

from __future__ import annotations

import argparse
import ipaddress
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from camtopod.cli.common import camera_id, configuration, say
from camtopod.cli.exits import CommandError
from camtopod.config import Config, secret_files
from camtopod.keys import rules
from camtopod.keys.rules import DAEMON
from camtopod.serve.runtime import clock

if TYPE_CHECKING:
    from camtopod.keys.authority import Authority

DAYS = 5 * 365
"""Default validity of a certificate."""
ACCESS = "access.json"
"""File name of the access list."""
_HOST = re.compile(r"(?!-)[A-Za-z0-9-]{1,63}(\.[A-Za-z0-9-]{1,63})*")
"""A host name, or an address with dots."""
_FILES = {"ca": "ca.pem", "certificate": "certificate.pem", "private_key": "private.key"}
"""Setting of [bus.tls] -> file."""

SUBCOMMANDS = {
    "init": (
        "create an authority and the daemon's certificate",
        "camtopod keys init --host 192.0.2.10",
    ),
    "daemon": (
        "issue a new certificate for the daemon, or for a zenoh router; with --site, for that of a "
        "further site of a city",
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


def add_parser(add: Any) -> list[argparse.ArgumentParser]:
    """Add `keys` with its subcommands; return their parsers."""
    parser = add(
        description="Creates a private certificate authority for a site and issues certificates. "
        "Each has a folder of its own; copy only this folder to the machine that uses it. The "
        "daemon needs the list of who may do what (access.json): copy it again and restart the "
        "daemon after every change.",
        epilog="example: camtopod keys camera lobby hall",
    )
    parser.add_argument(
        "--keys",
        type=Path,
        default=Path("camtopod-keys"),
        metavar="FOLDER",
        help="folder of the authority and the certificates (default: %(default)s)",
    )
    parser.set_defaults(names=[DAEMON], role="daemon", host=[], cameras=[], also=[])
    commands = parser.add_subparsers(dest="keys_command", metavar="WHAT", required=True)
    inner = {
        name: commands.add_parser(name, help=text, epilog=f"example: {example}")
        for name, (text, example) in SUBCOMMANDS.items()
    }

    # The options of each.
    inner["revoke"].add_argument(
        "role", choices=("camera", "reader"), help="role of the certificate"
    )
    for name in ("camera", "reader", "revoke"):
        inner[name].add_argument(
            "names",
            nargs="+",
            metavar="NAME",
            type=camera_id,
            help="the camera's id, or any name for a reader",
        )
    for name in ("camera", "reader"):
        inner[name].set_defaults(role=name)
    inner["camera"].add_argument(
        "--for",
        dest="cameras",
        action="append",
        default=[],
        metavar="CAMERA",
        type=camera_id,
        help="NAME is a program that publishes events of several cameras (`camtopod ingest`), and "
        "CAMERA is one of them; may be repeated",
    )
    inner["camera"].add_argument(
        "--also",
        action="append",
        default=[],
        metavar="SITE",
        type=camera_id,
        help="another site of this authority to which the camera delivers; may be repeated "
        "(default: as before)",
    )
    for name in ("init", "daemon", "camera", "reader"):
        _add_certificate(inner[name], for_hosts=name in ("init", "daemon"))
    return [*inner.values()]


def _add_certificate(parser: argparse.ArgumentParser, for_hosts: bool) -> None:
    """Add the options of a certificate to issue."""
    if for_hosts:
        parser.add_argument(
            "--host",
            action="append",
            default=[],
            metavar="NAME",
            type=_host,
            help="host name or address at which others connect to the daemon; may be repeated "
            "(default: as before)",
        )
    parser.add_argument(
        "--days",
        type=_days,
        default=DAYS,
        metavar="N",
        help="validity of the certificate, days (default: %(default)s)",
    )
    parser.add_argument(
        "--replace", action="store_true", help="replace the existing one, which loses its rights"
    )


def _host(text: str) -> str:
    """Parse a host name or an address."""
    try:
        return text if _HOST.fullmatch(text) else str(ipaddress.IPv6Address(text))
    except ValueError:
        sentence = f"{text!r} is neither a host name nor an address, without a port"
        raise argparse.ArgumentTypeError(sentence) from None


def _days(text: str) -> int:
    """Parse a number of days."""
    if not re.fullmatch("[1-9][0-9]{0,4}", text):
        raise argparse.ArgumentTypeError("must be a whole number of days from 1 to 99999")
    return int(text)


def run(args: argparse.Namespace) -> None:
    """Run a subcommand; messages go to standard error, the list to standard output."""
    from camtopod.keys.authority import KeysError  # the help works without cryptography

    config = configuration(args)
    try:
        _run(args, config)
    except KeysError as error:
        raise CommandError(str(error)) from None
    except OSError as error:
        raise CommandError(f"{error.filename or args.keys}: {error.strerror}") from None


def _run(args: argparse.Namespace, config: Config) -> None:
    """Open or create the authority, then issue, revoke or list certificates."""
    from camtopod.keys.authority import Authority

    subcommand = args.keys_command
    now = clock.wall()
    if subcommand == "init":
        authority = Authority.create(args.keys, config.site.name, now, args.replace)
        say(
            f"created an authority for site {authority.site} in {args.keys / 'authority'}: "
            f"its private key need never leave this folder"
        )
    else:
        authority = Authority(args.keys, now)
    site = args.site or authority.site
    for name in [site, *args.also] if subcommand != "daemon" else ():
        if name not in authority.sites:
            raise CommandError(
                f"{args.keys} is the authority of site {' and '.join(authority.sites)}, not of "
                f"{name}: `camtopod keys --site {name} daemon` adds a site"
            )
    if args.cameras and len(args.names) > 1:
        raise CommandError("--for needs exactly one NAME: the program that publishes the events")

    # The access list follows from the ledger, whatever an earlier command could not write.
    try:
        if subcommand == "list":
            _list(authority, now)
            return
        for name in args.names:
            if subcommand == "revoke":
                authority.revoke(args.role, name, "" if site == authority.site else site)
            else:
                _issue(authority, args, config, name)
    finally:
        _write_access(authority, config, with_router=subcommand != "list")
    if args.role != "daemon":
        for site in authority.sites:
            path = authority.home(site) / DAEMON / ACCESS
            of_site = f" of site {site}" if len(authority.sites) > 1 else ""
            say(f"now copy {path} to the daemon{of_site} and restart it")


def _issue(authority: Authority, args: argparse.Namespace, config: Config, name: str) -> None:
    """Issue one certificate, with an example configuration in its folder."""
    from camtopod.keys.authority import LOCAL_HOSTS, date_text

    site = args.site or authority.site
    sites = [site, *args.also] if args.site or args.also or args.role != "camera" else []
    folder = authority.issue(
        args.role, name, args.days, args.replace, args.host, args.cameras, sites
    )
    certificate = authority.entries[-1].certificate
    example = _example(site, config, certificate, folder.name)
    secret_files.write(folder / "camtopod.toml", example.encode())
    say(
        f"{folder}: valid until {date_text(certificate.expires)}; copy this folder to the machine "
        f"that uses it (camtopod.toml in it is an example)"
    )
    if args.role == "daemon":
        hosts = [host for host in authority.hosts(site) if host not in LOCAL_HOSTS]
        if hosts:
            say(f"valid for connections to {', '.join(hosts)}")
        else:
            say("valid on this machine only: add host names or addresses with --host")


def _write_access(authority: Authority, config: Config, with_router: bool) -> None:
    """Write each site's access list, if it has changed, and the same for a separate router."""
    listen = [endpoint for endpoint in config.bus.listen if endpoint.startswith("tls/")]
    for site in authority.sites:
        folder = authority.home(site) / DAEMON
        access = msgspec.json.format(msgspec.json.encode(authority.access(site)), indent=1)
        text = rules.router_json5(
            authority.access(site), listen or ["tls/[::]:7447"], config.bus.message_bytes_max
        )
        path = folder / ACCESS
        if not path.exists() or path.read_bytes() != access:
            secret_files.write(path, access)
        if with_router:
            secret_files.write(folder / "router.json5", text.encode())


def _example(site: str, config: Config, certificate: rules.Certificate, folder: str) -> str:
    """Return an example configuration for the machine that a certificate folder is copied to.

    folder: name of the certificate's folder.
    """
    camera = certificate.camera
    key_folder = f"keys/{'{camera}' if camera else folder}"
    connect = [endpoint for endpoint in config.bus.connect if endpoint.startswith("tls/")]
    bus = f"connect = {msgspec.json.encode(connect or ['tls/DAEMON:7447']).decode()}"
    tls = [f'{key} = "{key_folder}/{file}"' for key, file in _FILES.items()]
    cameras = []
    if certificate.role == "daemon":
        bus = 'listen = ["tls/0.0.0.0:7447"]   # or the address of one interface'
        tls.append(f'access = "{key_folder}/{ACCESS}"')
    if camera:
        sites = certificate.sites[1:]
        cameras = [f'\n[sites."{site_name}"]\nconnect = ["tls/ROUTER:7447"]' for site_name in sites]
        cameras += [
            f'\n[cameras."{camera}"]',
            f'source_file = "secrets/{camera}"   # contains the rtsp:// URL; mode 600',
        ]
        cameras += [f"sites = {json.dumps(certificate.sites)}"] if sites else []
    lines = [
        f'[site]\nname = "{site}"\n\n[bus]\n{bus}\n',
        "# The folders of `camtopod keys` are copied to keys/ beside this file.",
        "[bus.tls]",
        *tls,
        *cameras,
    ]
    return "\n".join(lines) + "\n"


def _list(authority: Authority, now: float) -> None:
    """Print all certificates, with a warning for those that expire soon."""
    from camtopod.keys.authority import date_text

    ending = [
        certificate.name
        for site in authority.sites
        for certificate, _ in rules.expiring_certificates(authority.access(site), now)
    ]
    print(f"{'name':<20} {'role':<7} {'certificate':<24} {'until':<10} {'days':>6}")
    for entry in authority.entries:
        certificate = entry.certificate
        days = (certificate.expires - now) / 86400.0
        until = date_text(certificate.expires)
        remark = ""
        if certificate.cameras:
            remark = f" for {', '.join(certificate.cameras)}"
        if certificate.sites:
            remark += f" in {', '.join(certificate.sites)}"
        if not entry.valid:
            remark += " revoked"
        elif certificate.name in ending:
            remark += " EXPIRES SOON"
            say(
                f"warning: {certificate.role} {entry.of} expires on {until}; "
                f"renew it with --replace"
            )
        print(
            f"{entry.of:<20} {certificate.role:<7} {certificate.name:<24} {until:<10} "
            f"{days:>6.0f}{remark}"
        )
