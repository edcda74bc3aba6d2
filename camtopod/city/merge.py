"""Merge the topologies of districts into one of their city; nothing is fitted again.

The city has the topologies whole, as its parts, and knows who owns each camera. Its digest, and the
epoch after it, tell cities of other parts or owners apart.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterator, Sequence

import msgspec
from msgspec.structs import replace

from camtopod.city.joined_map import JoinedMap, joined_map
from camtopod.config import Districts, owners_of
from camtopod.records import Topology

EPOCH_DIGITS = 16
"""Digits of the digest that are the epoch of a city."""


def merge(parts: Sequence[Topology], districts: Districts, site: str) -> JoinedMap:
    """Return the map of a city with the parts that it is made of.

    parts: topologies of all districts, each with the district's name as its site.
    site: name of the city.

    Raises ValueError with a sentence for each reason why these are not the parts of one city.
    """
    if reasons := list(problems(parts, districts)):
        raise ValueError("\n".join(reasons))
    present = {camera.id for part in parts for camera in part.cameras}
    owners = {
        camera: owner for camera, owner in sorted(owners_of(districts).items()) if camera in present
    }
    parts = sorted(parts, key=lambda part: part.site)
    joined = joined_map(parts, owners)
    digest = digest_of(parts, owners)
    city = replace(
        joined.topology,
        site=site,
        epoch=digest.removeprefix("sha256:")[:EPOCH_DIGITS],
        version=1,
        digest=digest,
        parts=[*parts],
        owners=owners,
    )
    return joined._replace(topology=city)


def digest_of(parts: Sequence[Topology], owners: dict[str, str]) -> str:
    """Return the digest of a city: of site, epoch, version and digest of its parts, and owners."""
    heads = [(part.site, part.epoch, part.version, part.digest) for part in parts]
    return "sha256:" + hashlib.sha256(msgspec.json.encode([heads, owners])).hexdigest()


def problems(parts: Sequence[Topology], districts: Districts) -> Iterator[str]:
    """Yield a sentence for each reason why topologies are not the parts of one city."""
    owners = owners_of(districts)
    part_of = {part.site: part for part in parts}
    for site, count in Counter(part.site for part in parts).items():
        if count > 1:
            yield f"{count} topologies are of the district {site}"
        if site not in districts:
            yield f"no district is called {site}, as the site of a topology is"
    for site in sorted(districts.keys() - part_of.keys()):
        yield f"the topology of the district {site} is missing"
    scales = {(part.model.lag_scale, part.model.lag_step) for part in parts if part.model}
    if len(scales) > 1:
        yield "the topologies have lag bins of different scales: learn all by one camtopod"

    # Cameras: each has one owner, and those beyond a border are heard.
    for site in sorted(part_of.keys() & districts.keys()):
        part, district = part_of[site], districts[site]
        cameras = {camera.id for camera in part.cameras}
        if part.parts is not None:
            yield f"the topology of {site} is a city itself"
        for camera in sorted(cameras - {*district.cameras, *district.hears}):
            owner = owners.get(camera)
            yield (
                f"{site} has a camera {camera}, which no district owns"
                if owner is None
                else f"{site} has a camera {camera}, which is {owner}'s and which {site} does not "
                "hear: a name is one camera's"
            )
        for camera in sorted({*district.hears} - cameras):
            owner_part = part_of.get(owners[camera])
            if owner_part and any(camera == item.id for item in owner_part.cameras):
                yield (
                    f"{site} has not learned from {camera} of {owners[camera]}, which it should "
                    "hear: this side of the border is missing"
                )
