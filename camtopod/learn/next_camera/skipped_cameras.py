"""Skipped views: an object that a camera on its way did not record appears next where that camera
would have led it.

Who takes u -> a, passes that view from a to b and takes b -> v is seen at u and next at v when the
camera missed the passage: for every one that it recorded there are ``odds = m / (1 - m)`` such, m
being the share that it misses. There are far more such pairs (u, v) than links, each with a percent
or so of the departures, too few to be found one by one; but the links and the passages say how
likely and how late each of them is, and only the odds have to be learned.

`missed` uses the same ways to publish no link that they explain.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Indices, Ints, Longs
from camtopod.learn.association import Candidates
from camtopod.learn.links import joined
from camtopod.learn.traffic import Departures
from camtopod.topology import UNKNOWN_STAY_SECONDS, LagBins, smoother

PASSAGE_SHARE_MIN = 0.02
"""Less likely ways through a view are not followed; nor are ..."""
LINK_SHARE_MIN = 0.05
"""... next appearances of a smaller share of the departures; nor ..."""
WAY_SHARE_MIN = 1e-3
"""... ways that fewer take."""
TIED_SHARE_MIN = 0.5
"""Of a camera that ties a smaller share of its exits to entries, any entry may lead to any exit."""
LEG_QUANTILES = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
SPREAD_SD_BINS = 2.0
"""The lags of a way are those of its legs at these quantiles, spread over this many bins."""
WAYS_AT_ONCE = 1024
"""Counted together: more would take memory for all quantiles of both legs of each."""


class Through(NamedTuple):
    """Ways through views, (n,) each: zones of entry and exit, share of those who enter there, usual
    seconds.
    """

    entry: Longs
    exit: Longs
    share: Floats
    seconds: Floats


class Legs(NamedTuple):
    """Next appearances that enough take, (n,) each: zones, share of the departures, lags (n,
    quantiles) in seconds.
    """

    source: Ints
    target: Ints
    share: Floats
    lag: Floats


def legs_of(
    share: Floats, appears: Callable[[Indices], Floats], candidates: Candidates, bins: LagBins
) -> Legs:
    """``share`` (P,) of those who leave at the source of each pair of zones that appears next at
    its target; ``appears``: of pairs (n,), by lag (n, bins).
    """
    some = np.flatnonzero(share >= LINK_SHARE_MIN)
    reached = np.cumsum(appears(some), axis=1) / share[some][:, None]
    lag = bins.centres[np.minimum((reached[:, :, None] < LEG_QUANTILES).sum(axis=1), bins.size - 1)]
    return Legs(candidates.source[some], candidates.target[some], share[some], lag)


def ways_through(departures: Departures, entry: Longs, camera: Longs) -> Through:
    """The likely ways through all views. ``entry`` (departures,): zone where the passage began, -1
    unknown; ``camera`` (zones,).
    """
    zones, cameras, d = len(camera), int(camera.max(initial=-1)) + 1, departures
    tied = (entry >= 0) & np.isfinite(departures.since)
    of_camera = np.bincount(camera[d.zone], minlength=cameras)
    ties = np.bincount(camera[d.zone], tied, minlength=cameras) >= TIED_SHARE_MIN * np.maximum(
        of_camera, 1
    )
    key, n, seconds = _medians(entry[tied] * zones + d.zone[tied], (d.t - d.since)[tied])
    came, left = key // zones, key % zones
    share = n / np.bincount(came, n, minlength=zones)[came]
    known = ties[camera[came]] & (share >= PASSAGE_SHARE_MIN)
    guessed = _any_to_any(departures, camera, ~ties & (of_camera > 0))
    return Through(
        *(
            np.concatenate((ours[known], theirs))
            for ours, theirs in zip((came, left, share, seconds), guessed, strict=True)
        )
    )


def _any_to_any(departures: Departures, camera: Longs, wanted: NDArray[np.bool_]) -> Through:
    """The ways through the views of the cameras ``wanted`` (cameras,) as if all who enter left
    alike.
    """
    d = departures
    timed = np.isfinite(d.since)
    where, _, stay = _medians(camera[d.zone[timed]], (d.t - d.since)[timed])
    seconds = np.full(len(wanted), UNKNOWN_STAY_SECONDS)
    seconds[where] = stay
    left = np.bincount(d.zone, minlength=len(camera))
    share = left / np.maximum(np.bincount(camera, left)[camera], 1.0)
    mine = np.flatnonzero(wanted[camera])
    entry, ends = joined(camera[mine], camera[mine])
    kept = share[mine[ends]] >= PASSAGE_SHARE_MIN
    came, gone = mine[entry][kept], mine[ends][kept]
    return Through(came, gone, share[gone], seconds[camera[gone]])


def _medians(key: Longs, seconds: Floats) -> tuple[Longs, Longs, Floats]:
    """The keys that occur, how often, and the (upper) median of their seconds."""
    present, number, n = np.unique(key, return_inverse=True, return_counts=True)
    order = np.lexsort((seconds, number))
    return present.astype(np.int64), n.astype(np.int64), seconds[order][np.cumsum(n) - n + n // 2]


def skip_hazards(
    legs: Legs, candidates: Candidates, through: Through, bins: LagBins, zones: int
) -> tuple[Longs, Floats]:
    """The pairs of the candidates (K,), ascending, to whose target a skipped view may have led, and
    the hazards (K, bins) of appearing there because it was, if every second one is.
    """
    ways = _ways(legs, through)
    pair, known = _rows(
        candidates.source.astype(np.int64) * zones + candidates.target, ways.key(legs, zones)
    )
    present, number = np.unique(pair[known], return_inverse=True)
    return present.astype(np.int64), _along(
        ways.take(known), number, len(present), legs, through, bins
    )


def skipped_beside(
    legs: Legs, candidates: Candidates, through: Through, bins: LagBins, zones: int
) -> tuple[Ints, Ints, Floats]:
    """Sources and targets (X,) of the ways over skipped views that are no pairs of the candidates,
    and the hazards (X, bins), as `skip_hazards`.
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
    """Ways over one skipped view, (n,) each: the leg before it, the way through it, the leg after
    it; and the share that takes it of those who leave where it begins.
    """

    before: Indices
    through: Indices
    after: Indices
    taken: Floats

    def key(self, legs: Legs, zones: int) -> Longs:
        """(n,) where they begin and end: source * zones + target."""
        return legs.source[self.before].astype(np.int64) * zones + legs.target[self.after]

    def take(self, rows: NDArray[Any] | slice) -> _Ways:
        """Some of them."""
        return _Ways(self.before[rows], self.through[rows], self.after[rows], self.taken[rows])


def _ways(legs: Legs, through: Through) -> _Ways:
    """The likely ways."""
    before, way = joined(legs.target, through.entry)
    step, after = joined(through.exit[way], legs.source)
    before, way = before[step], way[step]
    taken = legs.share[before] * through.share[way] * legs.share[after]
    return _Ways(before, way, after, taken).take(taken >= WAY_SHARE_MIN)


def _along(
    ways: _Ways, number: NDArray[np.intp], rows: int, legs: Legs, through: Through, bins: LagBins
) -> Floats:
    """Hazards (rows, bins) of the ways; ``number`` (n,): the row of each."""
    mass = np.zeros(rows * bins.size)
    for k in range(0, len(number), WAYS_AT_ONCE):
        part = slice(k, k + WAYS_AT_ONCE)
        some, middle = ways.take(part), through.seconds[ways.through[part]]
        lag = (
            legs.lag[some.before][:, :, None]
            + middle[:, None, None]
            + legs.lag[some.after][:, None, :]
        )
        at = bins.index(lag)
        cell = number[part][:, None, None] * bins.size + at
        weight = np.broadcast_to((some.taken / len(LEG_QUANTILES) ** 2)[:, None, None], lag.shape)
        np.add.at(mass, cell[at >= 0], weight[at >= 0])
    hazard: Floats = (
        mass.reshape(-1, bins.size) @ smoother(bins.size, SPREAD_SD_BINS).T / bins.widths
    )
    return hazard


def _rows(pairs: Longs, wanted: Longs) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Rows of ``pairs`` (ascending) in which the ``wanted`` are, and whether they are there at
    all.
    """
    at = np.minimum(np.searchsorted(pairs, wanted), max(len(pairs) - 1, 0))
    return at, pairs[at] == wanted if len(pairs) else np.zeros(len(wanted), bool)
