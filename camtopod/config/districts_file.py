"""Districts of a city: which site owns each camera, and which cameras of others it hears.

A district is a site. It learns from its own cameras and from those beyond its border, the
neighbours that its cameras have in other districts:

    [districts.north]
    cameras = ["gate1", "gate2"]    # its own
    hears = ["square4"]             # of other districts
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from msgspec import Struct

from camtopod.config.config_file import text_of
from camtopod.config.settings import ConfigError
from camtopod.config.toml_tables import Keys, Mistake, TableReader, key_lines, syntax
from camtopod.records import NAME_PATTERN, CameraId


class District(Struct, frozen=True, forbid_unknown_fields=True):
    """Cameras of a district.

    cameras: those that it owns.
    hears: the cameras of other districts that are neighbours of its own.
    """

    cameras: tuple[CameraId, ...] = ()
    hears: tuple[CameraId, ...] = ()


Districts = dict[str, District]
"""Districts by the name of their site."""


def with_borders(owners: Mapping[str, str], neighbours: Iterable[tuple[str, str]]) -> Districts:
    """Return districts that hear the neighbours of their cameras.

    owners: district by camera.
    neighbours: pairs of cameras; pairs of a camera that has no owner do not count.
    """
    cameras, hears = defaultdict[str, set[str]](set), defaultdict[str, set[str]](set)
    for camera, owner in owners.items():
        cameras[owner].add(camera)
    for pair in neighbours:
        for camera, other in (pair, pair[::-1]):
            if {camera, other} <= owners.keys() and owners[camera] != owners[other]:
                hears[owners[camera]].add(other)
    return {
        name: District(tuple(sorted(cameras[name])), tuple(sorted(hears[name])))
        for name in sorted(cameras)
    }


def owners_of(districts: Districts) -> dict[str, str]:
    """Return the district that owns each camera, by camera."""
    return {camera: name for name, district in districts.items() for camera in district.cameras}


def load(path: Path, raw: bytes | None = None) -> Districts:
    """Read a file of districts; ``raw`` is its content, if it was read before.

    Raises `ConfigError` with every mistake, and `OSError` if the file cannot be read.
    """
    try:
        return parse(text_of(path, raw), str(path))
    except RecursionError:  # of the parser, or of what reads its tables
        message = "tables or arrays are nested too deeply"
        raise ConfigError(str(path), [Mistake(1, message)]) from None


def parse(text: str, name: str = "districts") -> Districts:
    """Return the districts in ``text``; raise `ConfigError`, which calls the file ``name``."""
    data, text, problems = syntax(text.replace("\r\n", "\n"))
    reader = TableReader({}, key_lines(text))
    tables = data.pop("districts", {})
    for key in data:
        reader.report((key,), "expected tables [districts.NAME], one a district")
    districts = {
        site: reader.table(District(), value, ("districts", site))
        for site, value in (tables.items() if isinstance(tables, dict) else ())
    }
    for place, mistake in mistakes(districts):
        reader.report(place, mistake)
    if problems + reader.problems:
        raise ConfigError(name, problems + reader.problems)
    return districts


def is_districts(raw: bytes) -> bool:
    """Return True if the content of a file begins with the table of a district."""
    return re.match(rb"(\s*#[^\n]*\n)*\s*\[districts\.", raw) is not None


def mistakes(districts: Districts) -> Iterator[tuple[Keys, str]]:
    """Yield the mistakes of districts that are each valid, with their place in the file."""
    if not districts:
        yield ("districts",), "there is no district"
    owners: dict[str, str] = {}
    for name, district in districts.items():
        if not re.match(NAME_PATTERN, name):
            yield ("districts", name), "a name is 1 to 64 of the characters A-Z a-z 0-9 _ . -"
        if not district.cameras:
            yield ("districts", name), "it owns no camera"
        for key in ("cameras", "hears"):
            if len({*getattr(district, key)}) < len(getattr(district, key)):
                yield ("districts", name, key), "a camera is listed twice"
        for camera in district.cameras:
            if owners.setdefault(camera, name) != name:
                yield (
                    ("districts", name, "cameras"),
                    f"{camera} is {owners[camera]}'s, too: a camera has one owner, and a name is "
                    "one camera's",
                )

    # Borders have two sides.
    heard_sites = {
        name: {owners.get(camera, "") for camera in district.hears}
        for name, district in districts.items()
    }
    for name, district in districts.items():
        for camera in district.hears:
            owner = owners.get(camera, "")
            place = ("districts", name, "hears")
            if not owner:
                yield place, f"no district owns {camera}"
            elif owner == name:
                yield place, f"{camera} is its own"
            elif name not in heard_sites[owner]:
                yield place, f"it hears {camera} of {owner}, which hears no camera of {name}"


def sites_by_camera(districts: Districts) -> dict[str, list[str]]:
    """Return the sites to which each camera delivers, its owner first, by camera."""
    sites = {camera: [owner] for camera, owner in owners_of(districts).items()}
    for name, district in districts.items():
        for camera in district.hears:
            sites[camera].append(name)
    return sites


def camera_tables(districts: Districts) -> Iterator[str]:
    """Yield, for each camera that other districts hear, its table in its owner's configuration."""
    for camera, sites in sites_by_camera(districts).items():
        if len(sites) > 1:
            yield f"[cameras.{json.dumps(camera)}]    # at {sites[0]}\nsites = {json.dumps(sites)}"


def to_toml(districts: Districts) -> str:
    """Return the text of a file of districts."""
    return "\n".join(
        f"[districts.{json.dumps(name)}]\n"
        f"cameras = {json.dumps(district.cameras)}\n"
        f"hears = {json.dumps(district.hears)}\n"
        for name, district in districts.items()
    )
