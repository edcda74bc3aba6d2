"""In words: the evidence missing for the first link between views, and for a weak link.

A link joins the views of two cameras. Passages through one view, and objects that come back to the
view they have left, are in `Topology.links`, too; they are not counted as links where people read a
number of links.
"""

from __future__ import annotations

import math
from typing import Protocol

from camtopod.records import Lacks, Link, Topology
from camtopod.topology.site_names import camera_of

NAMED_TRANSITIONS_MIN = 2.0
"""Transitions from which a weak link is named as the nearest one to publication."""
_LONGEST = {"minutes": 120.0, "hours": 48.0, "days": math.inf}
"""Amount from which a duration is given in the next larger unit."""


class LinkEnds(Protocol):
    """The zones of a link."""

    @property
    def from_(self) -> str:
        """Where objects leave."""

    @property
    def to(self) -> str:
        """Where they appear."""


def links_between_views(topology: Topology) -> list[Link]:
    """Return the published links between the views of two cameras."""
    return [link for link in topology.links if joins_two_views(link)]


def links_in_words(count: int) -> str:
    """Return a number of links between views, in words."""
    return f"{count} {'link' if count == 1 else 'links'} between views"


def joins_two_views(link: LinkEnds) -> bool:
    """Return True if a link joins the views of two cameras."""
    return camera_of(link.from_) != camera_of(link.to)


def likely_links(topology: Topology) -> list[Link]:
    """Return the weak links between views that are half-way to publication, nearest first.

    Half-way: a link lacks at most as many passages as it has.
    """
    return [
        link
        for link in _lacking(topology)
        if link.lacks is not None and link.lacks.passages <= link.transitions
    ]


def waiting_for_links(topology: Topology) -> str:
    """Return a sentence on the missing evidence for the first link; "" if there is a link."""
    if links_between_views(topology):
        return ""

    # Passages and cameras so far.
    passages = sum(zone.exits for zone in topology.zones)
    so_far = f"{passages:,} {'passage' if passages == 1 else 'passages'} so far"
    cameras = [camera.id for camera in topology.cameras]
    if not cameras:
        return "No camera is known yet."
    if len(cameras) < 2:
        return f"A link needs two cameras: only {cameras[0]} has sent events, {so_far}."
    none_yet = f"No two cameras are linked yet: {so_far}."

    # The weak link that needs least time.
    nearest = next(iter(_lacking(topology)), None)
    if nearest is None or nearest.lacks is None:
        return f"{none_yet} A link takes about ten passages from one camera to another."
    total = nearest.transitions + nearest.lacks.passages
    return (
        f"{none_yet} The nearest one, {camera_of(nearest.from_)} to {camera_of(nearest.to)}, has "
        f"{nearest.transitions:.0f} of about {total:.0f}; "
        f"about {duration_in_words(nearest.lacks.seconds)} at this traffic."
    )


def lacks_in_words(lacks: Lacks) -> str:
    """Return the evidence that a weak link lacks, in words."""
    passages = (
        "one more passage" if lacks.passages < 1.5 else f"about {lacks.passages:.0f} more passages"
    )
    return f"{passages}, {duration_in_words(lacks.seconds)} at this traffic"


def duration_in_words(seconds: float) -> str:
    """Return a duration in whole minutes, hours or days, at least one minute."""
    minutes = seconds / 60.0
    for unit, amount in (
        ("minutes", minutes),
        ("hours", minutes / 60.0),
        ("days", minutes / 1440.0),
    ):
        if amount < _LONGEST[unit]:
            break
    return f"{max(amount, 1.0):.0f} {unit if amount >= 1.5 else unit[:-1]}"


def _lacking(topology: Topology) -> list[Link]:
    """Return the weak links between views that more traffic would publish, nearest first."""
    found = [
        link
        for link in topology.weak_links or []
        if link.lacks is not None
        and link.transitions >= NAMED_TRANSITIONS_MIN
        and joins_two_views(link)
    ]
    return sorted(
        found,
        key=lambda link: (math.inf if link.lacks is None else link.lacks.seconds, link.q_value),
    )
