"""Skipped cameras: where objects appear next after a camera has missed their passage.

A *path over a skipped camera* consists of a *leg* (a transition from zone u to its next zone a), a
passage from a to b through a camera's view, and another leg from b to v. An object on this path is
recorded at u and next at v if the camera misses its passage: ``odds = m / (1 - m)`` objects for
every recorded one, m being the share of missed passages. Each pair (u, v) has too few transitions
to be found alone, but the legs and the passages give the probability and the lags of each:
`skip_hazards` computes the hazards at odds of 1, `skip_rate` estimates the odds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Indices, Ints, Longs, find_rows
from camtopod.learn.association import Candidates
from camtopod.learn.links import match_rows
from camtopod.learn.traffic import Departures
from camtopod.topology import UNKNOWN_DWELL_SECONDS, LagBins, lag_smoothing_matrix

PASSAGE_SHARE_MIN = 0.02
"""Least share of the passages from a zone of entry for a path through the view."""
LINK_SHARE_MIN = 0.05
"""Least share of the departures from a zone for a leg."""
WAY_SHARE_MIN = 1e-3
"""Least share of the departures from a zone for a path over a skipped camera."""
TIED_SHARE_MIN = 0.5
"""Least share of a camera's exits that tracks tie to an entry for its passages to be used as
recorded. Below, any entry may lead to any exit.
"""
LEG_QUANTILES = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
"""Quantiles that stand for the lags of a leg. The lags of a path are all sums of a quantile of each
leg and the median dwell time.
"""
SPREAD_SD_BINS = 2.0
"""Standard deviation, in lag bins, of the kernel by which the lags of a path are spread."""
WAYS_AT_ONCE = 1024
"""Paths processed together; each takes memory for all pairs of quantiles of its two legs."""


class ViewPaths(NamedTuple):
    """Paths through single views, from zone of entry to zone of exit; columns are (n,)."""

    entry: Longs
    """Zone of entry."""
    exit: Longs
    """Zone of exit."""
    share: Floats
    """Share of the objects entering at ``entry`` that leave at ``exit``."""
    seconds: Floats
    """Median dwell time in seconds."""


class Legs(NamedTuple):
    """Pairs of zones with a sufficient share of the departures to be legs; columns are (n,)."""

    source: Ints
    """Zone of departure."""
    target: Ints
    """Zone of the next appearance."""
    share: Floats
    """Share of the departures at ``source`` that appear next at ``target``."""
    lag: Floats
    """(n, quantiles) lags in seconds at `LEG_QUANTILES`."""


def legs_of(
    share: Floats, appears: Callable[[Indices], Floats], candidates: Candidates, bins: LagBins
) -> Legs:
    """Return the pairs of zones that may be legs of paths over a skipped camera.

    share (P,): share of the departures at each pair's source that appear next at its target.
    appears: function from pairs (n,) to this share by lag bin (n, bins).
    candidates: define the pairs.
    """
    pairs = np.flatnonzero(share >= LINK_SHARE_MIN)
    reached = np.cumsum(appears(pairs), axis=1) / share[pairs][:, None]
    lag = bins.centres[np.minimum((reached[:, :, None] < LEG_QUANTILES).sum(axis=1), bins.size - 1)]
    return Legs(candidates.source[pairs], candidates.target[pairs], share[pairs], lag)


def view_paths(departures: Departures, entry: Longs, camera: Longs) -> ViewPaths:
    """Return the frequent paths through all views, from zone of entry to zone of exit.

    entry (n,): zone where the passage of each departure began, -1 where unknown.
    camera (zones,): camera of each zone.
    """
    zones = len(camera)
    cameras = int(camera.max(initial=-1)) + 1
    d = departures
    tied = (entry >= 0) & np.isfinite(departures.since)

    # Cameras whose tracks tie enough exits to entries.
    of_camera = np.bincount(camera[d.zone], minlength=cameras)
    ties = np.bincount(camera[d.zone], tied, minlength=cameras) >= TIED_SHARE_MIN * np.maximum(
        of_camera, 1
    )

    # Paths through these views as recorded; through other views, from any entry to any exit.
    key, n, seconds = _medians(entry[tied] * zones + d.zone[tied], (d.t - d.since)[tied])
    entries = key // zones
    exits = key % zones
    share = n / np.bincount(entries, n, minlength=zones)[entries]
    known = ties[camera[entries]] & (share >= PASSAGE_SHARE_MIN)
    guessed = _any_to_any(departures, camera, ~ties & (of_camera > 0))
    return ViewPaths(
        *(
            np.concatenate((recorded[known], assumed))
            for recorded, assumed in zip((entries, exits, share, seconds), guessed, strict=True)
        )
    )


def _any_to_any(departures: Departures, camera: Longs, wanted: NDArray[np.bool_]) -> ViewPaths:
    """Return paths through some views, under the assumption that any entry may lead to any exit.

    camera (zones,): camera of each zone.
    wanted (cameras,): mask of the cameras whose views are included.
    """
    # Median dwell time of each camera.
    d = departures
    timed = np.isfinite(d.since)
    cameras_timed, _, dwell = _medians(camera[d.zone[timed]], (d.t - d.since)[timed])
    seconds = np.full(len(wanted), UNKNOWN_DWELL_SECONDS)
    seconds[cameras_timed] = dwell

    # Shares of the exits of each camera.
    exits_of_zone = np.bincount(d.zone, minlength=len(camera))
    share = exits_of_zone / np.maximum(np.bincount(camera, exits_of_zone)[camera], 1.0)
    zones_wanted = np.flatnonzero(wanted[camera])
    entry, ends = match_rows(camera[zones_wanted], camera[zones_wanted])
    kept = share[zones_wanted[ends]] >= PASSAGE_SHARE_MIN
    entries = zones_wanted[entry][kept]
    exits = zones_wanted[ends][kept]
    return ViewPaths(entries, exits, share[exits], seconds[camera[exits]])


def _medians(key: Longs, seconds: Floats) -> tuple[Longs, Longs, Floats]:
    """Return the keys that occur, how often each occurs, and the upper median of its ``seconds``.

    key, seconds (n,): key and value of n items.
    """
    present, number, n = np.unique(key, return_inverse=True, return_counts=True)
    order = np.lexsort((seconds, number))
    return present.astype(np.int64), n.astype(np.int64), seconds[order][np.cumsum(n) - n + n // 2]


def skip_hazards(
    legs: Legs, candidates: Candidates, through: ViewPaths, bins: LagBins, zones: int
) -> tuple[Longs, Floats]:
    """Return the pairs of zones that paths over skipped cameras join, and their hazards.

    legs: the possible legs of such paths.
    candidates: define the P pairs of zones of the fit.
    through: paths through single views.
    zones: number of zones.

    The results are the numbers (K,), ascending, of those pairs of the fit that such paths join; and
    the hazards (K, bins) of appearing at the target because a camera was skipped, at odds of 1 (if
    every second passage is missed).
    """
    paths = _ways(legs, through)
    pair, known = find_rows(
        candidates.source.astype(np.int64) * zones + candidates.target, paths.key(legs, zones)
    )
    present, number = np.unique(pair[known], return_inverse=True)
    return present.astype(np.int64), _along(
        paths.take(known), number, len(present), legs, through, bins
    )


def skip_hazards_elsewhere(
    legs: Legs, candidates: Candidates, through: ViewPaths, bins: LagBins, zones: int
) -> tuple[Ints, Ints, Floats]:
    """Return sources, targets (X,), hazards (X, bins) of joined pairs of zones without candidates.

    The fit does not have these pairs; arguments and hazards are as for `skip_hazards`.
    """
    paths = _ways(legs, through)
    key = paths.key(legs, zones)
    _, known = find_rows(candidates.source.astype(np.int64) * zones + candidates.target, key)
    present, number = np.unique(key[~known], return_inverse=True)
    hazard = _along(paths.take(~known), number, len(present), legs, through, bins)
    return (
        (present // max(zones, 1)).astype(np.int32),
        (present % max(zones, 1)).astype(np.int32),
        hazard,
    )


class _Ways(NamedTuple):
    """Paths over one skipped camera: leg, path through its view, leg; columns are (n,)."""

    before: Indices
    """Row in `Legs` of the leg to the skipped camera."""
    through: Indices
    """Row in `ViewPaths` of the path through its view."""
    after: Indices
    """Row in `Legs` of the leg from the skipped camera."""
    taken: Floats
    """Share of the departures at the start of the path that take it."""

    def key(self, legs: Legs, zones: int) -> Longs:
        """Return the key (n,) of the zones that each path joins: source * zones + target."""
        return legs.source[self.before].astype(np.int64) * zones + legs.target[self.after]

    def take(self, rows: NDArray[Any] | slice) -> _Ways:
        """Return the paths given by their rows."""
        return _Ways(self.before[rows], self.through[rows], self.after[rows], self.taken[rows])


def _ways(legs: Legs, through: ViewPaths) -> _Ways:
    """Return all paths over one skipped camera with a sufficient share (`WAY_SHARE_MIN`)."""
    before, way = match_rows(legs.target, through.entry)
    step, after = match_rows(through.exit[way], legs.source)
    before = before[step]
    way = way[step]
    taken = legs.share[before] * through.share[way] * legs.share[after]
    return _Ways(before, way, after, taken).take(taken >= WAY_SHARE_MIN)


def _along(
    ways: _Ways, number: NDArray[np.intp], rows: int, legs: Legs, through: ViewPaths, bins: LagBins
) -> Floats:
    """Return the sums of the hazards of paths at odds of 1, by row of the result, (rows, bins).

    number (n,): row of each path in the result.
    """
    mass = np.zeros(rows * bins.size)
    for k in range(0, len(number), WAYS_AT_ONCE):
        part = slice(k, k + WAYS_AT_ONCE)
        part_ways = ways.take(part)
        middle = through.seconds[ways.through[part]]
        lag = (
            legs.lag[part_ways.before][:, :, None]
            + middle[:, None, None]
            + legs.lag[part_ways.after][:, None, :]
        )
        # Cells of the sums of all quantiles of both legs.
        at = bins.index(lag)
        cell = number[part][:, None, None] * bins.size + at
        weight = np.broadcast_to(
            (part_ways.taken / len(LEG_QUANTILES) ** 2)[:, None, None], lag.shape
        )
        np.add.at(mass, cell[at >= 0], weight[at >= 0])

    # Spread over neighbouring bins, per second.
    hazard: Floats = (
        mass.reshape(-1, bins.size)
        @ lag_smoothing_matrix(bins.size, SPREAD_SD_BINS).T
        / bins.widths
    )
    return hazard
