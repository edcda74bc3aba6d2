"""In words: the evidence missing for the first link between views, and for a weak link.

A link joins the views of two cameras. Passages through one view, and objects that come back to the
view they have left, are in `Topology.links`, too; they are not counted as links where people read a
number of links.
"""

from __future__ import annotations

import math

from camtopod.records import Lacks, Link, Topology
from camtopod.topology.site_names import camera_of

NAMED_TRANSITIONS_MIN = 2.0
"""Transitions from which a weak link is named as the nearest one to publication."""
UNITS = (("minutes", 60.0, 120.0), ("hours", 3600.0, 48.0), ("days", 86400.0, math.inf))
"""Unit of a duration, its seconds, and amount from which the next larger one is used."""


def links_between_views(topology: Topology) -> list[Link]:
    """Return the published links between the views of two cameras."""
    return [link for link in topology.links if _joins_two_views(link)]


def links_in_words(count: int) -> str:
    """Return a number of links between views, in words."""
    if count == 1:
        return "1 link between views"
    return f"{count} links between views"


def likely_links(topology: Topology) -> list[Link]:
    """Return the weak links between views that are half-way to publication, nearest first.

    Half-way: a link lacks at most as many passages as it has.
    """
    return [link for link, lacks in _lacking(topology) if lacks.passages <= link.transitions]


def waiting_for_links(topology: Topology) -> str:
    """Return a sentence on the missing evidence for the first link; "" if there is a link."""
    if links_between_views(topology):
        return ""

    # Passages and cameras so far.
    so_far = f"{sum(zone.exits for zone in topology.zones):,} passages so far"
    cameras = [camera.id for camera in topology.cameras]
    if not cameras:
        return "No camera is known yet."
    if len(cameras) < 2:
        return f"A link needs two cameras: only {cameras[0]} has sent events, {so_far}."

    # The weak link that needs least time.
    none_yet = f"No two cameras are linked yet: {so_far}."
    for nearest, lacks in _lacking(topology):
        total = nearest.transitions + lacks.passages
        return (
            f"{none_yet} The nearest one, {camera_of(nearest.from_)} to {camera_of(nearest.to)}, "
            f"has {nearest.transitions:.0f} of about {total:.0f}; "
            f"about {duration_in_words(lacks.seconds)} at this traffic."
        )
    return f"{none_yet} A link takes about ten passages from one camera to another."


def lacks_in_words(lacks: Lacks) -> str:
    """Return the evidence that a weak link lacks, in words."""
    passages = f"about {lacks.passages:.0f} more passages"
    if lacks.passages < 1.5:
        passages = "one more passage"
    return f"{passages}, {duration_in_words(lacks.seconds)} at this traffic"


def duration_in_words(seconds: float) -> str:
    """Return a duration in whole minutes, hours or days, at least one minute."""
    if seconds < 90.0:
        return "1 minute"
    unit, length, _ = next(one for one in UNITS if seconds < one[1] * one[2])
    return f"{seconds / length:.0f} {unit}"


def _joins_two_views(link: Link) -> bool:
    """Return True if a link joins the views of two cameras."""
    return camera_of(link.from_) != camera_of(link.to)


def _lacking(topology: Topology) -> list[tuple[Link, Lacks]]:
    """Return the weak links between views that more traffic would publish, nearest first."""
    found = [
        (link, link.lacks)
        for link in topology.weak_links or []
        if link.lacks is not None
        and link.transitions >= NAMED_TRANSITIONS_MIN
        and _joins_two_views(link)
    ]
    return sorted(found, key=lambda one: (one[1].seconds, one[0].q_value))
