"""`camtopod doctor`: collect diagnostics for a bug report, without secrets.

`camtopod.redact` processes everything twice: each value by itself, and the whole text.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.metadata
import json
import operator
import os
import platform
import re
import shutil
import stat
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import msgspec

from camtopod import __version__, codec
from camtopod.cli.common import configuration, open_output, with_options
from camtopod.cli.exits import CommandError
from camtopod.config import TABLES, Config, secret_files
from camtopod.records import DaemonStatus, GrabberStatus
from camtopod.redact import redact, remember
from camtopod.serve.bus import BusError, access, dial, sites_instead
from camtopod.serve.runtime import clock
from camtopod.visible import visible

_VARIABLES = re.compile(
    "(CAMTOPOD|OPENCV|OMP|OPENBLAS|MKL|RUST|ZENOH)_|"
    "(STATE|CREDENTIALS)_DIRECTORY$|XDG_STATE_HOME$|NOTIFY_SOCKET$|WATCHDOG_USEC$"
)
"""Environment variables whose names are reported, never their values."""
_SECRET_NAME = re.compile(r"(?i)pass|pwd|secret|token|credential")
"""Names of environment variables whose values are secrets."""
_QUOTED = re.compile(r""": ['"].*""", re.DOTALL)
"""The quoted part of a refused message, which is not reported."""


def add_parser(add: Any) -> None:
    """Add `doctor`."""
    parser = add(
        description="Collects diagnostics for a bug report: versions, machine, "
        "configuration, files on disk, and the statuses of the daemon and the cameras. It contains "
        "no passwords, keys or events; look through it all the same before you share it. Nothing "
        "is changed.",
        epilog="example: camtopod --config camtopod.toml doctor --out report.txt",
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        default="-",
        help="write the report to FILE (default: standard output)",
    )


def run(args: argparse.Namespace) -> None:
    """Write the report to standard output, or to the file of --out."""
    mistakes = ""
    try:
        config = configuration(args)
    except CommandError as error:
        config = Config()
        mistakes = str(error)
        with contextlib.suppress(CommandError):
            config = with_options(args, config)

    from camtopod.vision.source import decoders

    # Collect the parts of the report.
    _remember_secrets(config)
    parts: dict[str, Callable[[], Iterable[str]]] = {
        "versions": _versions,
        "machine": _machine,
        "video": decoders,
        "configuration": lambda: mistakes.splitlines() or _configuration(config, args.config),
        "state": lambda: _state(config),
        "bus": lambda: _bus(config),
    }
    report = "\n".join(
        f"== {name} ==\n" + redact("\n".join(visible(line) for line in part())) + "\n"
        for name, part in parts.items()
    )

    # Write it.
    with open_output(args.out, 0o600) as file:
        file.write(report.encode())
    if args.out != "-":
        print(f"{args.out} is written; look through it before you share it", file=sys.stderr)


def _remember_secrets(config: Config) -> None:
    """Remember every secret in reach, so that `redact` hides it wherever it appears."""
    for camera in config.cameras:
        with contextlib.suppress(OSError):
            config.for_camera(camera)
    for name, value in os.environ.items():
        remember(value)
        if _SECRET_NAME.search(name) and len(value) >= 6 and not Path(value).is_absolute():
            remember(f"secret://:{value}@")
    folder = os.environ.get("CREDENTIALS_DIRECTORY", "/nonexistent")
    for path in Path(folder).glob("*"):
        with contextlib.suppress(OSError):
            secret = secret_files.read(path)
            remember(secret)
            remember(f"secret://:{secret}@")


def _versions() -> Iterator[str]:
    """Yield the versions of camtopod, Python and the packages, those of the extras included."""
    yield f"camtopod {__version__}, Python {platform.python_version()}"
    requirements = importlib.metadata.requires("camtopod") or []
    for package in sorted(
        {re.split(r"[^\w.-]", requirement)[0] for requirement in requirements} - {"camtopod"}
    ):
        try:
            yield f"{package} {importlib.metadata.version(package)}"
        except importlib.metadata.PackageNotFoundError:
            yield f"{package}: not installed"


def _machine() -> Iterator[str]:
    """Yield operating system, cores, memory and the names of environment variables."""
    yield f"{platform.platform()}; the clock says {clock.wall():.3f}"
    load = " ".join(f"{average:.1f}" for average in os.getloadavg())
    yield f"{os.cpu_count()} cores, {len(os.sched_getaffinity(0))} for this program, load {load}"
    memory = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    yield f"{memory / 2**20:.0f} MiB of memory"
    names = sorted(filter(_VARIABLES.match, os.environ))
    yield f"environment variables that are set: {', '.join(names) or 'none'}"


def _configuration(config: Config, path: Path | None) -> Iterator[str]:
    """Yield settings other than the defaults, and warnings of files or a bus open to others."""
    yield f"file: {path} ({_mode(path)})" if path else "no configuration file"
    tables = {name: operator.attrgetter(name)(config) for name in TABLES}
    tables |= {f"cameras.{name}": camera for name, camera in config.cameras.items()}
    for name, table in tables.items():
        for field in msgspec.structs.fields(table):
            value = getattr(table, field.name)
            if value not in ("", field.default) and not isinstance(value, msgspec.Struct):
                yield f"{name}.{field.name} = {json.dumps(_clean(value))}"
    for file in config.secrets(path or Path()):
        yield f"holds a secret: {file} ({_mode(file)})"
    yield from secret_files.find_exposed(config.secrets(path or Path()))
    if (open_to := access.openness_warning(config)) is not None:
        yield open_to


def _state(config: Config) -> Iterator[str]:
    """Yield size and permissions of the files on disk."""
    directory = config.state_directory
    yield f"{directory} ({_mode(directory)})"
    try:
        disk = shutil.disk_usage(directory)
        files = sorted(path for path in directory.rglob("*") if path.is_file())
    except OSError as error:
        yield f"cannot be read: {error.strerror}"
        return
    yield f"disk: {disk.free / 2**20:.0f} MiB free of {disk.total / 2**20:.0f}"
    for path in files:
        yield f"{path.relative_to(directory)}: {_mode(path)}"


def _mode(path: Path) -> str:
    """Return permissions, owner, size and age of a file in words."""
    try:
        status = path.stat()
    except OSError as error:
        return str(error.strerror)
    age = max(0.0, clock.wall() - status.st_mtime)
    return (
        f"{stat.filemode(status.st_mode)}, user {status.st_uid}, "
        f"{status.st_size} bytes, changed {age:.0f} s ago"
    )


def _bus(config: Config) -> Iterator[str]:
    """Yield whether the bus answers, who is there, and their statuses.

    Of refused messages only the reasons are reported.
    """
    start = time.monotonic()
    try:
        bus = dial(config.certified(next(iter(config.cameras), "")))
    except BusError as error:
        yield str(error)
        return
    remark = ", as a camera's certificate may not see this" if config.bus.tls.ca else ""
    with bus:
        yield f"{bus.endpoint} is reached after {time.monotonic() - start:.2f} s, site {bus.site}"
        for role in ("daemon", "grabber"):
            names = ", ".join(sorted(bus.list_alive(role)))
            yield f"{role}s there: {names or f'none seen{remark}'}"
        if other_sites := sites_instead(bus, config):
            yield f"sites with a daemon on this bus: {', '.join(other_sites)}"
        statuses = {
            (name := key.removeprefix("status/")): _status(name, raw)
            for key, raw in bus.query("status/*")
        }
    for name, status in sorted(statuses.items()):
        samples = status.get("reject_samples", {})  # each quotes the refused text at its end
        for reason, quotes in samples.items():
            samples[reason] = [_QUOTED.sub("", quote) for quote in quotes]
        yield f"{name}: {json.dumps(_clean(status))}"
    if not statuses:
        yield f"no program answers a query for its status{remark}"


def _status(name: str, raw: bytes) -> dict[str, Any]:
    """Return the status of a camera or of ``daemon``, or the reason why it cannot be read."""
    try:
        status: Any = codec.read(
            DaemonStatus if name == "daemon" else GrabberStatus, raw, pack=True
        )
        fields = msgspec.to_builtins(status).items()
        return {field: value for field, value in fields if value is not None}
    except codec.Rejected as error:
        return {"unreadable": str(error)}


def _clean(value: Any) -> Any:
    """Return ``value`` without secrets; must run before JSON quoting changes their spelling."""
    if isinstance(value, str):
        return redact(value)
    if isinstance(value, dict):
        return {_clean(key): _clean(inner) for key, inner in value.items()}
    return [_clean(inner) for inner in value] if isinstance(value, list | tuple) else value
