"""Reading a configuration file: every mistake with its line, and paths that hold everywhere."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from msgspec.structs import replace

from camtopod import redact
from camtopod.config.settings import (
    TABLES,
    BusSettings,
    Config,
    ConfigError,
    MapSettings,
    OtherSite,
    TlsSettings,
)
from camtopod.config.toml_tables import Keys, Mistake, TableReader, did_you_mean, key_lines, syntax
from camtopod.learn.settings import TopologySettings
from camtopod.records import NAME_PATTERN, RESERVED
from camtopod.vision.detector.coco import LABELS
from camtopod.vision.settings import DetectorSettings


def load(path: Path, raw: bytes | None = None) -> Config:
    """Read a configuration file.

    Raises `ConfigError` with every mistake, and `OSError` if the file cannot be read.

    raw: content of the file, if it was read before.
    """
    return _with_absolute_paths(path.parent, parse(text_of(path, raw), str(path)))


def text_of(path: Path, raw: bytes | None = None) -> str:
    """Return the text of a file; raises and ``raw`` as for `load`."""
    if raw is None:
        raw = path.read_bytes()
    try:
        text = raw.decode("utf-8-sig")  # Windows' editors put a byte order mark in front
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ConfigError(str(path), [Mistake(line, "the file is not UTF-8")]) from None
    return text


def parse(text: str, name: str = "configuration") -> Config:
    """Return the configuration in ``text``; raise `ConfigError`, which calls the file ``name``."""
    try:
        return _parse(text, name)
    except RecursionError:  # of the parser, or of what reads its tables
        raise ConfigError(name, [Mistake(1, "tables or arrays are nested too deeply")]) from None


def _parse(text: str, name: str) -> Config:
    data, text, problems = syntax(text.replace("\r\n", "\n"))
    reader = TableReader(TABLES, key_lines(text))
    tables = {}
    for title, noun in (("cameras", "ID], one a camera"), ("sites", "NAME], one a site")):
        tables[title] = data.pop(title, {})
        if not isinstance(tables[title], dict):
            reader.report((title,), f"expected tables [{title}.{noun}")
            tables[title] = {}
    config = reader.table(Config(), data, ())
    sites = {
        name: reader.table(OtherSite(), value, ("sites", name))
        for name, value in tables["sites"].items()
    }

    # The cameras, each on top of [vision] and [detector].
    cameras = {}
    for camera, value in tables["cameras"].items():
        defaults = config.new_camera
        if isinstance(value, dict):
            redact.remember(str(value.get("source", "")))  # hidden in all messages
            if value.get("detector") is False:
                defaults = replace(defaults, detector=DetectorSettings())
                del value["detector"]
        cameras[camera] = reader.table(defaults, value, ("cameras", camera))
    config = replace(config, cameras=cameras, sites=sites)

    for path, mistake in _mistakes(config):
        reader.report(path, mistake)
    problems += reader.problems
    if problems:
        raise ConfigError(name, problems)
    return config


def without_source(config: Config, text: str, name: Path) -> list[str]:
    """Return a sentence, with file and line, for each camera that has no source.

    Such a table is right, for `camtopod grab --camera ID SOURCE`, but other commands need the
    source.

    text: content of the file ``name``.
    """
    lines = key_lines(text)
    return [
        f"{name}:{lines.get(('cameras', camera), 1)}: cameras.{camera}: source is missing; add it, "
        f"or source_file, or grab this camera with `camtopod grab --camera {camera} SOURCE`"
        for camera, settings in config.cameras.items()
        if not settings.has_source
    ]


def detector_line(text: str, camera: str, key: str) -> tuple[int, str]:
    """Return the line, and the dotted name, of a setting of the detector of ``camera``.

    The line is that of the nearest table if the key is not written.

    text: content of the configuration file.
    """
    lines = key_lines(text)
    places = [("cameras", camera, "detector", key), ("detector", key)]
    places += [("cameras", camera, "detector"), ("detector",)]
    place = next((place for place in places if place in lines), ("detector",))
    return lines.get(place, 1), ".".join(place)


def _mistakes(config: Config) -> Iterator[tuple[Keys, str]]:
    """Yield the errors of settings that are each valid but contradict each other."""
    yield from _mistakes_of_bus(config.bus)
    yield from _mistakes_of_sites(config)
    yield from _mistakes_of_topology(config.topology)
    if config.web.token_file and not config.web.password_file:
        yield ("web", "token_file"), "password_file is missing: people cannot give a token"

    # Cameras, and their detectors where those differ from the common one.
    detectors: dict[Keys, DetectorSettings] = {("detector",): config.detector}
    for name, camera in config.cameras.items():
        path: Keys = ("cameras", name)
        if not re.match(NAME_PATTERN, name):
            yield path, "a camera's id is 1 to 64 of the characters A-Z a-z 0-9 _ . -"
        if name in RESERVED:
            yield path, "this name is taken on the bus; call the camera otherwise"
        if camera.source and camera.source_file:
            yield (*path, "source"), "give source or source_file, not both"
        if len(camera.at) == 1:
            yield (*path, "at"), "expected two numbers, x and y"
        if camera.detector != config.detector:
            detectors[*path, "detector"] = camera.detector
    some_model = any(detector.model for detector in detectors.values())
    for path, detector in detectors.items():
        is_needed = not some_model or "cameras" in path
        if is_needed and not detector.model and detector != DetectorSettings():
            yield path, "model is missing: it is an ONNX file"
        if not detector.labels:
            yield (*path, "labels"), "is empty; name what makes events"
        for label in detector.labels:
            if isinstance(label, str) and label not in LABELS:
                hint = did_you_mean(label, list(LABELS))
                yield (*path, "labels"), f"COCO has no {label!r}{hint}"


def _mistakes_of_sites(config: Config) -> Iterator[tuple[Keys, str]]:
    """Yield the errors of other sites, and of the cameras that deliver to them."""
    owner = config.site.name
    for name, place in config.sites.items():
        path: Keys = ("sites", name)
        if name == owner:
            yield path, "this is the file's own site, [site] name: [bus] says where it is"
        elif not place.connect:
            yield path, "connect is missing: where is that site's router?"
        elif config.bus.tls == TlsSettings() or place.tls != TlsSettings():
            yield from _mistakes_of_bus(BusSettings(place.connect, tls=place.tls), path)
        else:
            yield from _not_tls(place.connect, (*path, "connect"), "bus.tls")
    for camera, settings in config.cameras.items():
        path = ("cameras", camera, "sites")
        if settings.sites and settings.sites[0] != owner:
            yield path, f"the first one owns the camera and has to be this site, {owner}"
        if len({*settings.sites}) < len(settings.sites):
            yield path, "a site is listed twice"
        for name in settings.sites[1:]:
            if name != owner and name not in config.sites:
                yield path, f"there is no table [sites.{name}] that says where {name} is"


def _mistakes_of_topology(topology: TopologySettings) -> Iterator[tuple[Keys, str]]:
    """Yield the errors of pairs of cameras: of one camera, or in both lists."""
    for key in ("neighbours", "not_neighbours"):
        for a, b in getattr(topology, key):
            if a == b:
                yield ("topology", key), f"{a} cannot be paired with itself"
    neighbours = {frozenset(pair) for pair in topology.neighbours}
    for a, b in topology.not_neighbours:
        if {a, b} in neighbours:
            yield ("topology", "not_neighbours"), f"{a} and {b} are among the neighbours, too"


def _mistakes_of_bus(bus: BusSettings, table: Keys = ("bus",)) -> Iterator[tuple[Keys, str]]:
    """Yield the errors of certificates: they need all files, and tls/ endpoints."""
    if bus.tls == TlsSettings():
        return
    for key in ("ca", "certificate", "private_key"):
        if not getattr(bus.tls, key):
            mistake = f"{key} is missing; ca, certificate and private_key go together"
            yield (*table, "tls"), mistake
    if not bus.tls.access and not bus.connect:
        mistake = (
            "access is missing: a daemon that is the meeting point has to know who may do what"
        )
        yield (*table, "tls"), mistake
    for key in ("listen", "connect"):
        yield from _not_tls(getattr(bus, key), (*table, key), ".".join((*table, "tls")))


def _not_tls(endpoints: Sequence[str], path: Keys, tls: str) -> Iterator[tuple[Keys, str]]:
    """Yield the endpoints at ``path`` that are not of TLS though the table ``tls`` is set."""
    for endpoint in endpoints:
        if not endpoint.startswith("tls/"):
            yield path, f"{endpoint!r} is not a tls/ endpoint, but [{tls}] is set"


def _with_absolute_paths(folder: Path, config: Config) -> Config:
    """Return the configuration with absolute paths, environment variables filled in.

    folder: the folder to which relative paths are relative.
    """

    def located(path: str) -> str:
        return str(folder.absolute() / os.path.expandvars(path)) if path else ""

    cameras = {
        camera: replace(
            settings,
            source_file=located(settings.source_file),
            detector=replace(settings.detector, model=located(settings.detector.model)),
        )
        for camera, settings in config.cameras.items()
    }
    detector = replace(config.detector, model=located(config.detector.model))
    names = ("password_file", "token_file", "pictures")
    web = replace(config.web, **{name: located(getattr(config.web, name)) for name in names})
    return replace(
        config.with_paths(located),
        cameras=cameras,
        detector=detector,
        web=web,
        map=MapSettings(located(config.map.plan)),
    )
