"""Comparison of versions: a summary of each for the time line, and the changes between any two."""

from __future__ import annotations

import math
from collections.abc import Iterable

from msgspec import Struct

from camtopod.records import Alarm, Link, Pair, SelfScore, Topology, Zone
from camtopod.topology import link_key, links_between_views

SHARE_CHANGE_MIN = 0.05
"""Smallest change of a link's share that is reported."""
TIME_CHANGE_SD = 3.0
"""Smallest reported change of a median transit time, in standard errors."""
TIME_CHANGE_SHARE = 0.1
"""Smallest reported change of a median transit time, as a share of itself."""
ZONE_MOVED_MIN = 0.05
"""Smallest reported movement of a zone, as a share of the picture's width or height."""
KINDS = {"overlapped": "overlapping views", "unseen_path": "an unseen path"}


class Summary(Struct, frozen=True):
    """A version on the time line."""

    epoch: str
    version: int
    as_of: float
    events: int
    cameras: int
    zones: int
    links: int
    """Links between views."""
    pairs: int
    score: SelfScore | None
    alarms: list[Alarm]
    """Alarms raised by this version."""


class Change(Struct, frozen=True):
    """One difference."""

    sign: str
    """"+" for new, "-" for gone, "~" for different."""
    kind: str
    subject: list[str]
    """What the page opens: a camera, a pair, a link or a zone."""
    text: str


def summary(topology: Topology) -> Summary:
    """Return the summary of a version."""
    return Summary(
        topology.epoch,
        topology.version,
        topology.as_of,
        topology.events,
        len(topology.cameras),
        len(topology.zones),
        len(links_between_views(topology)),
        len(topology.pairs),
        topology.score,
        [alarm for alarm in topology.alarms or [] if alarm.version == topology.version],
    )


def changes(old: Topology, new: Topology) -> list[Change]:
    """Return what is new, gone or different in ``new``.

    First cameras, pairs, links between views and zones, then clocks.
    """
    result = [
        *_came_and_went("camera", {c.id: c for c in old.cameras}, {c.id: c for c in new.cameras}),
        *_pairs({p.cameras: p for p in old.pairs}, {p.cameras: p for p in new.pairs}),
        *_links(old, new),
        *_zones({z.id: z for z in old.zones}, {z.id: z for z in new.zones}),
    ]
    moved = {c.id: c.clock_offset for c in old.cameras}
    for camera in new.cameras:
        if abs(camera.clock_offset - moved.get(camera.id, camera.clock_offset)) >= 0.5:
            text = f"clock {moved[camera.id]:+.1f} s → {camera.clock_offset:+.1f} s"
            result.append(Change("~", "clock", [camera.id], text))
    return result


def _came_and_went(kind: str, old: Iterable[str], new: Iterable[str]) -> list[Change]:
    """Return the new and gone items of a kind."""
    before, after = set(old), set(new)
    return [Change("+", kind, [name], "new") for name in sorted(after - before)] + [
        Change("-", kind, [name], "gone") for name in sorted(before - after)
    ]


def _pairs(old: dict[tuple[str, str], Pair], new: dict[tuple[str, str], Pair]) -> list[Change]:
    """Return the changes of related pairs."""
    result = []
    for cameras in sorted({*old, *new}):
        was, now = old.get(cameras), new.get(cameras)
        if now is None and was is not None:
            result.append(Change("-", "pair", list(cameras), f"was {KINDS[was.relation]}"))
        elif was is None and now is not None:
            result.append(Change("+", "pair", list(cameras), KINDS[now.relation]))
        elif was is not None and now is not None and was.relation != now.relation:
            result.append(
                Change("~", "pair", list(cameras), f"{KINDS[was.relation]} → {KINDS[now.relation]}")
            )
    return result


def _links(old: Topology, new: Topology) -> list[Change]:
    """Return the changes of links between views."""
    before = {link_key(link): link for link in old.links if link.relation != "visible"}
    after = {link_key(link): link for link in new.links if link.relation != "visible"}
    result = []
    for key in sorted({*before, *after}):
        was, now = before.get(key), after.get(key)
        if now is None and was is not None:
            result.append(Change("-", "link", list(key), f"{_told(was)} before"))
        elif was is None and now is not None:
            result.append(Change("+", "link", list(key), _told(now)))
        elif was is not None and now is not None and (text := _difference(was, now)):
            result.append(Change("~", "link", list(key), text))
    return result


def _difference(was: Link, now: Link) -> str:
    """Return the notable changes of a link, in words; "" if there are none."""
    parts = []
    if abs(was.probability - now.probability) >= SHARE_CHANGE_MIN:
        parts.append(f"share {_percent(was.probability)} → {_percent(now.probability)}")
    apart = abs(was.transit.q50 - now.transit.q50)
    error = math.hypot(was.transit.q50_sd or 0.0, now.transit.q50_sd or 0.0)
    if apart > max(TIME_CHANGE_SD * error, TIME_CHANGE_SHARE * abs(was.transit.q50)):
        parts.append(f"median time {_time(was.transit.q50)} → {_time(now.transit.q50)}")
    return ", ".join(parts)


def _told(link: Link) -> str:
    return f"{link.relation}, share {_percent(link.probability)}, {_time(link.transit.q50)}"


def _time(seconds: float) -> str:
    return f"{-seconds:.1f} s before leaving" if seconds < 0 else f"{seconds:.1f} s"


def _zones(old: dict[str, Zone], new: dict[str, Zone]) -> list[Change]:
    """Return the zones that are new, gone or moved."""
    result = _came_and_went("zone", old, new)
    for name in sorted(set(old) & set(new)):
        was, now = old[name], new[name]
        if was.x is None or was.y is None or now.x is None or now.y is None:
            continue
        apart = max(abs(was.x - now.x), abs(was.y - now.y))
        if apart >= ZONE_MOVED_MIN:
            result.append(Change("~", "zone", [name], f"moved by {_percent(apart)} of the picture"))
    return result


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"
