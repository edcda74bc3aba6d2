"""`camtopod init`: looks at cameras and writes a configuration with them, their passwords in files
beside it.
"""

from __future__ import annotations

import argparse
import ipaddress
import json
import re
import sys
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from camtopod.cli import exits
from camtopod.cli.common import configuration
from camtopod.cli.exits import CommandError, InputError
from camtopod.cli.generated import table
from camtopod.config import RESERVED, TABLES, Config, secret_files
from camtopod.redact import holds_secret, redact
from camtopod.visible import visible
from camtopod.vision.source import kind_of, percent_encoded
from camtopod.web import pictures

SECRETS = "secrets"
"""The folder of the passwords, beside the configuration."""
CREDENTIALS = "$CREDENTIALS_DIRECTORY"
"""Where systemd hands a service's files to it: the units of deploy/ take them from `SECRETS`."""
HEALTH = "127.0.0.1:8787"
"""Where a daemon that is a service answers."""
NAME_CHARACTERS_MAX = 64
_GIVEN = re.compile(r"([A-Za-z0-9_.-]{1,64})=(.+)", re.DOTALL)
_HEAD = """\
# Made by `camtopod init`. `camtopod check FILE` says whether it is right, with --probe also whether
# its cameras are there; `camtopod check --example` shows every other setting.
"""
_OF_A_FILE = "# a file is read once, as fast as it decodes; with realtime = true at its own pace"


def add_parser(subparsers: Any) -> None:
    """Add `init`."""
    parser = subparsers.add_parser(
        "init",
        help="looks at cameras and writes a configuration with them",
        description="Looks at each camera and writes a commented configuration with all of them. A camera is called "
        "after its host or path, or as you say: lobby=rtsp://... A URL with a password or a token goes into a "
        f"file of its own in the folder {SECRETS} beside the configuration, which only you can read.",
    )
    parser.add_argument(
        "sources",
        nargs="+",
        metavar="[NAME=]SOURCE",
        help="rtsp:// URL, video file or device number; '-': read them from standard input, a line each, as others on "
        "this machine can read passwords on a command line",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("camtopod.toml"),
        metavar="FILE",
        help="write it here (default: %(default)s)",
    )
    parser.add_argument(
        "--pictures",
        metavar="DIR",
        type=Path,
        help="also keep a picture of each camera here, DIR/NAME.jpg, which `camtopod web` and `report` draw on; it is "
        "stored here only and not sent. No other picture is ever stored",
    )
    parser.add_argument(
        "--credentials",
        action="store_true",
        help=f"for systemd's services, whose users cannot read {SECRETS}: every camera's source goes into a file of "
        f"that folder, and the configuration names it as {CREDENTIALS}/NAME, where systemd hands it to that camera's "
        f"service; the daemon tells how it is at {HEALTH}",
    )
    parser.add_argument(
        "--force", action="store_true", help="overwrite files that are there already"
    )


def run(args: argparse.Namespace) -> int:
    """Messages go to standard error. A camera that cannot be watched at the moment is in the
    configuration, too.
    """
    from camtopod.cli.cameras import probe_all

    settings = configuration(args)
    cameras = named(_given(args.sources))
    folder, handed = args.out.parent / SECRETS, args.credentials
    secrets = {
        name: folder / name
        for name, source in cameras.items()
        if handed or redact(source) != source
    }
    if not args.out.parent.is_dir():
        raise CommandError(f"cannot write {args.out}: {args.out.parent} is no directory")
    kept = (
        [] if args.pictures is None else [pictures.kept_at(args.pictures, name) for name in cameras]
    )
    there = [path for path in (args.out, *secrets.values(), *kept) if path.exists()]
    if there and not args.force:
        raise CommandError(
            f"{', '.join(map(str, there))}: there already; --force overwrites, --out writes elsewhere"
        )
    width = max(map(len, cameras))
    _say(f"looking at {len(cameras)} {'camera' if len(cameras) == 1 else 'cameras'} ...")
    probes = probe_all(
        cameras,
        settings.vision,
        lambda name, probe: _say(f"  {name:<{width}}  {visible('; '.join(probe.words))}"),
        args.pictures,
    )
    words = {name: [visible(word) for word in probe.words] for name, probe in probes.items()}
    text = written(settings, cameras, words, secrets.keys(), handed)
    try:
        _write(args.out, text, {path: _located(cameras[name]) for name, path in secrets.items()})
        if handed:
            args.out.chmod(
                0o644
            )  # the services' users have to read it, and there is no password in it
    except OSError as error:
        raise CommandError(f"cannot write {error.filename or args.out}: {error.strerror}") from None
    what = "the sources" if handed else "URLs with secrets"
    where = f", {what} are in {folder}, for you alone" if secrets else ""
    _say(f"{args.out} is written{where}")
    _say(_next_services(args.out, settings, cameras) if handed else _next(args.out, settings))
    return exits.INPUT if any(probe.problem for probe in probes.values()) else exits.DONE


def named(given: Sequence[tuple[str, str]]) -> dict[str, str]:
    """Id -> source. A source without a name gets one from its host or path, a number behind it
    where it is taken.
    """
    short = Counter(_short(source) for name, source in given if not name)
    cameras: dict[str, str] = {}
    for name, source in given:
        if name in (*cameras, *RESERVED, ".", ".."):
            raise CommandError(
                f"{name}: two cameras cannot have this name, or it is taken; use another",
                exits.USAGE,
            )
        if not name:
            own = _short(source)
            own = own if short[own] == 1 else _long(source)
            taken = {*cameras, *RESERVED, *(name for name, _ in given)}
            numbers = (
                f"{own[: NAME_CHARACTERS_MAX - 5]}-{number}" for number in range(2, len(given) + 3)
            )
            name = next(one for one in (own, *numbers) if one not in taken)
        cameras[name] = source
    return cameras


def written(
    settings: Config,
    cameras: Mapping[str, str],
    words: Mapping[str, Sequence[str]],
    secret: Collection[str],
    handed: bool = False,
) -> str:
    """The configuration; of those in ``secret`` it names the file that has the source, ``handed``
    to a service.
    """
    bus = {"connect": settings.bus.connect} if settings.bus.connect else {}
    parts = [_HEAD, table("site", TABLES["site"], {"name": settings.site.name})]
    parts.append(
        "# One table a camera; its name is the camera's id on the bus. Call it as you like."
    )
    folder = CREDENTIALS if handed else SECRETS
    for name, source in cameras.items():
        key = name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else f'"{name}"'
        where = (
            ("source_file", f"{folder}/{name}") if name in secret else ("source", _located(source))
        )
        lines = [f"[cameras.{key}]", *(f"# {word}" for word in words[name])]
        lines += [_OF_A_FILE] if kind_of(source) == "file" else []
        parts.append(
            "\n".join([*lines, f"{where[0]} = {json.dumps(where[1], ensure_ascii=False)}"])
        )
    parts += [table("bus", TABLES["bus"], bus), table("state", TABLES["state"], {})]
    if handed and not settings.bus.connect:  # else the daemon is elsewhere
        parts.append(table("health", TABLES["health"], {"listen": HEALTH}))
    return "\n".join(part.rstrip("\n") + "\n" for part in parts)


def _given(arguments: Sequence[str]) -> list[tuple[str, str]]:
    """(name or "", source) of each; ``-`` stands for the lines of standard input."""
    found: list[tuple[str, str]] = []
    for argument in arguments:
        for line in sys.stdin if argument == "-" else [argument]:
            if not (text := line.strip()).isprintable():
                raise CommandError(f"{text!a}: no source has such characters in it", exits.USAGE)
            match = _GIVEN.fullmatch(text)
            found += [(match[1], match[2])] if match else [("", text)] if text else []
    if not found:
        raise InputError("no camera was named on standard input")
    return found


def _short(source: str) -> str:
    """A camera's id from its host, or where that is this machine from its path."""
    kind = kind_of(source)
    if kind == "device":
        return f"device-{int(source)}"
    if kind == "file":
        return _id(Path(source).stem)
    host = _host(source)
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        label = host.partition(".")[0]
        return _id(label) if label != "localhost" else _id(_path(source))
    return _id(_path(source)) if address.is_loopback else _id(host)


def _long(source: str) -> str:
    """The same where several have the same host."""
    return (
        _id(f"{_host(source)} {_path(source)}") if kind_of(source) == "stream" else _short(source)
    )


def _host(source: str) -> str:
    try:
        return urlsplit(percent_encoded(source)).hostname or ""
    except ValueError:
        return ""


def _path(source: str) -> str:
    """The URL's path, if there is no secret in it."""
    try:
        path = urlsplit(percent_encoded(source)).path
    except ValueError:
        return ""
    return "" if holds_secret(f"rtsp://host{path}") else path


def _id(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9_]+", "-", text).strip("-")[:NAME_CHARACTERS_MAX] or "camera"


def _located(source: str) -> str:
    """A file is found from wherever the program is started."""
    return (
        str(Path(source.removeprefix("file://")).absolute())
        if kind_of(source) == "file"
        else source
    )


def _write(out: Path, text: str, secrets: Mapping[Path, str]) -> None:
    for path, source in secrets.items():
        path.parent.mkdir(mode=0o700, exist_ok=True)
        secret_files.write(path, source.encode() + b"\n")
    out.write_text(text, encoding="utf-8")


def _next(out: Path, settings: Config) -> str:
    """The two commands that come now; where another machine has the daemon, it is asked for
    first.
    """
    if settings.bus.connect:
        return f"next:\n    camtopod check {out} --probe\n    camtopod --config {out} grab"
    return f"next, each in a terminal of its own:\n    camtopod --config {out} run\n    camtopod --config {out} grab"


def _next_services(out: Path, settings: Config, cameras: Collection[str]) -> str:
    """The same where they are services."""
    daemon = "" if settings.bus.connect else "camtopod camtopod-web "
    services = daemon + " ".join(f"camtopod-grab@{name}" for name in cameras)
    return (
        f"next, with the units of deploy/ installed as its README says:\n    systemctl enable --now {services}\n"
        f"    {CREDENTIALS[1:]}={(out.parent / SECRETS).absolute()} camtopod check {out} --probe"
    )


def _say(text: str) -> None:
    print(redact(text), file=sys.stderr, flush=True)
