"""Screening: which candidates are worth a joint fit, where a site has too many cameras to weigh them all.

With a dozen cameras every departure within the lags of an arrival is a candidate. With a hundred there are thousands
for each arrival, nearly all from the other end of the site; their number grows with the square of the traffic. So two
looks go before the fit, each far cheaper than it:

* *Rarely, over all pairs of zones*: what follows the departures of a zone more often than chance has it, at any lag
  (Makris, Ellis and Black 2004)? The zones that stand out most are followed as sources of the zone looked at, until it
  is looked at again. In each fit as many zones are looked at as its events allow, those whose look is longest ago
  first, so that the cost of an event does not depend on how many cameras there are.
* *In every fit, along the pairs followed*: a few rounds of the fit within one zone of arrival, where sources compete
  for its arrivals but targets do not yet for departures. What has next to no probability even so is left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from camtopod.learn.candidates import (
    EXCESS_SMOOTHING_SD_BINS,
    Arrivals,
    Candidates,
    Departures,
    Singles,
    excess,
    find_candidates,
    in_reach,
    number_pairs,
    possible,
)
from camtopod.learn.exposure import exposures
from camtopod.learn.grouping import rows_of
from camtopod.learn.joint import START_FLOOR
from camtopod.learn.lags import LagBins, smoother
from camtopod.learn.rates import Chance
from camtopod.learn.significance import RESPONSIBILITY_MAX
from camtopod.learn.smoothing import smooth

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Longs = NDArray[np.int64]
Rows = NDArray[np.intp]
Part = tuple[Ints, Ints, Singles, Singles]

PAIRS_FEW = 20_000
"""So few pairs of zones are all followed, unless their candidates are too many."""
SOURCES_PER_ZONE_MAX = 32
"""Zones that are followed as sources of one zone."""
SEEN_MIN = 3
"""What was seen to follow fewer times than this stands out of nothing."""
STANDS_OUT_SD = 2.0
"""What exceeds chance by fewer standard deviations is not followed."""
LOOKS_PER_EVENT = 400
"""Candidates counted in looks over all pairs for each event of the window, in each fit ..."""
LOOKS_MIN = 20_000_000
"""... and at least so many, which is a second's work."""
COUNTED_AT_ONCE = 1 << 17
ROUNDS = 2
"""Rounds within one zone of arrival."""
NOISE_SD = 0.5
OUTSIDE_FIRST = 0.5
"""Share of the arrivals that come from outside, as the rounds begin."""
OVERLAP_FALSE = 0.05
"""Probability that any two of the cameras that do not overlap seem to."""
LIKELY_MIN = 0.001
"""Less likely candidates are left out ..."""
LIKELY_MAX, LIKELY_PER_ARRIVAL = 3_000_000, 8
"""... and all but so many, or so many for each arrival if that is more: the likeliest."""


class Followed(Struct):
    """Sources followed of one zone of arrival, by `place`; and how many events had been learned at its last look."""

    sources: Longs
    looked: int


class Ends(NamedTuple):
    """Departures and arrivals of a window with what the looks need of them."""

    departures: Departures
    arrivals: Arrivals
    leaving: list[Rows]
    """(zones,) rows of the departures of each zone."""
    coming: list[Rows]
    """(zones,) rows of the arrivals of each zone."""
    exposure: Floats
    """(zones, bins)"""
    chance: Chance
    bins: LagBins


class Screen:
    """Keeps what is followed. Nothing is, and all candidates are found, while they are few."""

    def __init__(self) -> None:
        self.followed: dict[int, Followed] = {}
        """By `place` of the zone of arrival."""

    def find(
        self, departures: Departures, arrivals: Arrivals, bins: LagBins, places: Longs, until: float, learned: int,
        candidates_max: int,
    ) -> Candidates:  # fmt: skip
        """The candidates of a window: all of them while there are at most ``candidates_max``, and few pairs of zones.

        ``places`` (zones,): what zones are known by from one fit to the next; ``until``: seconds up to which events
        have come; ``learned``: events up to now.
        """
        low, high = in_reach(departures, arrivals, bins)
        if int((high - low).sum()) <= candidates_max and len(places) ** 2 <= PAIRS_FEW:
            self.followed = {}
            return find_candidates(departures, arrivals, bins, len(places))
        ends = _ends(departures, arrivals, bins, len(places), until)
        self._look(ends, places, learned, high - low)
        row_of = {place: zone for zone, place in enumerate(places.tolist())}

        def parts() -> Iterator[Part]:
            for zone, place in enumerate(places.tolist()):
                known = (row_of.get(source) for source in self.followed[place].sources.tolist())
                sources = np.array(sorted(row for row in known if row is not None), np.int64)
                if len(sources) and len(ends.coming[zone]):
                    yield _likely(ends, zone, sources)

        return _joined(parts(), departures, arrivals, len(places))

    def _look(self, ends: Ends, places: Longs, learned: int, reach: Rows) -> None:
        """Look at some zones again, over all pairs, and forget zones that are no more."""
        never = Followed(np.zeros(0, np.int64), -1)
        self.followed = {place: self.followed.get(place, never) for place in places.tolist()}
        budget = max(LOOKS_MIN, LOOKS_PER_EVENT * (len(ends.departures.t) + len(ends.arrivals.t)))
        for zone in sorted(range(len(places)), key=lambda zone: self.followed[int(places[zone])].looked):
            if budget <= 0:
                break
            sources = standing_out(ends, zone)
            self.followed[int(places[zone])] = Followed(places[sources], learned)
            budget -= int(reach[ends.coming[zone]].sum()) + len(places) * ends.bins.size


def whole(
    candidates: Candidates, pairs: Rows, departures: Departures, arrivals: Arrivals, bins: LagBins, zones: int
) -> Candidates:
    """All candidates of the ``pairs``, likely or not, and none of the others: for judging what was found. What is left
    of a pair after the unlikely ones have gone has the lag that was looked for, whether there is a link or not.
    """
    leaving, coming = rows_of(departures.zone, zones), rows_of(arrivals.zone, zones)
    parts = []
    for zone, rows in enumerate(rows_of(candidates.target[pairs], zones)):
        if not len(rows):
            continue
        number = np.full(zones, -1, np.int32)
        number[candidates.source[pairs[rows]]] = pairs[rows]
        among = np.sort(np.concatenate([leaving[source] for source in candidates.source[pairs[rows]]]))
        departure, at, lag = possible(departures, arrivals, bins, coming[zone], among)
        came, pair = coming[zone][at].astype(np.int32), number[departures.zone[departure]]
        parts.append((departure.astype(np.int32), came, pair, lag.astype(np.float32)))
    nothing = (np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0, np.float32))
    lefts, cames, pairings, lags = zip(nothing, *parts, strict=True)
    arrival = np.concatenate(cames)
    order = np.argsort(arrival, kind="stable")  # each part has arrivals of its own, by arrival and departure
    return candidates._replace(
        departure=np.concatenate(lefts)[order], arrival=arrival[order], pair=np.concatenate(pairings)[order],
        lag=np.concatenate(lags)[order],
    )  # fmt: skip


def not_overlapping(
    candidates: Candidates, departures: Departures, arrivals: Arrivals, responsibility: Singles, cameras: int
) -> NDArray[np.bool_]:
    """Candidates (M,) that appear before the exit in the view of a camera that shows no overlap with this one.

    Whether two views overlap is asked of all their zones, both ways, at once: how much better do appearances ahead of
    the exit predict arrivals than nothing does? By chance anywhere with a probability of `OVERLAP_FALSE`.
    """
    c = candidates
    ahead = np.flatnonzero(c.lag < 0)
    left, came = departures.camera[c.departure[ahead]], arrivals.camera[c.arrival[ahead]]
    views = np.minimum(left, came).astype(np.int64) * cameras + np.maximum(left, came)
    present, pair = np.unique(views, return_inverse=True)
    key, number = np.unique(c.arrival[ahead].astype(np.int64) * cameras + left, return_inverse=True)
    share = np.minimum(np.bincount(number, responsibility[ahead], minlength=len(key)), RESPONSIBILITY_MAX)
    of_key = np.zeros(len(key), np.int64)
    of_key[number] = pair
    nats = np.bincount(of_key, -np.log1p(-share) - share, minlength=len(present))
    overlapping = nats >= np.log(max(cameras * (cameras - 1) / 2, 1.0) / OVERLAP_FALSE)
    result = np.zeros(len(c.lag), bool)
    result[ahead] = ~overlapping[pair]
    return result


def place(camera: int, number: int) -> int:
    """What a zone is known by from one fit to the next: index of its camera and number there."""
    return camera << 32 | number


def _ends(departures: Departures, arrivals: Arrivals, bins: LagBins, zones: int, until: float) -> Ends:
    return Ends(
        departures, arrivals, rows_of(departures.zone, zones), rows_of(arrivals.zone, zones),
        exposures(departures, bins, zones, until),
        Chance(departures.t, departures.zone, arrivals.t, arrivals.zone, zones), bins,
    )  # fmt: skip


def standing_out(ends: Ends, zone: int) -> Rows:
    """Zones whose departures the arrivals at ``zone`` follow more often than by chance, at most
    `SOURCES_PER_ZONE_MAX`, ascending.
    """
    zones, bins = len(ends.leaving), ends.bins
    seen = np.zeros(zones * bins.size)
    mine = ends.coming[zone]
    low, high = in_reach(ends.departures, ends.arrivals.take(mine), bins)
    reached = np.cumsum(high - low)
    for k in range(0, int(reached[-1]) if len(mine) else 0, COUNTED_AT_ONCE):
        few = mine[slice(*np.searchsorted(reached, (k, k + COUNTED_AT_ONCE), side="right"))]
        departure, _, lag = possible(ends.departures, ends.arrivals, bins, few)
        cell = ends.departures.zone[departure].astype(np.int64) * bins.size + bins.index(lag)
        seen += np.bincount(cell, minlength=len(seen))
    counts = seen.reshape(zones, bins.size)
    some = np.flatnonzero(counts.sum(axis=1) >= SEEN_MIN)
    usual = ends.chance.of(some, np.full(len(some), zone))[:, None] * ends.exposure[some] * bins.widths
    above = _above(counts[some], usual, bins)
    best = np.argsort(-above, kind="stable")[:SOURCES_PER_ZONE_MAX]
    return np.sort(some[best[above[best] > STANDS_OUT_SD]])


def _above(seen: Floats, chance: Floats, bins: LagBins) -> Floats:
    """How far each histogram of lags (P, bins) stands out of chance where it does most, in standard deviations (P,)."""
    most = np.zeros(len(seen))
    for sd_bins in EXCESS_SMOOTHING_SD_BINS:
        spread = smoother(bins.size, sd_bins)
        noise = np.sqrt(np.maximum(chance, 0.5) @ (spread**2).T)
        most = np.maximum(most, (((seen - chance) @ spread.T) / noise).max(axis=1))
    return most


def _likely(ends: Ends, zone: int, sources: Longs) -> Part:
    """Departure, arrival, lag and probability of the likely candidates for the arrivals at one zone."""
    bins, mine = ends.bins, ends.coming[zone]
    among = np.sort(np.concatenate([ends.leaving[source] for source in sources]))
    departure, at, lag = possible(ends.departures, ends.arrivals, bins, mine, among)
    number = np.zeros(len(ends.leaving), np.int64)
    number[sources] = np.arange(len(sources))
    cell = number[ends.departures.zone[departure]] * bins.size + bins.index(lag)
    size = len(sources) * bins.size
    exposed = ends.exposure[sources] * bins.widths
    usual = ends.chance.of(sources, np.full(len(sources), zone))[:, None] * exposed
    seen = np.bincount(cell, minlength=size).reshape(-1, bins.size).astype(float)
    hazard = np.maximum(excess(seen, usual, bins, NOISE_SD), START_FLOOR * seen) / np.maximum(exposed, bins.widths)
    outside, share = OUTSIDE_FIRST * ends.arrivals.rate[mine], np.zeros(0)
    for _ in range(ROUNDS):
        weight = hazard.ravel()[cell]
        share = weight / (outside + np.bincount(at, weight, minlength=len(mine)))[at]
        once = share / np.maximum(np.bincount(departure, share), 1.0)[departure]
        moved = np.bincount(cell, once, minlength=size).reshape(-1, bins.size).astype(float)
        hazard = smooth(moved)[0] / (np.maximum(ends.exposure[sources], 1.0) * bins.widths)
    kept = share > LIKELY_MIN
    left, came = departure[kept].astype(np.int32), mine[at[kept]].astype(np.int32)
    return left, came, lag[kept].astype(np.float32), share[kept].astype(np.float32)


def _joined(parts: Iterator[Part], departures: Departures, arrivals: Arrivals, zones: int) -> Candidates:
    """The likeliest candidates of all parts, by arrival."""
    nothing = (np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0, np.float32), np.zeros(0, np.float32))
    columns = [list(column) for column in zip(nothing, *parts, strict=True)]
    # One at a time, as they are gone when they are joined.
    share, lag, arrival, departure = (np.concatenate(columns.pop()) for _ in nothing)
    most = max(LIKELY_MAX, LIKELY_PER_ARRIVAL * len(arrivals.t))
    if len(share) > most:
        least = np.partition(share, len(share) - most)[len(share) - most]
        likeliest = np.flatnonzero(share >= least)[:most]
        departure, arrival, lag = departure[likeliest], arrival[likeliest], lag[likeliest]
    del share
    order = np.argsort(arrival, kind="stable")  # each part has arrivals of its own, by arrival and departure
    departure, arrival, lag = departure[order], arrival[order], lag[order]
    pair, source, target = number_pairs(departures.zone[departure], arrivals.zone[arrival], zones)
    return Candidates(departure, arrival, pair, lag, source, target)
