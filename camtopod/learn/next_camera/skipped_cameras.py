"""Skipped cameras: next appearances of objects whose passage a camera missed.

An object that takes a link u -> a, passes the view from a to b and takes a link b -> v is seen at u
and next at v if the camera missed the passage. For every recorded object there are ``odds = m / (1
- m)`` such objects, m being the share of passages that the camera misses. There are far more such
pairs (u, v) than links, each with a percent or so of the departures, which is too little to find
them one by one. But the links and the passages give the probability and the lag of each, and only
the odds have to be estimated.

`links.missed_detections` uses the same paths to leave out links that they explain.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Indices, Ints, Longs
from camtopod.learn.association import Candidates
from camtopod.learn.links import match_rows
from camtopod.learn.traffic import Departures
from camtopod.topology import UNKNOWN_DWELL_SECONDS, LagBins, lag_smoothing_matrix

PASSAGE_SHARE_MIN = 0.02
"""Smallest share of the passages from an entry zone that a path through the view must have."""
LINK_SHARE_MIN = 0.05
"""Smallest share of the departures from a zone that a leg (zone to next zone) must have."""
WAY_SHARE_MIN = 1e-3
"""Smallest share of the departures from a zone that a path over a skipped camera must have."""
TIED_SHARE_MIN = 0.5
"""Share of a camera's exits that must be tied to entries; below, any entry may lead to any exit."""
LEG_QUANTILES = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
"""Quantiles of a leg's lags. A path's lags are the sums over both legs, plus the dwell time."""
SPREAD_SD_BINS = 2.0
"""Standard deviation, in lag bins, by which these lags are spread."""
WAYS_AT_ONCE = 1024
"""Paths worked on together: each takes memory for all pairs of quantiles of its two legs."""


class ViewPaths(NamedTuple):
    """Paths through views, (n,) each."""

    entry: Longs
    """Zone of entry."""
    exit: Longs
    """Zone of exit."""
    share: Floats
    """Share of the objects entering there that leave at ``exit``."""
    seconds: Floats
    """Median dwell time."""


class Legs(NamedTuple):
    """Next appearances with a sufficient share of the departures, (n,) each."""

    source: Ints
    """Zone of departure."""
    target: Ints
    """Zone of the next appearance."""
    share: Floats
    """Share of the departures at ``source``."""
    lag: Floats
    """(n, quantiles) lags in seconds at `LEG_QUANTILES`."""


def legs_of(
    share: Floats, appears: Callable[[Indices], Floats], candidates: Candidates, bins: LagBins
) -> Legs:
    """Return the legs that paths over a skipped camera may consist of.

    share (P,): share of the departures at each pair's source that appear next at its target.
    appears: function from pairs (n,) to that share by lag (n, bins).
    """
    some = np.flatnonzero(share >= LINK_SHARE_MIN)
    reached = np.cumsum(appears(some), axis=1) / share[some][:, None]
    lag = bins.centres[np.minimum((reached[:, :, None] < LEG_QUANTILES).sum(axis=1), bins.size - 1)]
    return Legs(candidates.source[some], candidates.target[some], share[some], lag)


def view_paths(departures: Departures, entry: Longs, camera: Longs) -> ViewPaths:
    """Return the likely paths through all views.

    entry (departures,): zone where the passage of each departure began, -1 where unknown.
    camera (zones,): camera of each zone.
    """
    zones, cameras, d = len(camera), int(camera.max(initial=-1)) + 1, departures
    tied = (entry >= 0) & np.isfinite(departures.since)

    # Cameras that tie enough of their exits to entries.
    of_camera = np.bincount(camera[d.zone], minlength=cameras)
    ties = np.bincount(camera[d.zone], tied, minlength=cameras) >= TIED_SHARE_MIN * np.maximum(
        of_camera, 1
    )

    # Paths through these views as observed, through the other views as any entry to any exit.
    key, n, seconds = _medians(entry[tied] * zones + d.zone[tied], (d.t - d.since)[tied])
    came, left = key // zones, key % zones
    share = n / np.bincount(came, n, minlength=zones)[came]
    known = ties[camera[came]] & (share >= PASSAGE_SHARE_MIN)
    guessed = _any_to_any(departures, camera, ~ties & (of_camera > 0))
    return ViewPaths(
        *(
            np.concatenate((ours[known], theirs))
            for ours, theirs in zip((came, left, share, seconds), guessed, strict=True)
        )
    )


def _any_to_any(departures: Departures, camera: Longs, wanted: NDArray[np.bool_]) -> ViewPaths:
    """Return paths through the views of some cameras as if the zone of entry did not matter.

    wanted (cameras,): whether to include a camera.
    """
    # Median dwell time of each camera.
    d = departures
    timed = np.isfinite(d.since)
    where, _, stay = _medians(camera[d.zone[timed]], (d.t - d.since)[timed])
    seconds = np.full(len(wanted), UNKNOWN_DWELL_SECONDS)
    seconds[where] = stay

    # Shares of the exits of each camera.
    left = np.bincount(d.zone, minlength=len(camera))
    share = left / np.maximum(np.bincount(camera, left)[camera], 1.0)
    mine = np.flatnonzero(wanted[camera])
    entry, ends = match_rows(camera[mine], camera[mine])
    kept = share[mine[ends]] >= PASSAGE_SHARE_MIN
    came, gone = mine[entry][kept], mine[ends][kept]
    return ViewPaths(came, gone, share[gone], seconds[camera[gone]])


def _medians(key: Longs, seconds: Floats) -> tuple[Longs, Longs, Floats]:
    """Return the keys that occur, how often each occurs and its (upper) median of ``seconds``."""
    present, number, n = np.unique(key, return_inverse=True, return_counts=True)
    order = np.lexsort((seconds, number))
    return present.astype(np.int64), n.astype(np.int64), seconds[order][np.cumsum(n) - n + n // 2]


def skip_hazards(
    legs: Legs, candidates: Candidates, through: ViewPaths, bins: LagBins, zones: int
) -> tuple[Longs, Floats]:
    """Return the pairs (K,), ascending, that paths over skipped cameras join, and their hazards.

    The pairs are indices into the candidates' pairs of zones. The hazards (K, bins) are those of
    appearing at the target because a camera was skipped, at odds of 1 (if every second passage is
    missed).
    """
    ways = _ways(legs, through)
    pair, known = _rows(
        candidates.source.astype(np.int64) * zones + candidates.target, ways.key(legs, zones)
    )
    present, number = np.unique(pair[known], return_inverse=True)
    return present.astype(np.int64), _along(
        ways.take(known), number, len(present), legs, through, bins
    )


def skip_hazards_elsewhere(
    legs: Legs, candidates: Candidates, through: ViewPaths, bins: LagBins, zones: int
) -> tuple[Ints, Ints, Floats]:
    """Return sources, targets (X,) and hazards (X, bins) of paths between zones without candidates.

    The hazards are as of `skip_hazards`.
    """
    ways = _ways(legs, through)
    key = ways.key(legs, zones)
    _, known = _rows(candidates.source.astype(np.int64) * zones + candidates.target, key)
    present, number = np.unique(key[~known], return_inverse=True)
    hazard = _along(ways.take(~known), number, len(present), legs, through, bins)
    return (
        (present // max(zones, 1)).astype(np.int32),
        (present % max(zones, 1)).astype(np.int32),
        hazard,
    )


class _Ways(NamedTuple):
    """Paths over one skipped camera, (n,) each: a leg, a path through a view, and a leg."""

    before: Indices
    """Row of the leg to that camera."""
    through: Indices
    """Row of the path through its view."""
    after: Indices
    """Row of the leg from that camera."""
    taken: Floats
    """Share of the departures at the start of the path that take it."""

    def key(self, legs: Legs, zones: int) -> Longs:
        """Return the key (n,) of the zones that each path joins: source * zones + target."""
        return legs.source[self.before].astype(np.int64) * zones + legs.target[self.after]

    def take(self, rows: NDArray[Any] | slice) -> _Ways:
        """Return some of the paths."""
        return _Ways(self.before[rows], self.through[rows], self.after[rows], self.taken[rows])


def _ways(legs: Legs, through: ViewPaths) -> _Ways:
    """Return all paths over one skipped camera with a share of at least `WAY_SHARE_MIN`."""
    before, way = match_rows(legs.target, through.entry)
    step, after = match_rows(through.exit[way], legs.source)
    before, way = before[step], way[step]
    taken = legs.share[before] * through.share[way] * legs.share[after]
    return _Ways(before, way, after, taken).take(taken >= WAY_SHARE_MIN)


def _along(
    ways: _Ways, number: NDArray[np.intp], rows: int, legs: Legs, through: ViewPaths, bins: LagBins
) -> Floats:
    """Return the hazards (rows, bins) of the paths at odds of 1.

    number (n,): row of each path in the result.
    """
    mass = np.zeros(rows * bins.size)
    for k in range(0, len(number), WAYS_AT_ONCE):
        part = slice(k, k + WAYS_AT_ONCE)
        some, middle = ways.take(part), through.seconds[ways.through[part]]
        lag = (
            legs.lag[some.before][:, :, None]
            + middle[:, None, None]
            + legs.lag[some.after][:, None, :]
        )
        # Cells of the sums of all quantiles of both legs.
        at = bins.index(lag)
        cell = number[part][:, None, None] * bins.size + at
        weight = np.broadcast_to((some.taken / len(LEG_QUANTILES) ** 2)[:, None, None], lag.shape)
        np.add.at(mass, cell[at >= 0], weight[at >= 0])

    # Spread over neighbouring bins, per second.
    hazard: Floats = (
        mass.reshape(-1, bins.size)
        @ lag_smoothing_matrix(bins.size, SPREAD_SD_BINS).T
        / bins.widths
    )
    return hazard


def _rows(pairs: Longs, wanted: Longs) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the rows of ``pairs`` (ascending) that hold the ``wanted``, and whether they do."""
    at = np.minimum(np.searchsorted(pairs, wanted), max(len(pairs) - 1, 0))
    return at, pairs[at] == wanted if len(pairs) else np.zeros(len(wanted), bool)
