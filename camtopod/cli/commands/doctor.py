"""`camtopod doctor`: collect diagnostics for a bug report, without secrets.

`camtopod.redact` processes everything twice: each value by itself, and the whole text.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import re
import shutil
import stat
import sys
import tarfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec

from camtopod.cli import exits, machine_report
from camtopod.cli.common import configuration, with_options
from camtopod.cli.exits import CommandError
from camtopod.config import TABLES, Config, secret_files
from camtopod.redact import redact, remember
from camtopod.serve.bus import BusError, access, dial, sites_instead
from camtopod.serve.runtime import clock
from camtopod.serve.storage import StateError, inspect_state
from camtopod.visible import visible

FILES_MAX = 200
"""Most files of the state directory that are listed."""
_BUNDLES = (".tar.gz", ".tgz")
"""File names that ask for an archive with one file per part."""
_LOOKS = {"journal.db": inspect_state.journal, "spools-of-*/*.db": inspect_state.spool}
"""Pattern of a database's path -> function that returns its counts."""
_SECRET_NAME = re.compile(r"(?i)pass|pwd|secret|token|credential")
"""Names of environment variables whose values are secrets."""
_SECRET_CHARACTERS_MIN = 6
"""Least length of a secret in an environment variable; 'true' and 'false' are none."""
_REFUSALS = ("rejects", "reject_samples")
"""Keys of a status that say what was refused."""
_QUOTED = re.compile(r""": ['"].*""", re.DOTALL)
"""The quoted part of a refused message, which is not reported."""


def add_parser(subparsers: Any) -> None:
    """Add `doctor`."""
    parser = subparsers.add_parser(
        "doctor",
        help="collect diagnostics for a bug report, without secrets",
        description="Collects diagnostics for a bug report: versions, machine, clock, "
        "configuration, files on disk, and the statuses of the daemon and the cameras. It contains "
        "no passwords, keys or events; look through it all the same before you share it. Nothing "
        "is changed.",
        epilog="example: camtopod --config camtopod.toml doctor --out report.tar.gz",
    )
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="write the report to FILE; if it ends in .tar.gz, one file per part "
        "(default: standard output)",
    )


def run(args: argparse.Namespace) -> int:
    """Write the report to standard output, or to the file of --out."""
    try:
        config, mistakes = configuration(args), ""
    except CommandError as error:
        config, mistakes = Config(), str(error)
        with contextlib.suppress(CommandError):
            config = with_options(args, config)

    # Collect the parts of the report.
    _remember_secrets(config)
    parts: dict[str, Callable[[], list[str]]] = {
        "versions": machine_report.versions,
        "machine": machine_report.machine,
        "clock": lambda: machine_report.clock(clock.wall()),
        "video": _video,
        "configuration": lambda: mistakes.splitlines() or list(_configuration(config, args.config)),
        "state": lambda: list(_state(config)),
        "bus": lambda: list(_bus(config)),
    }
    report = {
        name: redact("\n".join(visible(line) for line in part())) + "\n"
        for name, part in parts.items()
    }

    # Write it.
    text = "\n".join(f"== {name} ==\n{part}" for name, part in report.items())
    if args.out is None:
        sys.stdout.write(text)
        return exits.DONE
    content = _bundle(report) if args.out.name.endswith(_BUNDLES) else text.encode()
    try:
        secret_files.write(args.out, content)
    except OSError as error:
        raise CommandError(f"cannot write {args.out}: {error.strerror}") from None
    print(f"{args.out} is written; look through it before you share it", file=sys.stderr)
    return exits.DONE


def _remember_secrets(config: Config) -> None:
    """Remember every secret in reach, so that `redact` hides it wherever it appears."""
    for camera in config.cameras:
        try:
            config.for_camera(camera)
        except OSError:
            continue
    for name, value in os.environ.items():
        remember(value)
        if (
            _SECRET_NAME.search(name)
            and len(value) >= _SECRET_CHARACTERS_MIN
            and not Path(value).is_absolute()
        ):
            remember(f"secret://:{value}@")
    folder = os.environ.get("CREDENTIALS_DIRECTORY", "")
    for path in Path(folder).iterdir() if folder and Path(folder).is_dir() else ():
        try:
            secret = secret_files.read(path)
        except OSError:
            continue
        remember(secret)
        remember(f"secret://:{secret}@")


def _video() -> list[str]:
    from camtopod.vision.source import decoders

    return decoders()


def _configuration(config: Config, path: Path | None) -> Iterator[str]:
    """Yield settings other than the defaults, and warnings of files or a bus open to others."""
    yield f"file: {path} ({_mode(path)})" if path else "no configuration file"
    given = {name: _at(config, name) for name in TABLES} | {
        f"cameras.{n}": c for n, c in config.cameras.items()
    }
    for name, table in given.items():
        for field in msgspec.structs.fields(table):
            value = getattr(table, field.name)
            if value not in ("", field.default) and not isinstance(value, msgspec.Struct):
                yield f"{name}.{field.name} = {json.dumps(_clean(value))}"
    for camera in config.cameras:
        for key, value in config.own_vision(camera).items():
            yield f"cameras.{camera}.{key} = {json.dumps(value)}"
    for file in config.secrets(path or Path()):
        yield f"holds a secret: {file} ({_mode(file)})"
    yield from secret_files.find_exposed(config.secrets(path or Path()))
    if (open_to := access.openness_warning(config)) is not None:
        yield open_to


def _at(config: Config, name: str) -> Any:
    """Return the table with this dotted name."""
    value: Any = config
    for part in name.split("."):
        value = getattr(value, part)
    return value


def _state(config: Config) -> Iterator[str]:
    """Yield size and permissions of the files on disk, and the counts of the databases."""
    directory = config.state_directory
    yield f"{directory} ({_mode(directory)})"
    try:
        disk = shutil.disk_usage(directory)
        files = sorted(path for path in directory.rglob("*") if path.is_file())
    except OSError as error:
        yield f"cannot be read: {error.strerror}"
        return
    yield f"disk: {disk.free / 2**20:.0f} MiB free of {disk.total / 2**20:.0f}"
    for path in files[:FILES_MAX]:
        yield f"{path.relative_to(directory)}: {_mode(path)}"
        for look in (look for pattern, look in _LOOKS.items() if path.match(pattern)):
            try:
                counts = ", ".join(f"{name} {count or 0}" for name, count in look(path).items())
                yield f"  at the last checkpoint: {counts}"
            except StateError as error:
                yield f"  {error}"
    if len(files) > FILES_MAX:
        yield f"and {len(files) - FILES_MAX} more files"


def _mode(path: Path) -> str:
    """Return permissions, owner, size and age of a file in words."""
    try:
        found = path.stat()
    except OSError as error:
        return str(error.strerror)
    age = max(0.0, clock.wall() - found.st_mtime)
    return (
        f"{stat.filemode(found.st_mode)}, "
        f"user {found.st_uid}{' (this one)' if found.st_uid == os.geteuid() else ''}, "
        f"{found.st_size} bytes, changed {age:.0f} s ago"
    )


def _bus(config: Config) -> Iterator[str]:
    """Yield whether the bus answers, who is there, and their statuses.

    Of refused messages only the reasons are reported.
    """
    began = time.monotonic()
    try:
        bus = dial(config.certified(next(iter(config.cameras), "")))
    except BusError as error:
        yield str(error)
        return
    hidden = ", as a camera's certificate may not see this" if config.bus.tls.ca else ""
    with bus:
        yield f"{bus.endpoint} is reached after {time.monotonic() - began:.2f} s, site {bus.site}"
        for role in ("daemon", "grabber"):
            names = ", ".join(sorted(bus.list_alive(role)))
            yield f"{role}s there: {names or f'none seen{hidden}'}"
        if others := sites_instead(bus, config):
            yield f"sites with a daemon on this bus: {', '.join(others)}"
        statuses = {key.removeprefix("status/"): _status(raw) for key, raw in bus.query("status/*")}
    for name, status in sorted(statuses.items()):
        refusals = {key: status.pop(key) for key in _REFUSALS if key in status}
        yield f"{name}: {json.dumps(_clean(status))}"
        if refusals:
            samples = refusals.get("reject_samples", {})  # each quotes the refused text at its end
            refusals["reject_samples"] = {
                why: [_QUOTED.sub("", one) for one in each] for why, each in samples.items()
            }
            yield f"{name} refused: {json.dumps(_clean(refusals))}"
    if not statuses:
        yield f"no program answers a query for its status{hidden}"


def _status(raw: bytes) -> dict[str, Any]:
    """Return a decoded status, or the reason why it cannot be read."""
    try:
        return msgspec.msgpack.decode(raw, type=dict[str, Any])
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        return {"unreadable": str(error)}


def _clean(value: Any) -> Any:
    """Return ``value`` without secrets; must run before JSON quoting changes their spelling."""
    if isinstance(value, str):
        return redact(value)
    if isinstance(value, dict):
        return {_clean(key): _clean(inner) for key, inner in value.items()}
    return [_clean(inner) for inner in value] if isinstance(value, list | tuple) else value


def _bundle(report: dict[str, str]) -> bytes:
    """Return the report as a .tar.gz archive with one file per part."""
    out = io.BytesIO()
    with tarfile.open(fileobj=out, mode="w:gz") as bundle:
        for name, text in report.items():
            entry = tarfile.TarInfo(f"camtopod-doctor/{name}.txt")
            entry.size, entry.mtime = len(text.encode()), int(clock.wall())
            bundle.addfile(entry, io.BytesIO(text.encode()))
    return out.getvalue()
