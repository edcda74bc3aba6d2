"""Topology versions: the digest of a version's content, and deltas between versions.

A version has a map and a model, which are apart on the bus. A delta lists the items of the map
(cameras, zones, links, pairs) that were added or changed since the version before, and the keys of
those that are gone. A receiver that applies it has exactly the publisher's map; the digest tells
whether a map and a model are.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Any

import msgspec

from camtopod.columns import inflated
from camtopod.records import (
    DELTA_SCHEMA,
    MODEL_SCHEMA,
    TOPOLOGY_SCHEMA,
    Alarm,
    Delta,
    Link,
    Topology,
    VersionModel,
)

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
    "pairs": lambda pair: pair.cameras,
}
"""Function from an item to its key, by the list of a topology that has the item."""


def digest_of(topology: Topology) -> str:
    """Return the digest of a version: ``sha256:`` and the hash of its content in canonical JSON.

    Canonical JSON has sorted keys and shortest decimals. Of the model, it has the numbers of each
    column, however they are deflated, little-endian and in base64.
    """
    content = {
        name: getattr(topology, name)
        for name in topology.__struct_fields__
        if name not in NOT_CONTENT
    }
    content = {name: value for name, value in content.items() if value is not None}
    if topology.model is not None:
        content["model"] = _inflated(msgspec.to_builtins(topology.model, builtin_types=(bytes,)))
    return "sha256:" + hashlib.sha256(msgspec.json.encode(content, order="sorted")).hexdigest()


def _inflated(content: dict[str, Any]) -> dict[str, Any]:
    """Return the content of a model or of one of its tables, the numbers of columns inflated."""
    result = {}
    for name, value in content.items():
        if isinstance(value, dict):
            value = _inflated(value)
        elif isinstance(value, bytes) and value:
            value = inflated(value)
        result[name] = value
    return result


def with_digest(topology: Topology) -> Topology:
    """Return the topology with its fields ``digest`` and ``schema`` set."""
    return msgspec.structs.replace(topology, schema=TOPOLOGY_SCHEMA, digest=digest_of(topology))


def map_of(topology: Topology) -> Topology:
    """Return the map of a version: all but its model."""
    return msgspec.structs.replace(topology, model=None)


def version_model(topology: Topology) -> VersionModel | None:
    """Return the model of a version as it is published beside the map; None if it has none."""
    head = (topology.site, topology.epoch, topology.version, topology.digest)
    return None if topology.model is None else VersionModel(MODEL_SCHEMA, *head, topology.model)


def make_delta(old: Topology, new: Topology) -> Delta:
    """Return the delta from the map of one version to the next.

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
        alarms=_new_alarms(new),
        score=new.score,
        evidence=new.evidence,
        **changes,
    )


def alarms_follow(old: Topology, new: Topology) -> bool:
    """Return True if a delta can tell the alarms of ``new``: those of ``old``, and new ones.

    It cannot after a camera was forgotten or renamed, which changes earlier alarms.
    """
    alarms = [*(old.alarms or []), *(_new_alarms(new) or [])]
    return (alarms[-ALARMS_KEPT_MAX:] or None) == new.alarms


def _new_alarms(topology: Topology) -> list[Alarm] | None:
    """Return the alarms that this version was the first to show; None if there are none."""
    return [alarm for alarm in topology.alarms or [] if alarm.version == topology.version] or None
