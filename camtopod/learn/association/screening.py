"""Screening: which candidates are worth a joint fit, where a site has too many cameras to weigh
them all.

With a dozen cameras every departure within the lags of an arrival is a candidate. With a hundred
there are thousands for each arrival, nearly all from the other end of the site; their number grows
with the square of the traffic. So two looks go before the fit, each far cheaper than it:

* *Rarely, over all pairs of zones*: what follows the departures of a zone more often than chance has it, at any lag
  (Makris, Ellis and Black 2004)? The zones that stand out most are followed as sources of the zone looked at, until it
  is looked at again. In each fit as many zones are looked at as its events allow, those whose look is longest ago
  first, so that the cost of an event does not depend on how many cameras there are.
* *In every fit, along the pairs followed*: a few rounds of the fit within one zone of arrival, where sources compete
  for its arrivals but targets do not yet for departures. What has next to no probability even so is left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from camtopod.arrays import Bools, Floats, Ints, Longs, Rows, Singles, rows_of
from camtopod.learn.association.candidates import (
    EXCESS_SMOOTHING_SD_BINS,
    RESPONSIBILITY_MAX,
    Candidates,
    excess,
    find_candidates,
    in_reach,
    number_pairs,
    possible,
)
from camtopod.learn.association.exposure import exposures
from camtopod.learn.association.joint_fit import START_FLOOR
from camtopod.learn.limits import (
    JUDGED_MAX,
    LOOKED_PER_EVENT_MAX,
    WEIGHED_AT_ONCE,
    WEIGHED_MAX,
    ZONE_PAIRS_MAX,
    clearest,
    zone_pairs_max,
)
from camtopod.learn.traffic import Arrivals, Chance, Departures
from camtopod.topology import LagBins, smooth, smoother

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
    """Sources followed of one zone of arrival, by `place`; and how many events had been learned at
    its last look.
    """

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

    @staticmethod
    def is_needed(
        departures: Departures, arrivals: Arrivals, bins: LagBins, zones: int, candidates_max: int
    ) -> bool:
        """Whether there are more candidates, or pairs of ``zones``, than can all be looked at."""
        low, high = in_reach(departures.t, arrivals.t, bins)
        return int((high - low).sum()) > candidates_max or zones**2 > PAIRS_FEW

    def find(
        self,
        departures: Departures,
        arrivals: Arrivals,
        bins: LagBins,
        places: Longs,
        until: float,
        learned: int,
        candidates_max: int,
        everywhere: bool = False,
    ) -> Candidates:
        """The candidates of a window: all of them while there are at most ``candidates_max``, and
        few pairs of zones.

        ``places`` (zones,): what zones are known by from one fit to the next; ``until``: seconds up
        to which events have come; ``learned``: events up to now; ``everywhere``: look at every zone
        now, as there is no other fit.
        """
        if not self.is_needed(departures, arrivals, bins, len(places), candidates_max):
            self.followed = {}
            return find_candidates(departures, arrivals, bins, len(places))
        low, high = in_reach(departures.t, arrivals.t, bins)
        ends = ends_of(departures, arrivals, bins, len(places), until)
        self._look(ends, places, learned, high - low, everywhere)
        sources_of = self._sources(places)

        # Beyond the limit the clearest arrivals count.
        reach, left = (
            np.zeros(len(arrivals.t), np.intp),
            [departures.t[rows] for rows in ends.leaving],
        )
        for zone, sources in sources_of.items():
            mine = ends.coming[zone]
            reach[mine] = _reach([left[source] for source in sources], arrivals.t[mine], bins)
        kept = clearest(reach, WEIGHED_MAX)

        def parts() -> Iterator[Part]:
            for zone, sources in sources_of.items():
                mine = ends.coming[zone][kept[ends.coming[zone]]]
                block = (np.cumsum(reach[mine]) - 1) // WEIGHED_AT_ONCE
                for some in np.split(mine, np.flatnonzero(np.diff(block)) + 1):
                    if len(some):
                        yield _likely(ends, zone, sources, some)

        return _joined(parts(), departures, arrivals, len(places))

    def _sources(self, places: Longs) -> dict[int, Longs]:
        """The zones followed as sources of each zone that has any, ascending."""
        row_of = {place: zone for zone, place in enumerate(places.tolist())}
        result = {}
        for zone, place in enumerate(places.tolist()):
            known = (row_of.get(source) for source in self.followed[place].sources.tolist())
            sources = np.array(sorted(row for row in known if row is not None), np.int64)
            if len(sources):
                result[zone] = sources
        return result

    def _look(self, ends: Ends, places: Longs, learned: int, reach: Rows, everywhere: bool) -> None:
        """Look at some zones again, or at all, over all pairs, and forget zones that are no
        more.
        """
        never = Followed(np.zeros(0, np.int64), -1)
        self.followed = {place: self.followed.get(place, never) for place in places.tolist()}
        pairs_max = zone_pairs_max(len(np.unique(places >> 32)))
        budget = max(LOOKS_MIN, LOOKS_PER_EVENT * (len(ends.departures.t) + len(ends.arrivals.t)))
        for zone in sorted(
            range(len(places)), key=lambda zone: self.followed[int(places[zone])].looked
        ):
            if budget <= 0 and not everywhere:
                break
            sources = standing_out(ends, zone, pairs_max)
            self.followed[int(places[zone])] = Followed(places[sources], learned)
            budget -= int(reach[ends.coming[zone]].sum()) + len(places) * ends.bins.size


def whole(
    candidates: Candidates,
    pairs: Rows,
    departures: Departures,
    arrivals: Arrivals,
    bins: LagBins,
    zones: int,
) -> Candidates:
    """All candidates of the ``pairs``, likely or not, and none of the others: for judging what was
    found. What is left of a pair after the unlikely ones have gone has the lag that was looked for,
    whether there is a link or not. Beyond `JUDGED_MAX` all of the clearest arrivals.
    """
    leaving, coming = rows_of(departures.zone, zones), rows_of(arrivals.zone, zones)
    pairs_to = {
        zone: pairs[rows]
        for zone, rows in enumerate(rows_of(candidates.target[pairs], zones))
        if len(rows)
    }

    # Beyond the limit the clearest arrivals count.
    reach = np.zeros(len(arrivals.t), np.intp)
    for zone, here in pairs_to.items():
        left = [departures.t[leaving[source]] for source in candidates.source[here]]
        reach[coming[zone]] = _reach(left, arrivals.t[coming[zone]], bins)
    clear = clearest(reach, JUDGED_MAX)

    parts = [
        (
            np.zeros(0, np.int32),
            np.zeros(0, np.int32),
            np.zeros(0, np.int32),
            np.zeros(0, np.float32),
        )
    ]
    for zone, here in pairs_to.items():
        number = np.full(zones, -1, np.int32)
        number[candidates.source[here]] = here
        among, mine = _among(leaving, candidates.source[here]), coming[zone][clear[coming[zone]]]
        for departure, at, lag in possible(departures, arrivals, bins, mine, among):
            came, pair = mine[at].astype(np.int32), number[departures.zone[departure]]
            parts.append((departure.astype(np.int32), came, pair, lag.astype(np.float32)))
    lefts, cames, pairings, lags = zip(*parts, strict=True)
    arrival = np.concatenate(cames)
    order = np.argsort(
        arrival, kind="stable"
    )  # each part has arrivals of its own, by arrival and departure
    return candidates._replace(
        departure=np.concatenate(lefts)[order],
        arrival=arrival[order],
        pair=np.concatenate(pairings)[order],
        lag=np.concatenate(lags)[order],
    )


def not_overlapping(
    candidates: Candidates,
    departures: Departures,
    arrivals: Arrivals,
    responsibility: Singles,
    overlapping: Bools,
) -> NDArray[np.bool_]:
    """Candidates (M,) that appear before the exit in the view of a camera that shows no overlap
    with this one.

    Two views overlap if `overlapping` found that they do (``overlapping`` (cameras, cameras)), or
    if the appearances before the exit, over all their zones and in both directions, have more
    evidence than chance gives any pair of cameras with probability `OVERLAP_FALSE`.
    """
    cameras = len(overlapping)
    c = candidates
    ahead = np.flatnonzero(c.lag < 0)
    left, came = departures.camera[c.departure[ahead]], arrivals.camera[c.arrival[ahead]]
    views = np.minimum(left, came).astype(np.int64) * cameras + np.maximum(left, came)
    present, pair = np.unique(views, return_inverse=True)
    key, number = np.unique(c.arrival[ahead].astype(np.int64) * cameras + left, return_inverse=True)
    share = np.minimum(
        np.bincount(number, responsibility[ahead], minlength=len(key)), RESPONSIBILITY_MAX
    )
    of_key = np.zeros(len(key), np.int64)
    of_key[number] = pair
    nats = np.bincount(of_key, -np.log1p(-share) - share, minlength=len(present))
    seen = nats >= np.log(max(cameras * (cameras - 1) / 2, 1.0) / OVERLAP_FALSE)
    seen |= (overlapping | overlapping.T)[present // cameras, present % cameras]
    result = np.zeros(len(c.lag), bool)
    result[ahead] = ~seen[pair]
    return result


def place(camera: int, number: int) -> int:
    """What a zone is known by from one fit to the next: index of its camera and number there."""
    return camera << 32 | number


def ends_of(
    departures: Departures, arrivals: Arrivals, bins: LagBins, zones: int, until: float
) -> Ends:
    """Departures and arrivals until a moment (seconds), made ready to be looked at."""
    return Ends(
        departures,
        arrivals,
        rows_of(departures.zone, zones),
        rows_of(arrivals.zone, zones),
        exposures(departures, bins, zones, until),
        Chance(departures.t, departures.zone, arrivals.t, arrivals.zone, zones),
        bins,
    )


def standing_out(ends: Ends, zone: int, pairs_max: int = ZONE_PAIRS_MAX) -> Rows:
    """Zones whose departures the arrivals at ``zone`` follow more often than by chance, at most
    `SOURCES_PER_ZONE_MAX` and as many as all zones may have with ``pairs_max``, ascending.
    """
    above = followed_above_chance(ends, zone)
    best = np.argsort(-above, kind="stable")[: min(SOURCES_PER_ZONE_MAX, pairs_max // len(above))]
    return np.sort(best[above[best] > STANDS_OUT_SD])


def followed_above_chance(ends: Ends, zone: int) -> Floats:
    """How far what the arrivals at ``zone`` follow stands out of chance at the lag where it does
    most, by the zone of departure (zones,), in standard deviations; -inf where too little was seen.
    """
    zones, bins = len(ends.leaving), ends.bins
    seen = np.zeros(zones * bins.size)
    every = ends.coming[zone]
    low, high = in_reach(ends.departures.t, ends.arrivals.t[every], bins)

    # Of too many pairs those of every second arrival are counted, or of every third, ...
    most = LOOKED_PER_EVENT_MAX * (len(ends.departures.t) + len(ends.arrivals.t))
    mine = every[:: -(-int((high - low).sum()) // most) or 1]
    for departure, _, lag in possible(
        ends.departures, ends.arrivals, bins, mine, at_once=COUNTED_AT_ONCE
    ):
        cell = ends.departures.zone[departure].astype(np.int64) * bins.size + bins.index(lag)
        seen += np.bincount(cell, minlength=len(seen))

    counts = seen.reshape(zones, bins.size)
    some = np.flatnonzero(counts.sum(axis=1) >= SEEN_MIN)
    rate = ends.chance.of(some, np.full(len(some), zone)) * (len(mine) / max(len(every), 1))
    usual = rate[:, None] * ends.exposure[some] * bins.widths
    result = np.full(zones, -np.inf)
    result[some] = _above(counts[some], usual, bins)
    return result


def _above(seen: Floats, chance: Floats, bins: LagBins) -> Floats:
    """How far each histogram of lags (P, bins) stands out of chance where it does most, in standard
    deviations (P,).
    """
    most = np.zeros(len(seen))
    for sd_bins in EXCESS_SMOOTHING_SD_BINS:
        spread = smoother(bins.size, sd_bins)
        noise = np.sqrt(np.maximum(chance, 0.5) @ (spread**2).T)
        most = np.maximum(most, (((seen - chance) @ spread.T) / noise).max(axis=1))
    return most


def _reach(left: list[Floats], came: Floats, bins: LagBins) -> Rows:
    """Departures in reach of each arrival (n,), ``left`` being the times of those of several
    zones.
    """
    reach = np.zeros(len(came), np.intp)
    for times in left:
        low, high = in_reach(times, came, bins)
        reach += high - low
    return reach


def _among(leaving: list[Rows], sources: Longs | Ints) -> Rows:
    """Rows of the departures of several zones, ascending."""
    return np.sort(np.concatenate([leaving[source] for source in sources]), kind="stable")


def _likely(ends: Ends, zone: int, sources: Longs, mine: Rows) -> Part:
    """Departure, arrival, lag and probability of the likely candidates for the arrivals ``mine`` at
    one zone.
    """
    bins = ends.bins
    among = _among(ends.leaving, sources)
    number = np.zeros(len(ends.leaving), np.int64)
    number[sources] = np.arange(len(sources))

    # Only what is needed of each pair is kept of each part: departure, index into ``mine``, source
    # and lag bin, lag.
    parts = [
        (
            np.zeros(0, np.int32),
            np.zeros(0, np.int32),
            np.zeros(0, np.int32),
            np.zeros(0, np.float32),
        )
    ]
    for left, came, apart in possible(ends.departures, ends.arrivals, bins, mine, among):
        at_bin = (number[ends.departures.zone[left]] * bins.size + bins.index(apart)).astype(
            np.int32
        )
        parts.append(
            (left.astype(np.int32), came.astype(np.int32), at_bin, apart.astype(np.float32))
        )
    departure, at, cell, lag = (np.concatenate(column) for column in zip(*parts, strict=True))
    del parts

    size = len(sources) * bins.size
    exposed = ends.exposure[sources] * bins.widths
    usual = ends.chance.of(sources, np.full(len(sources), zone))[:, None] * exposed
    seen = np.bincount(cell, minlength=size).reshape(-1, bins.size).astype(float)
    hazard = np.maximum(excess(seen, usual, bins, NOISE_SD), START_FLOOR * seen) / np.maximum(
        exposed, bins.widths
    )
    outside, share = OUTSIDE_FIRST * ends.arrivals.rate[mine], np.zeros(0)
    for _ in range(ROUNDS):
        weight = hazard.ravel()[cell]
        share = weight / (outside + np.bincount(at, weight, minlength=len(mine)))[at]
        once = share / np.maximum(np.bincount(departure, share), 1.0)[departure]
        moved = np.bincount(cell, once, minlength=size).reshape(-1, bins.size).astype(float)
        hazard = smooth(moved)[0] / (np.maximum(ends.exposure[sources], 1.0) * bins.widths)
    kept = share > LIKELY_MIN
    return (
        departure[kept],
        mine[at[kept]].astype(np.int32),
        lag[kept],
        share[kept].astype(np.float32),
    )


def _joined(
    parts: Iterable[Part], departures: Departures, arrivals: Arrivals, zones: int
) -> Candidates:
    """The likeliest candidates of all parts, by arrival."""
    most = max(LIKELY_MAX, LIKELY_PER_ARRIVAL * len(arrivals.t))
    held: list[Part] = []
    n = 0
    for part in parts:
        held.append(part)
        n += len(part[0])
        if n > 2 * most:  # what is not among the likeliest by now will not be in the end
            held = [_likeliest(held, most, most + most // 2)]
            n = len(held[0][0])
    departure, arrival, lag, _ = _likeliest(held, most, most)
    order = np.argsort(
        arrival, kind="stable"
    )  # each part has arrivals of its own, by arrival and departure
    departure, arrival, lag = departure[order], arrival[order], lag[order]
    pair, source, target = number_pairs(departures.zone[departure], arrivals.zone[arrival], zones)
    return Candidates(departure, arrival, pair, lag, source, target)


def _likeliest(parts: list[Part], most: int, room: int) -> Part:
    """The likeliest ``most`` of all parts and those that are as likely as the last of them, in all
    at most ``room``.
    """
    nothing = (
        np.zeros(0, np.int32),
        np.zeros(0, np.int32),
        np.zeros(0, np.float32),
        np.zeros(0, np.float32),
    )
    departure, arrival, lag, share = (
        np.concatenate(column) for column in zip(nothing, *parts, strict=True)
    )
    if len(share) <= most:
        return departure, arrival, lag, share
    least = np.partition(share, len(share) - most)[len(share) - most]
    kept = np.flatnonzero(share >= least)[:room]
    return departure[kept], arrival[kept], lag[kept], share[kept]
