"""The settings of a configuration file.

Every limit that users may set has its default and its unit here, in `camtopod.learn.settings` or in
`camtopod.vision.settings`, and nowhere else. The docstrings of fields also become the comments of
the example configuration and the descriptions of the JSON schema. Fields that `toml_tables.GONE`
names are for programs, not for files.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import replace

from camtopod import redact
from camtopod.config import secret_files
from camtopod.config.toml_tables import Mistake
from camtopod.learn.settings import LearnSettings, Settings, TopologySettings
from camtopod.records import NAME_PATTERN
from camtopod.vision.settings import DetectorSettings, VisionSettings

Name = Annotated[
    str, Meta(pattern=NAME_PATTERN, description="1 to 64 of the characters A-Z a-z 0-9 _ . -")
]
Positive = Annotated[float, Meta(gt=0)]
Fraction = Annotated[float, Meta(ge=0, le=1)]
Count = Annotated[int, Meta(ge=1)]
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
"""Endpoint of a daemon that the configuration gives none."""
ENDPOINT_PATTERN = r"^(tcp|udp|tls|quic|ws|unixsock-stream|vsock|serial)/\S+\Z"
"""Regular expression of an endpoint of zenoh: protocol/address."""
Endpoints = Annotated[
    tuple[Annotated[str, Meta(pattern=ENDPOINT_PATTERN)], ...],
    Meta(description=f'endpoints like ["{DEFAULT_ENDPOINT}"]'),
]

ADDRESS_PATTERN = r"^(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9_.-]+):([0-9]{1,5})\Z"
"""Regular expression of an address to listen on, host and port."""


class SiteSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[site]``: the site that the cameras belong to."""

    name: Name = "site"
    """The second part of every key on the bus."""
    walks: bool = True
    """Tell which passages, from camera to camera, are of one object."""


class TlsSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[bus.tls]``: access control of the bus. `camtopod keys` makes the files.

    In paths, which are relative to the configuration file, ``{camera}`` stands for the camera being
    grabbed, and ``$NAME`` for an environment variable.
    """

    ca: str = ""
    """The authority's certificate; empty: everybody who reaches the bus may do everything. Paths
    are relative to this file; {camera} in them is the camera being grabbed, $NAME an environment
    variable.
    """
    certificate: str = ""
    """This program's own certificate."""
    private_key: str = ""
    """The key of the certificate; nobody else may be able to read it."""
    access: str = ""
    """Access list (access.json of `camtopod keys`), for a daemon that is the meeting point."""

    def with_paths(self, change: Callable[[str], str]) -> TlsSettings:
        """Return the settings with each path changed."""
        return TlsSettings(*(change(path) for path in msgspec.structs.astuple(self)))


class BusSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[bus]``: where the programs meet; without endpoints the daemon is the meeting point."""

    connect: Endpoints = ()
    """Endpoints to connect to, e.g. ["tcp/192.168.1.5:7447"]; empty: the daemon listens, other
    programs connect to it.
    """
    listen: Endpoints = ()
    """Endpoints at which the daemon listens; empty: tcp/127.0.0.1:7447, or none if it connects."""
    connect_seconds: Positive = 3.0
    """Time to try to reach the meeting point until an error is reported."""
    message_bytes_max: Count = 16 * 1024 * 1024
    """Maximum size of a message; larger ones are refused. A daemon that is the meeting point takes
    1 to 2 MiB.
    """
    tls: TlsSettings = TlsSettings()
    """See [bus.tls]."""


SITES_MAX = 16
"""Most sites to which one camera delivers; each takes a session of its grabber."""


class OtherSite(Struct, frozen=True, forbid_unknown_fields=True):
    """``[sites.NAME]``: another site to which cameras of this one deliver, too."""

    connect: Endpoints = ()
    """Endpoints of that site's router or daemon. The certificate is that of [bus.tls], of an
    authority for all sites; another one may stand in [sites.NAME.tls], with the same keys.
    """
    tls: TlsSettings = TlsSettings()
    """See [bus.tls]."""


class StateSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[state]``: files that survive a restart."""

    directory: str = ""
    """Directory of the journal and the spools; empty: $STATE_DIRECTORY, else
    ~/.local/state/camtopod (XDG).
    """


class KeepSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[keep]``: how much of the past the daemon keeps on disk."""

    journal_days: Positive = 30.0
    """Days that received events are kept, for recovery and for the record."""
    journal_bytes_max: Count = 2 * 1024**3
    """Maximum size of the journal's database; beyond it the oldest events are deleted."""
    history_days: Positive = 90.0
    """Days that old versions of the topology are kept, which can be queried."""


class CameraSettings(VisionSettings, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """``[cameras.ID]``: one camera of this box; it takes every key of ``[vision]`` as well."""

    source: str = ""
    """An rtsp:// URL, a video file or a device number. It may be missing if the camera is grabbed
    with `camtopod grab --camera ID SOURCE` only.
    """
    source_file: str = ""
    """Instead of source: a file whose first line is the source, so that no password stands here; a
    path as in [bus.tls], e.g. $CREDENTIALS_DIRECTORY/lobby.
    """
    realtime: bool = False
    """A file only: play it at its own speed, not as fast as it decodes."""
    sites: Annotated[
        tuple[Name, ...],
        Meta(max_length=SITES_MAX, description=f"at most {SITES_MAX} names of sites"),
    ] = ()
    """All sites to which the camera delivers, its owner, this one, first; each other one has a
    table [sites.NAME]. Empty: this one alone.
    """
    page: Annotated[
        str,
        Meta(
            pattern=r"^$|^https?://[^\s/@]+(/\S*)?$",
            description="an address that begins with http:// or https://, without a password",
        ),
    ] = ""
    """Address of the camera's page at a recorder, to which the web page links."""
    at: Annotated[
        tuple[Fraction, ...],
        Meta(max_length=2, description="two numbers from 0 to 1, like [0.3, 0.7]"),
    ] = ()
    """Where the camera is on the plan of [map], if there is one: x to the right and y downwards, as
    fractions.
    """
    detector: DetectorSettings = DetectorSettings()
    """The camera's detector: false for none, or a table [cameras.ID.detector] with keys of
    [detector], for this camera alone.
    """

    @property
    def has_source(self) -> bool:
        """Return True if it is grabbed; otherwise other programs may make its events."""
        return bool(self.source or self.source_file)

    @property
    def vision(self) -> VisionSettings:
        """The camera's settings of vision: those of [vision], and those in its own table."""
        return msgspec.convert(self, VisionSettings, from_attributes=True)


class Limits(Struct, frozen=True, forbid_unknown_fields=True):
    """``[limits]``: bounds of all queues, stores and intervals."""

    future_seconds_max: Positive = 60.0
    """Events stamped further ahead of this machine's clock are stored but not learned; those less
    far ahead wait until their time.
    """
    cameras_max: Count = 1_000
    """Maximum number of cameras; events of further ones are refused until one is silent for an
    hour.
    """
    commit_seconds: Annotated[float, Meta(ge=0)] = 0.02
    """Time that a transaction waits for more events; predictions do not wait for it. Raise it on an
    SD card (0.05).
    """
    status_seconds: Positive = 1.0
    """Interval of the published status."""
    settle_seconds: Positive = 10.0
    """When no event has come for this long, event time follows the clock at this distance."""
    spool_events_max: Count = 1_000_000
    """Maximum number of events that a grabber keeps while the daemon is away; beyond it the oldest
    are dropped and counted.
    """
    spool_bytes_max: Count = 256 * 1024 * 1024
    """The same limit for the size of the spool's file; a transaction more, and 1 MiB of log, may be
    on the disk.
    """


class HealthSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[health]``: who can ask whether the daemon is well."""

    listen: Annotated[
        str,
        Meta(
            pattern=rf"^$|{ADDRESS_PATTERN}",
            description="an address and a port, like 127.0.0.1:8787",
        ),
    ] = ""
    """Address at which the daemon answers GET /healthz and /readyz, e.g. "127.0.0.1:8787"; empty:
    nowhere.
    """


class WebSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[web]``: the page: its address, who may open it, and its pictures."""

    listen: Annotated[
        str,
        Meta(pattern=ADDRESS_PATTERN, description="an address and a port, like 127.0.0.1:8780"),
    ] = "127.0.0.1:8780"
    """The page's address; 0.0.0.0:8780: every network may open it, port 0: a free port."""
    password_file: str = ""
    """A file whose first line is the password that the page asks for, at least 8 characters; nobody
    else may be able to read it. A path as in [bus.tls]; empty: no password.
    """
    token_file: str = ""
    """A file whose first line is the token with which programs use the HTTP API, at least 20
    characters; needs password_file.
    """
    pictures: str = ""
    """A folder with a picture of each camera, CAMERA.jpg or CAMERA.png, for the page; `init` and
    `check --probe` store those of the empty scenes there. A path as in [bus.tls]; empty: none.
    """

    @property
    def pictures_folder(self) -> Path | None:
        """The folder of the cameras' pictures, if there is one."""
        return Path(self.pictures) if self.pictures else None


class MapSettings(Struct, frozen=True, forbid_unknown_fields=True):
    """``[map]``: the map of the page."""

    plan: Annotated[
        str,
        Meta(
            pattern=r"^$|\.(png|jpg|jpeg|svg)$",
            description="a file that ends in .png, .jpg or .svg",
        ),
    ] = ""
    """A picture (png, jpg or svg) of the floor plan to show beneath the map; a path as in
    [bus.tls]. Cameras with `at` are placed on it, the others below it.
    """


class Config(Struct, frozen=True, forbid_unknown_fields=True):
    """A whole configuration; settings that the file does not have keep their defaults."""

    site: SiteSettings = SiteSettings()
    bus: BusSettings = BusSettings()
    state: StateSettings = StateSettings()
    sites: dict[Name, OtherSite] = {}
    cameras: dict[Name, CameraSettings] = {}
    learn: LearnSettings = LearnSettings()
    topology: TopologySettings = TopologySettings()
    vision: VisionSettings = VisionSettings()
    detector: DetectorSettings = DetectorSettings()
    keep: KeepSettings = KeepSettings()
    limits: Limits = Limits()
    health: HealthSettings = HealthSettings()
    web: WebSettings = WebSettings()
    map: MapSettings = MapSettings()

    @property
    def learner(self) -> Settings:
        """The settings of the learner: those of [learn], and what is known of the site."""
        settings = {key: getattr(self.learn, key) for key in LearnSettings.__struct_fields__}
        return Settings(**settings, topology=self.topology)

    @property
    def state_directory(self) -> Path:
        """Directory of the journal and the spools."""
        if self.state.directory:
            return _expanded(self.state.directory)
        if systemd := os.environ.get("STATE_DIRECTORY"):
            return Path(systemd.split(":")[0])
        home = os.environ.get("XDG_STATE_HOME") or "~/.local/state"
        return _expanded(home) / "camtopod"

    @property
    def listens(self) -> tuple[str, ...]:
        """Endpoints at which the daemon listens; empty if it only connects to others."""
        if self.bus.listen or self.bus.connect:
            return self.bus.listen
        if self.bus.tls.ca:
            return (DEFAULT_ENDPOINT.replace("tcp/", "tls/"),)
        return (DEFAULT_ENDPOINT,)

    @property
    def dials(self) -> tuple[str, ...]:
        """Endpoints to which all programs but the daemon connect."""
        # This machine reaches itself at its own address where it listens on all interfaces.
        return self.bus.connect or tuple(
            endpoint.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")
            for endpoint in self.listens
        )

    @property
    def peers(self) -> tuple[str, ...]:
        """Endpoints to which a daemon that listens connects, without its own."""
        own = (*self.listens, *replace(self, bus=replace(self.bus, connect=())).dials)
        return tuple(endpoint for endpoint in self.bus.connect if endpoint not in own)

    def secrets(self, path: Path) -> list[Path]:
        """Return the files that hold secrets, if this configuration was read from ``path``."""
        files = [Path(camera.source_file) for camera in self.cameras.values() if camera.source_file]
        if any(redact.holds_secret(camera.source) for camera in self.cameras.values()):
            files.append(path)
        files += [Path(file) for file in (self.web.password_file, self.web.token_file) if file]
        for tls in (self.bus.tls, *(place.tls for place in self.sites.values())):
            names = list(self.cameras) if "{camera}" in tls.private_key else [""]
            keys = [tls.private_key.replace("{camera}", name) for name in names]
            files += [Path(key) for key in keys if key]
        return files

    def joining(self, site: str | None, endpoints: Sequence[str]) -> Config:
        """Return the configuration for another site and other endpoints, where given.

        A camera delivers to another site alone, not to all that the file lists. Raises
        `ValueError`.
        """
        config = self
        if site is not None:
            if not re.match(NAME_PATTERN, site):
                raise ValueError(f"site {site!r}: 1 to 64 of the characters A-Z a-z 0-9 _ . -")
            config = self.at(site) if site in self.sites else self
            if site != self.site.name:
                cameras = {name: replace(value, sites=()) for name, value in self.cameras.items()}
                config = replace(config, cameras=cameras)
            config = replace(config, site=replace(self.site, name=site))
        for endpoint in endpoints:
            if not re.match(ENDPOINT_PATTERN, endpoint):
                raise ValueError(f"connect {endpoint!r}: write it like {DEFAULT_ENDPOINT}")
            if config.bus.tls.ca and not endpoint.startswith("tls/"):
                raise ValueError(f"connect {endpoint!r}: write tls/..., as [bus.tls] is set")
        if endpoints:
            bus = replace(config.bus, connect=tuple(endpoints), listen=())
            config = replace(config, bus=bus)
        return config

    def at(self, site: str) -> Config:
        """Return the configuration of a client of ``site``, this one or one of ``[sites.NAME]``."""
        if site == self.site.name:
            return self
        place = self.sites[site]
        tls = place.tls if place.tls.ca else replace(self.bus.tls, access="")
        bus = replace(self.bus, connect=place.connect, listen=(), tls=tls)
        return replace(self, site=SiteSettings(site), bus=bus)

    def sites_of(self, camera: str) -> tuple[str, ...]:
        """Return the sites to which a camera delivers; the first one, this one, owns it."""
        settings = self.cameras.get(camera)
        return (settings.sites if settings else ()) or (self.site.name,)

    @property
    def new_camera(self) -> CameraSettings:
        """Settings of a camera that has no table."""
        return CameraSettings(**msgspec.structs.asdict(self.vision), detector=self.detector)

    def for_camera(self, camera: str, source: str | None = None) -> Config:
        """Return the configuration of the process that grabs ``camera``.

        It has the camera's certificate, and its source, read from its file if need be. Raises
        `OSError` if that cannot be read.

        source: used instead of the configured one, which need not be there.
        """
        cameras = self.cameras
        settings = cameras.get(camera)
        if source is None and settings is not None and settings.source_file:
            source = secret_files.read(Path(settings.source_file))
        if source is not None:
            redact.remember(source)
            settings = settings or self.new_camera
            cameras = {**cameras, camera: replace(settings, source=source, source_file="")}
        return replace(self.certified(camera), cameras=cameras)

    @property
    def grabbed(self) -> Config:
        """The configuration with the cameras that have a source, and no others."""
        cameras = {name: settings for name, settings in self.cameras.items() if settings.has_source}
        return replace(self, cameras=cameras)

    def certified(self, camera: str) -> Config:
        """Return the configuration with the certificate of ``camera``, for its publisher."""
        return self.with_paths(lambda path: path.replace("{camera}", camera))

    def with_paths(self, change: Callable[[str], str]) -> Config:
        """Return the configuration with each path of a certificate's files changed."""
        sites = {
            name: replace(place, tls=place.tls.with_paths(change))
            for name, place in self.sites.items()
        }
        bus = replace(self.bus, tls=self.bus.tls.with_paths(change))
        return replace(self, bus=bus, sites=sites)


def _expanded(path: str) -> Path:
    """Return a path with the home directory as its "~"; a user without one cannot write there."""
    try:
        return Path(path).expanduser()
    except RuntimeError:  # no HOME, and no entry among the users
        return Path("/nonexistent", path.lstrip("~/"))


TABLES: dict[str, type[Struct]] = {
    "bus.tls": TlsSettings,
    **{
        field.name: field.type
        for field in msgspec.structs.fields(Config)
        if field.name not in ("sites", "cameras")
    },
}
"""The tables with fixed keys; all others are ``[sites.NAME]`` and ``[cameras.ID]``."""


class ConfigError(Exception):
    """The configuration is wrong; ``str()`` has one ``file:line: problem`` for each mistake."""

    def __init__(self, path: str, problems: list[Mistake]) -> None:
        self.problems = sorted(set(problems))
        super().__init__(
            "\n".join(redact.redact(f"{path}:{p.line}: {p.text}") for p in self.problems)
        )
