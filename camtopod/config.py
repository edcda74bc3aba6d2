"""TOML -> typed settings. Every limit of the program that somebody may set has its default and unit here,
in `camtopod.learn.settings` and in `camtopod.vision.settings`; nowhere else.
"""

from __future__ import annotations

import difflib
import math
import os
import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import msgspec
from msgspec import Meta, Struct

from camtopod import redact, toml_lines
from camtopod.learn.settings import Settings
from camtopod.records import CAMERA_PATTERN
from camtopod.vision.settings import VisionSettings

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
RESERVED = ("daemon",)
"""No camera's id: ``status/daemon`` is the daemon's."""
_SYNTAX_ERRORS_MAX = 20
_ENDPOINT = re.compile(r"(tcp|udp|tls|quic|ws|unixsock-stream|vsock|serial)/\S+\Z")
_T = TypeVar("_T", bound=Struct)
Endpoint = str
Name = Annotated[str, Meta(pattern=CAMERA_PATTERN)]
Positive = Annotated[float, Meta(gt=0)]
Count = Annotated[int, Meta(ge=1)]


class SiteSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[site]``: whose cameras these are."""

    name: Name = "site"
    """The second part of every key on the bus."""


class BusSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[bus]``: where the programs meet; with no endpoint at all the daemon is the meeting point itself."""

    connect: tuple[Endpoint, ...] = ()
    """Endpoints to dial, e.g. ["tcp/192.168.1.5:7447"]; empty: the daemon listens, the others dial it."""
    listen: tuple[Endpoint, ...] = ()
    """Endpoints at which the daemon listens; empty: tcp/127.0.0.1:7447, or none if it dials."""
    connect_seconds: Positive = 3.0
    """How long to try to reach the meeting point before saying that it cannot be reached."""
    query_seconds: Positive = 2.0
    """How long to wait for the answer to a query."""
    message_bytes_max: Count = 16 * 1024 * 1024
    """Larger messages are refused."""


class StateSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[state]``: what survives a restart."""

    directory: str = ""
    """Where journal and spools live; empty: $STATE_DIRECTORY, else ~/.local/state/camtopod (XDG)."""


class KeepSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[keep]``: how much of the past the daemon keeps on disk."""

    journal_days: Positive = 30.0
    """Received events, for recovery and for the record; older ones are forgotten ..."""
    journal_bytes_max: Count = 2 * 1024**3
    """... and the oldest ones when the database is larger than this."""
    history_days: Positive = 90.0
    """Old versions of the topology, which can be asked for ..."""
    history_bytes_max: Count = 256 * 1024**2
    """... compressed; the oldest are forgotten beyond this."""
    snapshot_events: Count = 20_000
    """The learner's state is saved after this many events, and after every version."""


class CameraSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[cameras.ID]``: one camera of this box."""

    source: str
    """An rtsp:// URL, a video file or a device number."""
    start: float = 0.0
    """A file only: time of its first frame, seconds since the Unix epoch."""
    realtime: bool = False
    """A file only: played at its own pace, not as fast as it decodes."""
    speed: Positive = 1.0
    """A file only, with realtime: this many times its own pace."""


class Limits(Struct, frozen=True, forbid_unknown_fields=True):
    """``[limits]``: bounds of everything that waits, is kept, or is repeated."""

    future_seconds_max: Positive = 60.0
    """Events stamped further ahead of this machine's clock are set aside, not learned; those less far ahead wait."""
    inbox_events_max: Count = 50_000
    """Received and not yet stored; beyond it events are dropped here and pulled from the spool later."""
    inbox_camera_events_max: Count = 5_000
    """The same of one camera, so that one that floods leaves room for the others."""
    camera_events_per_second_max: Count = 200
    """Events of one camera within a second of event time; what is more is counted and not learned."""
    cameras_max: Count = 1_000
    """Events of further cameras are refused, until one has been silent for an hour."""
    commit_events_max: Count = 2_000
    """Events a transaction of the journal."""
    commit_seconds: float = 0.0
    """How long a transaction waits for more events; raise it on an SD card (0.05)."""
    learn_events_max: Count = 50_000
    """Stored and not yet learned; beyond it storing waits."""
    held_events_max: Count = 5_000
    """Events of one camera held back behind a gap; beyond it they are dropped and pulled later."""
    streams_max: Count = 20_000
    """(camera, boot) pairs followed at a time, at most 16 of a camera; events of further ones are refused."""
    gap_seconds: Positive = 5.0
    """A gap that no spool can fill is given up after this long."""
    pull_seconds: Positive = 1.0
    """How often each grabber's spool is asked for what is missing."""
    pull_events_max: Count = 1_000
    """Events an answer of a spool."""
    ack_seconds: Positive = 0.2
    """How often what is stored is acknowledged."""
    status_seconds: Positive = 1.0
    """How often the status is published."""
    settle_seconds: Positive = 10.0
    """When no event has come for this long, event time follows the clock at this distance."""
    spool_events_max: Count = 1_000_000
    """Events a grabber keeps for a daemon that is away; beyond it the oldest are dropped and counted."""
    spool_bytes_max: Count = 256 * 1024 * 1024
    """The same in bytes of its file; a transaction more, and 1 MiB of log, may be on the disk."""
    spool_kept_events: Annotated[int, Meta(ge=0)] = 10_000
    """Acknowledged events that a grabber keeps, for a daemon whose journal was damaged."""
    spool_batch_events: Count = 500
    """Events a transaction of a spool when many come at once."""


class HealthSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[health]``: when a program that still runs counts as dead, and who is told."""

    listen: Annotated[str, Meta(pattern=r"^$|^(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]+):[0-9]{1,5}$")] = ""
    """Where the daemon answers GET /healthz and /readyz, e.g. "127.0.0.1:8787"; empty: nowhere."""
    stall_seconds: Positive = 30.0
    """A loop of the daemon that has not got on for this long makes it unhealthy: systemd starts it again."""
    learn_seconds: Positive = 900.0
    """The same for a step of the learner (fitting anew takes long on a small machine) and for the start."""
    hung_seconds: Positive = 30.0
    """A camera's process that has not got on for this long is killed and started again."""
    restart_seconds_min: Positive = 1.0
    """First wait before a camera's process is started again; doubles up to the largest."""
    restart_seconds_max: Positive = 60.0
    """Largest wait before a camera's process is started again; it starts anew after running for this long."""


class Config(Struct, frozen=True):
    """A whole configuration; what the file does not say has its default."""

    site: SiteSettings = SiteSettings()
    bus: BusSettings = BusSettings()
    state: StateSettings = StateSettings()
    cameras: dict[str, CameraSettings] = {}
    learn: Settings = Settings()
    vision: VisionSettings = VisionSettings()
    keep: KeepSettings = KeepSettings()
    limits: Limits = Limits()
    health: HealthSettings = HealthSettings()

    @property
    def state_directory(self) -> Path:
        """Where journal and spools live."""
        if self.state.directory:
            return Path(self.state.directory).expanduser()
        if systemd := os.environ.get("STATE_DIRECTORY"):
            return Path(systemd.split(":")[0])
        home = os.environ.get("XDG_STATE_HOME") or "~/.local/state"
        return Path(home).expanduser() / "camtopod"

    @property
    def listens(self) -> tuple[Endpoint, ...]:
        """The endpoints at which the daemon listens; empty if it only dials."""
        return self.bus.listen or (() if self.bus.connect else (DEFAULT_ENDPOINT,))

    @property
    def dials(self) -> tuple[Endpoint, ...]:
        """The endpoints which everything but the daemon dials."""
        return self.bus.connect or tuple(_from_here(endpoint) for endpoint in self.listens)


TABLES: dict[str, type[Struct]] = {
    "site": SiteSettings,
    "bus": BusSettings,
    "state": StateSettings,
    "learn": Settings,
    "vision": VisionSettings,
    "keep": KeepSettings,
    "limits": Limits,
    "health": HealthSettings,
}
"""The tables with fixed keys; ``[cameras.ID]`` is the other one."""


class Problem(NamedTuple):
    """One mistake and the line (from 1) it is on."""

    line: int
    what: str


class ConfigError(Exception):
    """The configuration is wrong; ``str()`` is one ``file:line: what`` per mistake."""

    def __init__(self, path: str, problems: list[Problem]) -> None:
        self.problems = sorted(set(problems))
        super().__init__("\n".join(redact.redact(f"{path}:{p.line}: {p.what}") for p in self.problems))


def load(path: Path) -> Config:
    """Read a configuration file. Raises `ConfigError` with every mistake, `OSError` if it cannot be read."""
    raw = path.read_bytes()
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ConfigError(str(path), [Problem(line, "the file is not UTF-8")]) from None
    return parse(text, str(path))


def parse(text: str, name: str = "configuration") -> Config:
    """The configuration that ``text`` says. Raises `ConfigError`, in which the file is called ``name``."""
    data, text, problems = _syntax(text.replace("\r\n", "\n"))
    reader = _Reader(toml_lines.key_lines(text), missing_matters=not problems)
    config = reader.config(data)
    problems += reader.problems
    if problems:
        raise ConfigError(name, problems)
    return config


def _syntax(text: str) -> tuple[dict[str, Any], str, list[Problem]]:
    """Parse; after a mistake in a ``key = value`` line go on without that line, to find the others too."""
    problems: list[Problem] = []
    while len(problems) < _SYNTAX_ERRORS_MAX:
        try:
            return tomllib.loads(text), text, problems
        except tomllib.TOMLDecodeError as error:
            match = re.search(r"(.*) \(at (?:line (\d+)|end of document)", str(error))
            lines = text.split("\n")
            number = int(match[2]) if match and match[2] else len(text.rstrip("\n").split("\n"))
            problem = Problem(number, _sentence(match[1] if match else str(error)))
            if problems and number <= problems[-1].line:
                break
            problems.append(problem)
            if match is None or not match[2] or not re.match(r"\s*[^\[#=]+=", lines[number - 1]):
                break
            lines[number - 1] = ""
            text = "\n".join(lines)
    return {}, "", problems


class _Reader:
    """Builds the settings from what tomllib read, collecting mistakes instead of stopping at the first."""

    def __init__(self, lines: dict[toml_lines.Path, int], missing_matters: bool) -> None:
        self.problems: list[Problem] = []
        self._lines = lines
        self._missing_matters = missing_matters

    def config(self, data: dict[str, Any]) -> Config:
        known = [*TABLES, "cameras"]
        for key in data:
            if key not in known:
                self._say((key,), f"{key}: no such table{_did_you_mean(key, known)}")
        tables = {name: self._table(kind, data, (name,)) for name, kind in TABLES.items()}
        return Config(cameras=self._cameras(data.get("cameras", {})), **tables)  # type: ignore[arg-type]

    def _cameras(self, data: Any) -> dict[str, CameraSettings]:
        if not isinstance(data, dict):
            self._say(("cameras",), "cameras: expected tables [cameras.ID], one a camera")
            return {}
        cameras = {}
        for camera in data:
            path = ("cameras", camera)
            if not re.match(CAMERA_PATTERN, camera):
                self._say(path, f"cameras.{camera}: a camera's id is 1 to 64 of the characters A-Z a-z 0-9 _ . -")
            if camera in RESERVED:
                self._say(path, f"cameras.{camera}: this name is taken on the bus; call the camera otherwise")
            if isinstance(data[camera], dict) and isinstance(data[camera].get("source"), str):
                redact.remember(data[camera]["source"])
            settings = self._table(CameraSettings, data, path)
            if settings is not None:
                if not settings.source:
                    self._say((*path, "source"), f"cameras.{camera}.source: is empty")
                cameras[camera] = settings
        return cameras

    def _table(self, kind: type[_T], parent: dict[str, Any], path: tuple[str, ...]) -> _T | None:
        """The settings at ``path``, with the default for each mistake; None if a required key is missing."""
        title = ".".join(path)
        data = parent.get(path[-1], {})
        if not isinstance(data, dict):
            self._say(path, f"{title}: expected a table [{title}]")
            return None if kind is CameraSettings else kind()
        fields = {field.name: field for field in msgspec.structs.fields(kind)}
        values: dict[str, Any] = {}
        for key, value in data.items():
            if key not in fields:
                self._say((*path, key), f"{title}.{key}: no such key{_hint(key, list(fields), path[0])}")
            elif (converted := self._value(fields[key], value, (*path, key))) is not None:
                values[key] = converted
        for field in fields.values():
            if field.required and field.name not in data and self._missing_matters:
                self._say(path, f"{title}: {field.name} is missing")
            if field.required and field.name not in values:
                return None
        return kind(**values)

    def _value(self, field: msgspec.structs.FieldInfo, value: Any, path: toml_lines.Path) -> Any:
        """``value`` as the field's type, or None after saying why not; each element of an array by itself."""
        title = ".".join(str(part) for part in path[:3])
        if field.type == tuple[Endpoint, ...] and isinstance(value, list):
            for index, endpoint in enumerate(value):
                if not is_endpoint(endpoint):
                    what = f"{title}: {endpoint!r} is not an endpoint; write it like {DEFAULT_ENDPOINT!r}"
                    self._say((*path, index), what)
            return tuple(value)
        try:
            converted = msgspec.convert(value, field.type)
            _check_number(converted, field.default)
        except ValueError as error:
            self._say(path, f"{title}: {_sentence(str(error))}")
            return None
        return converted

    def _say(self, path: toml_lines.Path, what: str) -> None:
        while path and path not in self._lines:
            path = path[:-1]
        self.problems.append(Problem(self._lines.get(path, 1), what))


def is_endpoint(value: object) -> bool:
    """Whether ``value`` looks like an endpoint of zenoh: protocol/address."""
    return isinstance(value, str) and _ENDPOINT.match(value) is not None


def _check_number(value: Any, default: Any) -> None:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return
    if not math.isfinite(value):
        raise ValueError("expected a finite number")
    if isinstance(default, int | float) and default >= 0 and value < 0:
        raise ValueError("must not be negative")


def _hint(key: str, known: list[str], table: str) -> str:
    homes = [name for name, kind in TABLES.items() if name != table and key in kind.__struct_fields__]
    return f"; it belongs in [{homes[0]}]" if homes else _did_you_mean(key, known)


def _did_you_mean(key: str, known: list[str]) -> str:
    close = difflib.get_close_matches(key, known, n=1, cutoff=0.6)
    return f"; did you mean {close[0]!r}?" if close else f"; known are {', '.join(known)}"


def _sentence(message: str) -> str:
    """A message of msgspec or tomllib as the second half of a sentence, in TOML's words."""
    message = re.sub(r" - at `\$.*", "", message)
    words = {"`float`": "a number", "`int`": "a whole number", "`str`": "a string", "`bool`": "true or false"}
    words |= {"`array`": "an array", "`object`": "a table"}
    for theirs, ours in words.items():
        message = message.replace(theirs, ours)
    return message[:1].lower() + message[1:]


def _from_here(endpoint: Endpoint) -> Endpoint:
    """An endpoint listened at on every interface, as this machine dials it."""
    return endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")
