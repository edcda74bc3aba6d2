"""Topology versions: the digest of a version's content, and deltas between versions.

A delta lists the items (cameras, zones, links, pairs) that were added or changed since the version
before, and the keys of those that are gone. A receiver that applies it checks the digest, and then
has exactly the publisher's version.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

import msgspec

from camtopod.records import DELTA_SCHEMA, TOPOLOGY_SCHEMA, Alarm, Delta, Link, Topology

NOT_CONTENT = ("schema", "site", "epoch", "version", "digest", "evidence")
"""Fields that the digest does not cover, so that it depends on the learned events alone."""

ALARMS_KEPT_MAX = 50
"""Largest number of alarms in a topology; the oldest are dropped."""

LinkKey = tuple[str, str, str]
"""Zone of departure, zone of arrival, relation."""


def link_key(link: Link) -> LinkKey:
    """Return the key of a link in a delta.

    The relation is part of the key: a visible link (a passage through a view) and a link of objects
    that return to the view may join the same zones.
    """
    return (link.from_, link.to, link.relation)


KEYS: dict[str, Callable[[Any], Any]] = {
    "cameras": lambda camera: camera.id,
    "zones": lambda zone: zone.id,
    "links": link_key,
    "weak_links": link_key,
    "pairs": lambda pair: pair.cameras,
}
"""Function from an item to its key, by the list of a topology that has the item."""


def digest_of(topology: Topology) -> str:
    """Return the digest of a version: ``sha256:`` and the hash of its content in canonical JSON.

    Canonical JSON has sorted keys and shortest decimals.
    """
    content = {
        name: getattr(topology, name)
        for name in topology.__struct_fields__
        if name not in NOT_CONTENT
    }
    content = {name: value for name, value in content.items() if value is not None}
    if not topology.weak_links:  # an empty list and no list are the same content
        content.pop("weak_links", None)
    return "sha256:" + hashlib.sha256(msgspec.json.encode(content, order="sorted")).hexdigest()


def with_digest(topology: Topology) -> Topology:
    """Return the topology with its fields ``digest`` and ``schema`` set."""
    return msgspec.structs.replace(topology, schema=TOPOLOGY_SCHEMA, digest=digest_of(topology))


def make_delta(old: Topology, new: Topology) -> Delta:
    """Return the delta from one version to the next.

    Raise ValueError if ``new`` is not the next version after ``old`` in the same epoch.
    """
    if (old.epoch, old.version + 1) != (new.epoch, new.version):
        raise ValueError(
            f"version {new.version} of epoch {new.epoch} does not follow"
            f" version {old.version} of epoch {old.epoch}"
        )

    # Items with different JSON, as in the digest: -0.0 differs from 0.0.
    as_json = msgspec.json.encode
    changes: dict[str, list[Any]] = {}
    for name, key in KEYS.items():
        before = {key(item): item for item in getattr(old, name) or []}
        after = {key(item): item for item in getattr(new, name) or []}
        changes[name] = [
            item for k, item in after.items() if as_json(before.get(k)) != as_json(item)
        ]
        changes[f"gone_{name}"] = [k for k in before if k not in after]
    return Delta(
        DELTA_SCHEMA,
        new.site,
        new.epoch,
        new.version,
        new.as_of,
        new.events,
        new.digest,
        chain=new.chain,
        model=new.model,
        alarms=_new_alarms(new),
        score=new.score,
        evidence=new.evidence,
        **changes,
    )


def alarms_follow(old: Topology, new: Topology) -> bool:
    """Return True if a delta can tell the alarms of ``new``: those of ``old``, and new ones.

    It cannot after a camera was forgotten or renamed, which changes earlier alarms.
    """
    known = [*(old.alarms or []), *(_new_alarms(new) or [])]
    return (known[-ALARMS_KEPT_MAX:] or None) == new.alarms


def _new_alarms(topology: Topology) -> list[Alarm] | None:
    """Return the alarms that this version was the first to show; None if there are none."""
    return [one for one in topology.alarms or [] if one.version == topology.version] or None
