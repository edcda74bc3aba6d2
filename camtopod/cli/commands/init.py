"""`camtopod init`: probe cameras and write a configuration, with passwords in files beside it."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from msgspec.structs import replace

from camtopod.cli import exits
from camtopod.cli.common import (
    configuration,
    counted,
    is_standard_output,
    open_output,
    say,
    writing,
)
from camtopod.cli.exits import CommandError, InputError
from camtopod.cli.generated import table
from camtopod.config import TABLES, CameraSettings, Config, ConfigError, config_file, secret_files
from camtopod.redact import redact
from camtopod.visible import visible
from camtopod.vision.source import SETTLE_SECONDS_MAX, Probe, file_path, is_path

if TYPE_CHECKING:
    from camtopod.cli.cameras.finding import Findings

FOUND = Path("camtopod.toml")
"""The configuration that other commands find without --config."""
SECRETS = "secrets"
"""Folder of the passwords, beside the configuration."""
CREDENTIALS = "$CREDENTIALS_DIRECTORY"
"""Directory in which systemd gives a service its files; deploy's units take them from `SECRETS`."""
PICTURES = "pictures"
"""Folder of the cameras' pictures, beside the configuration."""
HEALTH = "127.0.0.1:8787"
"""Address at which a daemon run as a service reports its health."""
_HEAD = """\
# Made by `camtopod init`. `camtopod check FILE` checks it, with --probe also its cameras;
# `camtopod check --example` shows every other setting.
"""


def add_parser(add: Any) -> None:
    """Add `init`."""
    parser = add(
        description="Probes each camera and writes a commented configuration with all of them, or "
        "adds them at the end of one that exists, whose text stays as it is. A "
        "camera is named after its host or file, or as given: lobby=rtsp://... A URL with a "
        f"password or a token goes into a file of its own in the folder {SECRETS} beside the "
        "configuration, which only you can read.",
        epilog="example: camtopod init lobby=rtsp://192.0.2.10/stream1 hall=rtsp://192.0.2.11/",
    )
    parser.add_argument(
        "sources",
        nargs="+",
        metavar="[NAME=]SOURCE",
        help="rtsp:// URL, video file or device number; onvif://USER:PASSWORD@HOST asks the camera "
        "for its streams, and of an rtsp:// URL without a path those of the common makers are "
        "tried; '-': read them from standard input, one a line, as other users of this machine can "
        "read passwords on a command line",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=FOUND,
        metavar="FILE",
        help="configuration file to write or to add to (default: %(default)s); '-': print it, "
        "and store nothing",
    )
    parser.add_argument(
        "--pictures",
        metavar="DIR",
        type=Path,
        help="also store a picture of each camera as DIR/NAME.jpg, for the page; it becomes [web] "
        "pictures, as does what you answer on a terminal. It shows the scene without the people "
        "who walk through it, and takes 6 to 30 seconds. It is stored only there and not sent; "
        "`init` stores no other picture",
    )
    parser.add_argument(
        "--credentials",
        action="store_true",
        help=f"for systemd services, whose users cannot read {SECRETS}: every camera's source goes "
        f"into a file of that folder, and the configuration refers to it as {CREDENTIALS}/NAME, "
        f"where systemd passes it to the camera's service; the daemon reports its health at "
        f"{HEALTH}",
    )
    parser.add_argument(
        "--force", action="store_true", help="overwrite existing files, also the configuration"
    )


def run(args: argparse.Namespace) -> int:
    """Probe the cameras and write the configuration; messages go to standard error.

    A camera that cannot be opened at the moment is in the configuration, too.
    """
    from camtopod.cli.cameras.finding import streams_by_onvif
    from camtopod.cli.cameras.naming import named_sources

    # Read the configuration to add to, if there is one.
    is_printed = is_standard_output(args.out)
    is_addition = not is_printed and args.out.exists() and not args.force
    if is_addition:
        args.config = args.out
        args.config_found = False  # it is needed
    settings = configuration(args)
    sources = named_sources(args.sources)
    if is_addition:
        _require_new(args.out, sources, settings)

    # Find the cameras' streams.
    findings = streams_by_onvif(sources, settings.cameras if is_addition else ())
    for name, reason in findings.reasons.items():
        say(f"  {name}  left out: {visible(reason)}")
    cameras = findings.urls
    if not cameras:
        raise InputError("no camera says where its stream is, see above")
    secrets = {
        name: args.out.parent / SECRETS / name
        for name, source in cameras.items()
        if args.credentials or redact(source) != source
    }
    pictures = _pictures_folder(args, settings, is_addition)
    paths = [] if is_printed else [*secrets.values()]
    if pictures is not None:
        paths += [pictures / f"{name}.jpg" for name in cameras]
    present_paths = [str(path) for path in paths if path.exists()]
    if present_paths and not args.force:
        raise CommandError(
            f"{', '.join(present_paths)}: exists already; overwrite with --force, or write "
            f"elsewhere with --out"
        )

    # Probe the cameras, then write the configuration and the secrets.
    cameras, probes = _probed(findings, settings, pictures)
    tables = camera_tables(cameras, probes, secrets.keys(), args.credentials)
    mode = 0o644  # the services' users have to read it; it contains no password
    if is_addition:
        mode = args.out.stat().st_mode & 0o777
        text = with_cameras(args.out, tables)
    else:
        text = configuration_text(settings, tables, args.credentials, _beside(args.out, pictures))
    with writing(args.out):
        for name, path in secrets.items():
            if not is_printed:
                path.parent.mkdir(mode=0o700, exist_ok=True)
                secret_files.write(path, _located(cameras[name]).encode() + b"\n")
        with open_output(args.out, mode) as file:
            file.write(text.encode())

    # Say what comes next.
    say(f"{'standard output' if is_printed else args.out} has {', '.join(cameras)}")
    if secrets:
        say(_place_of_secrets(args.out, secrets))
    if pictures is not None and pictures != settings.web.pictures_folder and is_addition:
        say(f"for the page to show the pictures, set [web] pictures in {args.out}")
    say(_next(args, settings, cameras))
    if findings.reasons or any(probe.problem for probe in probes.values()):
        return exits.INPUT
    return exits.DONE


def _require_new(out: Path, names: Collection[str], settings: Config) -> None:
    """Raise `CommandError` if the configuration ``out`` has some of the cameras already."""
    twice = sorted(settings.cameras.keys() & set(names))
    if twice:
        files = [settings.cameras[name].source_file for name in twice]
        places = " and ".join(filter(None, ["that table", *files]))
        raise CommandError(
            f"{out} has cameras.{', cameras.'.join(twice)} already: give another name "
            f"(NAME=SOURCE) or edit {places}; --force writes the whole file anew"
        )


def _place_of_secrets(out: Path, names: Collection[str]) -> str:
    """Return a sentence on where the sources of some cameras are; none is printed."""
    if not is_standard_output(out):
        return f"sources with secrets are in {out.parent / SECRETS}, readable only by you"
    return (
        f"not stored: the sources of {', '.join(names)}, which belong into files of these names in "
        f"{SECRETS} beside the configuration; --out FILE stores them"
    )


def _pictures_folder(args: argparse.Namespace, settings: Config, is_addition: bool) -> Path | None:
    """Return where to keep a picture of each camera; None: nowhere.

    A new configuration's user is asked, on a terminal that has nothing else to read.
    """
    if args.pictures is not None or is_addition:
        return args.pictures or settings.web.pictures_folder
    if args.credentials or "-" in args.sources or is_standard_output(args.out):
        return None
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return None
    say(
        "Keep a picture of each camera for the page? It shows the empty scene and stays on this "
        "machine. [Y/n]"
    )
    return args.out.parent / PICTURES if input().strip().lower() in ("", "y", "yes") else None


def _beside(out: Path, folder: Path | None) -> str:
    """Return the folder as the configuration ``out`` names it; empty for none."""
    if folder is None:
        return ""
    path, base = folder.absolute(), out.parent.absolute()
    return str(path.relative_to(base) if path.is_relative_to(base) else path)


def _probed(
    findings: Findings, settings: Config, pictures: Path | None
) -> tuple[dict[str, str], dict[str, Probe]]:
    """Return sources and probe results of the cameras, by camera id.

    findings: other sources are returned where a camera's stream is found elsewhere.
    pictures: folder for a picture of each; None for none.
    """
    from camtopod.cli.cameras.finding import streams_as_named, streams_by_path
    from camtopod.cli.cameras.probe import probe_all

    def described(urls: Mapping[str, str]) -> dict[str, CameraSettings]:
        return {name: replace(settings.new_camera, source=url) for name, url in urls.items()}

    def tell(name: str, probe: Probe) -> None:
        probe.remarks.extend(findings.remarks.get(name, ()))
        say(f"  {name}  {'; '.join(_words(probe))}")

    # Probe the streams as they are given.
    cameras = dict(findings.urls)
    say(f"probing {counted(len(cameras), 'camera')} ...")
    if pictures is not None:
        say(f"a picture takes up to {SETTLE_SECONDS_MAX:.0f} s")
    probes = probe_all(described(cameras), tell, pictures)

    def look(urls: Mapping[str, str]) -> Mapping[str, Probe]:
        return probe_all(described(urls), lambda name, probe: None)

    # Where a URL has no path, take the maker's; where another host was named, that one.
    result = {
        name: (url, f"found as by {maker}", probe)
        for name, (url, maker, probe) in streams_by_path(cameras, probes, look).items()
    }
    for name, (url, probe) in streams_as_named(findings.other_urls, probes, look).items():
        result[name] = (url, "found at the host that it names", probe)
    for name, (url, remark, probe) in result.items():
        probe.remarks.append(remark)
        tell(name, probe)
        cameras[name] = url
        probes[name] = probe
    return cameras, probes


def _words(probe: Probe) -> list[str]:
    return [visible(line) for line in probe.lines]


def configuration_text(
    settings: Config, tables: Sequence[str], credentials: bool = False, pictures: str = ""
) -> str:
    """Return the text of the configuration.

    tables: those of the cameras.
    credentials: systemd passes the cameras' sources to the services.
    pictures: folder of the cameras' pictures; empty for none.
    """
    bus = {}
    if settings.bus.connect:
        bus["connect"] = settings.bus.connect
    parts = [
        _HEAD,
        table("site", TABLES["site"], {"name": settings.site.name}),
        "# One table per camera; its name is the camera's id on the bus and free to choose.",
        *tables,
        table("bus", TABLES["bus"], bus),
        table("state", TABLES["state"], {}),
    ]
    if pictures:
        parts.append(table("web", TABLES["web"], {"pictures": pictures}))
    if credentials and not settings.bus.connect:  # otherwise the daemon is on another machine
        parts.append(table("health", TABLES["health"], {"listen": HEALTH}))
    return "\n".join(part.rstrip("\n") + "\n" for part in parts)


def camera_tables(
    cameras: Mapping[str, str],
    probes: Mapping[str, Probe],
    secret: Collection[str],
    credentials: bool = False,
) -> list[str]:
    """Return the table of each camera.

    cameras: source by camera id.
    probes: what is said of each camera in comments.
    secret: cameras whose source is in a file of its own, which the configuration names.
    credentials: systemd passes these files to the services.
    """
    folder = SECRETS
    if credentials:
        folder = CREDENTIALS
    parts = []
    for name, source in cameras.items():
        key = name
        if "." in name:
            key = f'"{name}"'
        setting = "source"
        value = _located(source)
        if name in secret:
            setting = "source_file"
            value = f"{folder}/{name}"
        lines = [f"[cameras.{key}]", *(f"# {word}" for word in _words(probes[name]))]
        lines.append(f"{setting} = {json.dumps(value, ensure_ascii=False)}")
        parts.append("\n".join(lines))
    return parts


def with_cameras(out: Path, tables: Sequence[str]) -> str:
    """Return the text of the configuration ``out`` with further tables at its end.

    Raises `CommandError` if that is no configuration.
    """
    text = "\n\n".join([out.read_bytes().decode(), *tables, ""])
    try:
        config_file.parse(text)
    except ConfigError as error:
        raise CommandError(
            f"{out}: tables cannot be added at its end ({str(error).splitlines()[0]}); write "
            f"cameras as tables [cameras.NAME], or use another --out",
            exits.CONFIG,
        ) from None
    return text


def _located(source: str) -> str:
    """Return the source, a file with its absolute path: programs may start in another directory."""
    return str(Path(file_path(source)).absolute()) if is_path(source) else source


def _next(args: argparse.Namespace, settings: Config, cameras: Collection[str]) -> str:
    """Return the next commands; a daemon on another machine runs already."""
    elsewhere = bool(settings.bus.connect)
    out, step = args.out, "next"
    if is_standard_output(out):
        out, step = FOUND, f"next, with it stored as {FOUND}"
    if not args.credentials:
        command = "camtopod" if out == FOUND else f"camtopod --config {out}"
        if elsewhere:
            return f"{step}: {command} grab"
        return f"{step}: {command} up, then open http://{settings.web.listen}/"
    services = [f"camtopod-grab@{name}" for name in cameras]
    services = ["camtopod", "camtopod-web"] * (not elsewhere) + services
    folder = (out.parent / SECRETS).absolute()
    return (
        f"{step}, with the units of deploy/ installed as described in deploy/README.md:\n"
        f"    systemctl enable --now {' '.join(services)}\n"
        f"    {CREDENTIALS[1:]}={folder} camtopod check {out} --probe"
    )
