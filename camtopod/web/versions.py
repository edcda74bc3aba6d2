"""Versions on the page's time line: figures and changes of each."""

from __future__ import annotations

from typing import Any

from msgspec import Struct

from camtopod.records import Topology
from camtopod.topology import link_key, links_between_views, longest_lag

CHANGES_MAX = 100
"""Changes of a version that are listed."""
_RELATIONS = {"overlapped": "overlapping views", "unseen_path": "an unseen path"}


class Change(Struct, frozen=True):
    """A part of the site that was added, removed or changed.

    kind: ``camera``, ``pair``, ``link`` or ``zone``.
    subject: a camera, the cameras of a pair, the zones and the relation of a link, or a zone.
    before, now: None where it did not or does not exist; the relation of a pair in words, else "".
    """

    kind: str
    subject: tuple[str, ...]
    before: str | None
    now: str | None


def summary(topology: Topology, before: Topology | None) -> dict[str, Any]:
    """Return the summary of a version; ``before`` is the one before it on the time line, if any.

    ``links``: links between views. ``longest``: longest lag that was looked for, seconds.
    ``alarms``: those that this version raised. ``since``: number of the version before.
    ``changes``: changes since then, the first `CHANGES_MAX` of them.
    """
    since = None
    changes: list[Change] = []
    if before is not None:
        since = before.version
        changes = _changes(before, topology)
    return {
        "version": topology.version,
        "as_of": topology.as_of,
        "events": topology.events,
        "cameras": len(topology.cameras),
        "links": len(links_between_views(topology)),
        "pairs": len(topology.pairs),
        "longest": longest_lag(topology) or None,
        "score": topology.score,
        "alarms": [alarm for alarm in topology.alarms or [] if alarm.version == topology.version],
        "since": since,
        "changes": changes[:CHANGES_MAX],
        "changes_count": len(changes),
    }


def _changes(old: Topology, new: Topology) -> list[Change]:
    """Return what came, went or became another: cameras, pairs, links between views, zones."""
    before = _parts(old)
    now = _parts(new)
    return [
        Change(*part, before.get(part), now.get(part))
        for part in {**now, **before}
        if before.get(part) != now.get(part)
    ]


def _parts(topology: Topology) -> dict[tuple[str, tuple[str, ...]], str]:
    """Return the relation of every pair in words, and "" for every other part of a version."""
    links = links_between_views(topology)
    return {
        **{("camera", (camera.id,)): "" for camera in topology.cameras},
        **{("pair", pair.cameras): _RELATIONS[pair.relation] for pair in topology.pairs},
        **{("link", link_key(link)): "" for link in links},
        **{("zone", (zone.id,)): "" for zone in topology.zones},
    }
