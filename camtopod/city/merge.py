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
from camtopod.config import District, Districts, owners_of
from camtopod.records import Topology
from camtopod.words import counted

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
    sites = Counter(part.site for part in parts)
    cameras = {part.site: {camera.id for camera in part.cameras} for part in parts}
    for site in sorted(districts.keys() | sites.keys()):
        if sites[site] != 1 or site not in districts:
            topologies = counted(sites[site], "topology", "topologies")
            districts_count = counted(int(site in districts), "district")
            yield f"of the site {site} there are {topologies} and {districts_count}: one of each"
    scales = {(part.model.lag_scale, part.model.lag_step) for part in parts if part.model}
    if len(scales) > 1:
        yield "the topologies have lag bins of different scales: learn all by one camtopod"
    for part in parts:
        if part.parts is not None:
            yield f"the topology of {part.site} is a city itself"

        # Cameras: each has one owner, and those beyond a border are heard.
        district = districts.get(part.site, District())
        for camera in sorted(cameras[part.site] - {*district.cameras, *district.hears}):
            owner = owners.get(camera)
            yield f"{part.site} has a camera {camera}, which " + (
                f"is {owner}'s and which {part.site} does not hear: a name is one camera's"
                if owner
                else "no district owns"
            )
        for camera in sorted({*district.hears} - cameras[part.site]):
            if camera in cameras.get(owners[camera], ()):
                yield (
                    f"{part.site} has not learned from {camera} of {owners[camera]}, which it "
                    "should hear: this side of the border is missing"
                )
