"""TOML -> typed settings. Every limit of the program that somebody may set has its default and unit
here, in `camtopod.learn.settings` and in `camtopod.vision.settings`; nowhere else.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import replace

from camtopod import redact
from camtopod.config import secret_files, toml_lines
from camtopod.config.toml_tables import (
    DEFAULT_ENDPOINT,
    Endpoint,
    Problem,
    TableReader,
    did_you_mean,
    is_endpoint,
    syntax,
)
from camtopod.learn import Settings
from camtopod.records import CAMERA_PATTERN
from camtopod.sharding import Sharding
from camtopod.vision import VisionSettings

RESERVED = ("daemon",)
"""No camera's id: ``status/daemon`` is the daemon's."""
Name = Annotated[
    str, Meta(pattern=CAMERA_PATTERN, description="1 to 64 of the characters A-Z a-z 0-9 _ . -")
]
Positive = Annotated[float, Meta(gt=0)]
Count = Annotated[int, Meta(ge=1)]


class SiteSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[site]``: whose cameras these are."""

    name: Name = "site"
    """The second part of every key on the bus."""


class TlsSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[bus.tls]``: who may be on the bus. Files as `camtopod keys` makes them, relative to the
    configuration.

    In paths, ``{camera}`` stands for the camera being grabbed, ``$NAME`` for an environment
    variable.
    """

    ca: str = ""
    """The authority's certificate; empty: everybody who reaches the bus may do everything. Paths
    are relative to this file; {camera} in them is the camera being grabbed, $NAME an environment
    variable."""
    certificate: str = ""
    """This program's own certificate."""
    private_key: str = ""
    """The certificate's key, which nobody else may read."""
    access: str = ""
    """Who may do what (access.json of `camtopod keys`); needed by a daemon that is the meeting
    point.
    """


class BusSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[bus]``: where the programs meet; with no endpoint at all the daemon is the meeting point
    itself.
    """

    connect: tuple[Endpoint, ...] = ()
    """Endpoints to dial, e.g. ["tcp/192.168.1.5:7447"]; empty: the daemon listens, the others dial
    it.
    """
    listen: tuple[Endpoint, ...] = ()
    """Endpoints at which the daemon listens; empty: tcp/127.0.0.1:7447, or none if it dials."""
    connect_seconds: Positive = 3.0
    """How long to try to reach the meeting point before saying that it cannot be reached."""
    query_seconds: Positive = 2.0
    """How long to wait for the answer to a query."""
    message_bytes_max: Count = 16 * 1024 * 1024
    """Larger messages are refused; a daemon that is the meeting point takes 1 to 2 MiB, but for
    shard 0.
    """
    tls: TlsSettings = TlsSettings()
    """See [bus.tls]."""


class StateSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[state]``: what survives a restart."""

    directory: str = ""
    """Where journal and spools live; empty: $STATE_DIRECTORY, else ~/.local/state/camtopod
    (XDG).
    """


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
    source_file: str = ""
    """Instead of source: a file whose first line is the source, so that no password stands here; a
    path as in [bus.tls], for example $CREDENTIALS_DIRECTORY/lobby."""
    start: float = 0.0
    """A file only: time of its first frame, seconds since the Unix epoch."""
    realtime: bool = False
    """A file only: played at its own pace, not as fast as it decodes."""
    speed: Positive = 1.0
    """A file only, with realtime: this many times its own pace."""


class Limits(Struct, frozen=True, forbid_unknown_fields=True):
    """``[limits]``: bounds of everything that waits, is kept, or is repeated."""

    future_seconds_max: Positive = 60.0
    """Events stamped further ahead of this machine's clock are set aside, not learned; those less
    far ahead wait.
    """
    inbox_events_max: Count = 50_000
    """Received and not yet stored; beyond it events are dropped here and pulled from the spool
    later.
    """
    inbox_camera_events_max: Count = 5_000
    """The same of one camera, so that one that floods leaves room for the others."""
    camera_events_per_second_max: Count = 200
    """Events of one camera within a second of event time; what is more is counted and not
    learned.
    """
    cameras_max: Count = 1_000
    """Events of further cameras are refused, until one has been silent for an hour."""
    commit_events_max: Count = 2_000
    """Events a transaction of the journal."""
    commit_seconds: float = 0.02
    """How long a transaction waits for more events, which their predictions do not; raise it on an
    SD card (0.05).
    """
    learn_events_max: Count = 2_000_000
    """Stored and not yet learned, nearly all of them in the journal alone; beyond it storing
    waits.
    """
    held_events_max: Count = 5_000
    """Events of one camera held back behind a gap; beyond it they are dropped and pulled later."""
    streams_max: Count = 20_000
    """(camera, boot) pairs followed at a time, at most 16 of a camera; beyond, those not heard for
    longest give way.
    """
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
    """Events a grabber keeps for a daemon that is away; beyond it the oldest are dropped and
    counted.
    """
    spool_bytes_max: Count = 256 * 1024 * 1024
    """The same in bytes of its file; a transaction more, and 1 MiB of log, may be on the disk."""
    spool_kept_events: Annotated[int, Meta(ge=0)] = 10_000
    """Acknowledged events that a grabber keeps, for a daemon whose journal was damaged."""
    spool_batch_events: Count = 500
    """Events a transaction of a spool when many come at once."""


class HealthSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[health]``: when a program that still runs counts as dead, and who is told."""

    listen: Annotated[
        str,
        Meta(
            pattern=r"^$|^(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]+):[0-9]{1,5}$",
            description="an address and a port, like 127.0.0.1:8787",
        ),
    ] = ""
    """Where the daemon answers GET /healthz and /readyz, e.g. "127.0.0.1:8787"; empty: nowhere."""
    stall_seconds: Positive = 30.0
    """A loop of the daemon, the page's server or the bridge that has not got on for this long makes
    it unhealthy: systemd starts it again.
    """
    learn_seconds: Positive = 900.0
    """The same for a step of the learner (fitting anew takes long on a small machine) and for the
    start.
    """
    hung_seconds: Positive = 30.0
    """A camera's process that has not got on for this long is killed and started again."""
    start_seconds: Positive = 60.0
    """How long a camera's process may take to be there; loading OpenCV takes a while on a small
    machine.
    """
    restart_seconds_min: Positive = 1.0
    """First wait before a camera's process is started again; doubles up to the largest."""
    restart_seconds_max: Positive = 60.0
    """Largest wait before a camera's process is started again; one that ran for this long waits
    least.
    """


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
    shards: Sharding = Sharding()

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
        default = (
            f"tls/{DEFAULT_ENDPOINT.partition('/')[2]}" if self.bus.tls.ca else DEFAULT_ENDPOINT
        )
        return self.bus.listen or (() if self.bus.connect else (default,))

    @property
    def dials(self) -> tuple[Endpoint, ...]:
        """The endpoints which everything but the daemon dials."""
        return self.bus.connect or tuple(_from_here(endpoint) for endpoint in self.listens)

    def secrets(self, path: Path) -> list[Path]:
        """The files that hold secrets, when this configuration was read from ``path``."""
        files = [Path(camera.source_file) for camera in self.cameras.values() if camera.source_file]
        if any(redact.holds_secret(camera.source) for camera in self.cameras.values()):
            files.append(path)
        names = list(self.cameras) if "{camera}" in self.bus.tls.private_key else [""]
        keys = [self.bus.tls.private_key.replace("{camera}", name) for name in names]
        return files + [Path(key) for key in keys if key]

    def for_camera(self, camera: str) -> Config:
        """What the process that grabs ``camera`` needs: its own certificate, and its source read
        from its file.

        Raises `OSError` if the file cannot be read.
        """
        cameras = self.cameras
        if camera in cameras and cameras[camera].source_file:
            source = secret_files.read(Path(cameras[camera].source_file))
            redact.remember(source)
            filled = replace(cameras[camera], source=source, source_file="")
            cameras = {**cameras, camera: filled}
        return replace(self.certified(camera), cameras=cameras)

    def certified(self, camera: str) -> Config:
        """With the certificate of ``camera``, for who speaks for it on the bus."""
        tls = _with_paths(self.bus.tls, lambda path: path.replace("{camera}", camera))
        return replace(self, bus=replace(self.bus, tls=tls))


TABLES: dict[str, type[Struct]] = {
    "site": SiteSettings,
    "bus": BusSettings,
    "bus.tls": TlsSettings,
    "state": StateSettings,
    "learn": Settings,
    "vision": VisionSettings,
    "keep": KeepSettings,
    "limits": Limits,
    "health": HealthSettings,
    "shards": Sharding,
}
"""The tables with fixed keys; ``[cameras.ID]`` is the other one."""


class ConfigError(Exception):
    """The configuration is wrong; ``str()`` is one ``file:line: what`` per mistake."""

    def __init__(self, path: str, problems: list[Problem]) -> None:
        self.problems = sorted(set(problems))
        super().__init__(
            "\n".join(redact.redact(f"{path}:{p.line}: {p.what}") for p in self.problems)
        )


def load(path: Path, raw: bytes | None = None) -> Config:
    """Read a configuration file. Raises `ConfigError` with every mistake, `OSError` if it cannot be
    read.

    ``raw``: what was in the file when it was read before.
    """
    if raw is None:
        raw = path.read_bytes()
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ConfigError(str(path), [Problem(line, "the file is not UTF-8")]) from None
    return _from(path.parent, parse(text, str(path)))


def parse(text: str, name: str = "configuration") -> Config:
    """The configuration that ``text`` says. Raises `ConfigError`, in which the file is called
    ``name``.
    """
    data, text, problems = syntax(text.replace("\r\n", "\n"))
    reader = _Reader(TABLES, toml_lines.key_lines(text), missing_matters=not problems)
    config = reader.config(data)
    problems += reader.problems
    if problems:
        raise ConfigError(name, problems)
    return config


class _Reader(TableReader):
    """Builds the settings from what tomllib read."""

    def config(self, data: dict[str, Any]) -> Config:
        known = [*TABLES, "cameras"]
        for key in data:
            if key not in known:
                self.say((key,), f"{key}: no such table{did_you_mean(key, known)}")
        tables = {
            name: self.table(kind, data, (name,))
            for name, kind in TABLES.items()
            if "." not in name
        }
        self._check_bus(tables["bus"])
        return Config(cameras=self._cameras(data.get("cameras", {})), **tables)  # type: ignore[arg-type]

    def _cameras(self, data: Any) -> dict[str, CameraSettings]:
        if not isinstance(data, dict):
            self.say(("cameras",), "cameras: expected tables [cameras.ID], one a camera")
            return {}
        cameras = {}
        for camera in data:
            path = ("cameras", camera)
            if not re.match(CAMERA_PATTERN, camera):
                self.say(
                    path,
                    f"cameras.{camera}: a camera's id is 1 to 64 of the characters A-Z a-z 0-9 _ . -",
                )
            if camera in RESERVED:
                self.say(
                    path,
                    f"cameras.{camera}: this name is taken on the bus; call the camera otherwise",
                )
            given = data[camera]
            if isinstance(given, dict) and isinstance(given.get("source"), str):
                redact.remember(given["source"])
            elif isinstance(given, dict) and given.get("source_file"):
                given["source"] = ""
            settings = self.table(CameraSettings, data, path)
            if settings is not None:
                if bool(settings.source) == bool(settings.source_file):
                    what = (
                        "is empty"
                        if not settings.source
                        else "give source or source_file, not both"
                    )
                    self.say((*path, "source"), f"cameras.{camera}.source: {what}")
                cameras[camera] = settings
        return cameras

    def _check_bus(self, bus: Struct | None) -> None:
        """TLS is whole or not at all, and then there is nothing beside it."""
        assert isinstance(bus, BusSettings)
        tls = bus.tls
        if tls == TlsSettings():
            return
        for key in ("ca", "certificate", "private_key"):
            if not getattr(tls, key):
                self.say(
                    ("bus", "tls"),
                    f"bus.tls: {key} is missing; ca, certificate and private_key go together",
                )
        if not tls.access and not bus.connect:
            what = (
                "access is missing: a daemon that is the meeting point has to know who may do what"
            )
            self.say(("bus", "tls"), f"bus.tls: {what}")
        for key in ("listen", "connect"):
            for index, endpoint in enumerate(getattr(bus, key)):
                if is_endpoint(endpoint) and not endpoint.startswith("tls/"):
                    self.say(
                        ("bus", key, index),
                        f"bus.{key}: {endpoint!r} is not a tls/ endpoint, but [bus.tls] is set",
                    )


def _from(folder: Path, config: Config) -> Config:
    """Paths relative to ``folder``, with the environment's variables in them."""

    def located(path: str) -> str:
        return str(folder.absolute() / os.path.expandvars(path)) if path else ""

    tls = _with_paths(config.bus.tls, located)
    cameras = {
        camera: replace(settings, source_file=located(settings.source_file))
        for camera, settings in config.cameras.items()
    }
    return replace(config, bus=replace(config.bus, tls=tls), cameras=cameras)


def _with_paths(tls: TlsSettings, change: Callable[[str], str]) -> TlsSettings:
    return TlsSettings(
        **{field: change(path) for field, path in msgspec.structs.asdict(tls).items()}
    )


def _from_here(endpoint: Endpoint) -> Endpoint:
    """An endpoint listened at on every interface, as this machine dials it."""
    return endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")
