"""Topology versions: put together from the learned figures, stamped with a digest, compared as
deltas.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import msgspec

from camtopod.records import (
    DELTA_SCHEMA,
    TOPOLOGY_SCHEMA,
    Camera,
    Delta,
    Link,
    Pair,
    Topology,
    Zone,
)

NOT_CONTENT = ("schema", "site", "epoch", "version", "digest")
"""Fields that the digest does not cover: two daemons that learned the same events agree on it."""

ALARMS_KEPT_MAX = 50
"""Alarms that a topology lists."""

_Item = TypeVar("_Item", Camera, Zone, Link, Pair)
LinkKey = tuple[str, str, str]


def camera_key(camera: Camera) -> str:
    """What identifies a camera in a delta."""
    return camera.id


def zone_key(zone: Zone) -> str:
    """What identifies a zone in a delta."""
    return zone.id


def link_key(link: Link) -> LinkKey:
    """What identifies a link in a delta: zones and relation, as a passage and a return may join the
    same zones."""
    return (link.from_, link.to, link.relation)


def pair_key(pair: Pair) -> tuple[str, str]:
    """What identifies a pair of cameras in a delta."""
    return pair.cameras


def digest_of(topology: Topology) -> str:
    """``sha256:...`` over the content in canonical JSON (sorted keys, shortest decimals)."""
    content = {
        name: getattr(topology, name)
        for name in topology.__struct_fields__
        if name not in NOT_CONTENT
    }
    content = {name: value for name, value in content.items() if value is not None}
    if not topology.weak_links:  # an optional list that is empty or left out is the same content
        content.pop("weak_links", None)
    return "sha256:" + hashlib.sha256(msgspec.json.encode(content, order="sorted")).hexdigest()


def stamp(topology: Topology) -> Topology:
    """The topology with its digest."""
    return msgspec.structs.replace(topology, schema=TOPOLOGY_SCHEMA, digest=digest_of(topology))


def make_delta(old: Topology, new: Topology) -> Delta:
    """What changed from one version to the next. Raises ValueError when ``new`` is not the next
    version of ``old``."""
    if (old.epoch, old.version + 1) != (new.epoch, new.version):
        raise ValueError(
            f"version {new.version} of {new.epoch} does not follow {old.version} of {old.epoch}"
        )
    cameras, gone_cameras = _changes(old.cameras, new.cameras, camera_key)
    zones, gone_zones = _changes(old.zones, new.zones, zone_key)
    links, gone_links = _changes(old.links, new.links, link_key)
    weak, gone_weak = _changes(old.weak_links or [], new.weak_links or [], link_key)
    pairs, gone_pairs = _changes(old.pairs, new.pairs, pair_key)
    return Delta(
        DELTA_SCHEMA,
        new.site,
        new.epoch,
        new.version,
        new.as_of,
        new.events,
        new.digest,
        cameras,
        zones,
        links,
        weak,
        pairs,
        gone_cameras,
        gone_zones,
        gone_links,
        gone_weak,
        gone_pairs,
        new.chain,
        new.model,
        [alarm for alarm in new.alarms or [] if alarm.version == new.version] or None,
        new.score,
    )


def apply_delta(old: Topology, delta: Delta) -> Topology:
    """The next version. Raises ValueError when the delta does not follow ``old`` or the digest does
    not come out."""
    if (old.epoch, old.version + 1) != (delta.epoch, delta.version):
        raise ValueError(
            f"delta to version {delta.version} of {delta.epoch} does not follow {old.version} of {old.epoch}"
        )
    new = Topology(
        schema=TOPOLOGY_SCHEMA,
        site=delta.site,
        epoch=delta.epoch,
        version=delta.version,
        as_of=delta.as_of,
        events=delta.events,
        digest=delta.digest,
        cameras=_merged(old.cameras, delta.cameras, delta.gone_cameras, camera_key),
        zones=_merged(old.zones, delta.zones, delta.gone_zones, zone_key),
        links=_merged(old.links, delta.links, delta.gone_links, link_key),
        weak_links=_merged(old.weak_links or [], delta.weak_links, delta.gone_weak_links, link_key),
        pairs=_merged(old.pairs, delta.pairs, delta.gone_pairs, pair_key),
        chain=delta.chain,
        model=delta.model,
        alarms=[*(old.alarms or []), *(delta.alarms or [])][-ALARMS_KEPT_MAX:] or None,
        score=delta.score,
    )
    if digest_of(new) != delta.digest:
        raise ValueError(
            f"digest of version {delta.version} does not come out; get the whole topology"
        )
    return new


def _changes(
    old: Iterable[_Item], new: Iterable[_Item], key: Callable[[_Item], Any]
) -> tuple[list[_Item], list[Any]]:
    """Items that are new or differ as the digest sees them (-0.0 is not 0.0), and keys of items
    that are gone.
    """
    before = {key(item): msgspec.json.encode(item) for item in old}
    after = {key(item): item for item in new}
    changed = [item for k, item in after.items() if before.get(k) != msgspec.json.encode(item)]
    return changed, [k for k in before if k not in after]


def _merged(
    old: Iterable[_Item], changed: Iterable[_Item], gone: Iterable[Any], key: Callable[[_Item], Any]
) -> list[_Item]:
    """The items after a change, in the order every list of a topology has: by key."""
    items = {key(item): item for item in old}
    for k in gone:
        items.pop(tuple(k) if isinstance(k, list) else k, None)
    items.update((key(item), item) for item in changed)
    return [items[k] for k in sorted(items)]
