"""In words: the evidence missing for the first link between views, and for a weak link.

A link joins the views of two cameras. Passages through one view, and objects that come back to the
view they have left, are in `Topology.links`, too; they are not counted as links where people read a
number of links.
"""

from __future__ import annotations

import math

import numpy as np

from camtopod.columns import numbers
from camtopod.records import Lacks, Link, Topology
from camtopod.topology.named_figures import weak_links
from camtopod.topology.site_names import camera_of

NAMED_TRANSITIONS_MIN = 2.0
"""Transitions from which a weak link counts as evidence for the first link."""
SHARE_MAX = 0.99
"""Largest share of the evidence that is said before there is a link."""
LEAD = 2.0
"""Least ratio of a pair's share of the evidence, at least one half, to that of any other pair, for
it to be named.
"""
DURATIONS = (
    (1_200.0, "some minutes"),
    (2_700.0, "about half an hour"),
    (5_400.0, "about an hour"),
    (36_000.0, "some hours"),
    (129_600.0, "about a day"),
    (math.inf, "some days"),
)
"""Durations in words, and the seconds up to which each is used."""


def links_between_views(topology: Topology) -> list[Link]:
    """Return the published links between the views of two cameras."""
    return [link for link in topology.links if _joins_two_views(link)]


def longest_lag(topology: Topology) -> float:
    """Return the longest transit time that a version looked for, seconds; 0 without a model."""
    model = topology.model
    if model is None:
        return 0.0
    delay = model.onward.delay if model.onward is not None else b""
    return model.lag_max + float(numbers(delay, np.float32, -1).max(initial=0.0))


def range_in_words(topology: Topology) -> str:
    """Return which transit times a version looked for; "" for one without a prediction model."""
    if topology.model is None:
        return ""
    overlap = -topology.model.lag_min
    return f"ways of up to {longest_lag(topology):.0f} s, overlaps of up to {overlap:.0f} s"


def likely_links(topology: Topology) -> list[Link]:
    """Return the weak links between views that are half-way to publication, nearest first.

    Half-way: a link lacks at most as many passages as it has.
    """
    return [link for link, lacks in _lacking(topology) if lacks.passages <= link.transitions]


def evidence_for_links(topology: Topology, before: Topology | None) -> float | None:
    """Return the share of the evidence for the first link; None if there is a link.

    before: the version before, whose share it does not fall below.
    """
    if links_between_views(topology):
        return None
    evidence_before = (before and before.evidence) or 0.0
    return round(max([evidence_before, *_shares(topology).values()]), 2)


def waiting_for_links(topology: Topology) -> str:
    """Return a sentence on the missing evidence for the first link; "" if there is a link."""
    if links_between_views(topology):
        return ""
    cameras = [camera.id for camera in topology.cameras]
    if not cameras:
        return "No camera is known yet."
    if len(cameras) < 2:
        return f"A link needs two cameras: only {cameras[0]} has sent events."
    for kind in ("entries", "exits"):
        if topology.zones and not any(getattr(zone, kind) for zone in topology.zones):
            return f"A link needs exits and entries: there are no {kind}."

    # The share, the time that is left, and the pair that leads clearly.
    shares = _shares(topology)
    share = evidence_for_links(topology, topology) or 0.0
    words = f"No two cameras are linked yet: {share:.0%} of the evidence is there"
    if shortfalls := _lacking(topology):
        words += f", the rest takes {duration_in_words(shortfalls[0][1].seconds)} at this traffic"
    second, first = sorted([0.5 / LEAD, 0.5 / LEAD, *shares.values()])[-2:]
    if first >= LEAD * second:
        leader, _ = max(shares.items(), key=lambda item: item[1])
        words += f"; nearest are {' and '.join(leader)}"
    return f"{words}."


def lacks_in_words(lacks: Lacks) -> str:
    """Return the evidence that a weak link lacks, in words."""
    passages = f"about {lacks.passages:.0f} more passages"
    if lacks.passages < 1.5:
        passages = "one more passage"
    return f"{passages}, {duration_in_words(lacks.seconds)} at this traffic"


def duration_in_words(seconds: float) -> str:
    """Return a duration in round words."""
    return next(words for limit, words in DURATIONS if seconds <= limit)


def _joins_two_views(link: Link) -> bool:
    """Return True if a link joins the views of two cameras."""
    return camera_of(link.from_) != camera_of(link.to)


def _lacking(topology: Topology) -> list[tuple[Link, Lacks]]:
    """Return the weak links between views that more traffic would publish, nearest first."""
    result = [
        (link, link.lacks)
        for link in weak_links(topology)
        if link.lacks is not None
        and link.transitions >= NAMED_TRANSITIONS_MIN
        and _joins_two_views(link)
    ]
    return sorted(result, key=lambda item: (item[1].seconds, item[0].q_value))


def _shares(topology: Topology) -> dict[tuple[str, str], float]:
    """Return the share of the evidence that is there, by pair of cameras, ids sorted."""
    shares: dict[tuple[str, str], float] = {}
    for link, lacks in _lacking(topology):
        first, second = sorted((camera_of(link.from_), camera_of(link.to)))
        share = min(link.transitions / (link.transitions + lacks.passages), SHARE_MAX)
        shares[first, second] = max(share, shares.get((first, second), 0.0))
    return shares
