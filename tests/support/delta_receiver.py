"""What a receiver of deltas does, as deploy/protocol.md describes it."""

from __future__ import annotations

from typing import Any

from camtopod.records import TOPOLOGY_SCHEMA, Delta, Topology
from camtopod.topology.versions import ALARMS_KEPT_MAX, KEYS


def apply_delta(old: Topology, delta: Delta) -> Topology:
    """Return the next version after ``old``; its digest has to be that of the delta."""
    lists: dict[str, list[Any]] = {}
    for name, key in KEYS.items():
        items = {key(item): item for item in getattr(old, name) or []}
        for k in getattr(delta, f"gone_{name}"):
            items.pop(k, None)
        items |= {key(item): item for item in getattr(delta, name)}
        lists[name] = [items[k] for k in sorted(items)]

    return Topology(
        schema=TOPOLOGY_SCHEMA,
        site=delta.site,
        epoch=delta.epoch,
        version=delta.version,
        as_of=delta.as_of,
        events=delta.events,
        digest=delta.digest,
        alarms=[*(old.alarms or []), *(delta.alarms or [])][-ALARMS_KEPT_MAX:] or None,
        score=delta.score,
        evidence=delta.evidence,
        **lists,
    )
