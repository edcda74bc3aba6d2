"""Screening: select the candidates worth a joint fit, on sites with too many cameras to weigh all.

With a dozen cameras every departure within the lags of an arrival is a candidate. With a hundred
there are thousands for each arrival, nearly all from the other end of the site, and their number
grows with the square of the traffic. Two cheaper steps go before the fit:

* *Looks over all pairs of zones, rarely*: which zones do the arrivals at a zone follow more often
  than under the null model, at any lag (Makris, Ellis and Black 2004)? The zones that stand out
  most are followed as sources of that zone until its next look. Each fit looks at as many zones as
  its number of events allows, those with the oldest look first, so the cost per event does not
  depend on the number of cameras.
* *Weighing along the pairs followed, in every fit*: a few rounds of the fit within one zone of
  arrival, where sources compete for its arrivals but targets do not yet compete for departures.
  Candidates that remain improbable are dropped.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from camtopod.arrays import Bools, Floats, Ints, Longs, Rows, Singles, rows_by_group
from camtopod.learn.association.candidates import (
    EXCESS_SMOOTHING_SD_BINS,
    RESPONSIBILITY_MAX,
    Candidates,
    departures_in_reach,
    excess_over_null,
    find_candidates,
    number_pairs,
    possible,
)
from camtopod.learn.association.em import START_FLOOR
from camtopod.learn.association.exposure import exposures
from camtopod.learn.limits import (
    JUDGED_MAX,
    WEIGHED_AT_ONCE,
    WEIGHED_MAX,
    ZONE_PAIRS_MAX,
    ZONE_SCREEN_PAIRS_PER_EVENT_MAX,
    arrivals_within,
    zone_pairs_max,
)
from camtopod.learn.traffic import Arrivals, Departures, NullRates
from camtopod.topology import LagBins, lag_smoothing_matrix, smooth

Part = tuple[Ints, Ints, Singles, Singles]
"""Some candidates, (n,) each: departure, arrival, lag in seconds, probability."""

PAIRS_FEW = 20_000
"""Up to this many pairs of zones, all are followed, unless there are too many candidates."""
SOURCES_PER_ZONE_MAX = 32
"""Largest number of zones followed as sources of one zone."""
SEEN_MIN = 3
"""Pairs of zones with fewer candidates in the look are not followed."""
STANDS_OUT_SD = 2.0
"""Pairs that exceed the null model by fewer standard deviations are not followed."""
LOOKS_PER_EVENT = 400
"""Work on looks in each fit, per event of the window: candidates counted plus histogram cells."""
LOOKS_MIN = 20_000_000
"""Least work on looks in each fit, in the same unit; about a second."""
COUNTED_AT_ONCE = 1 << 17
"""Candidates of a look that are counted together."""
ROUNDS = 2
"""Rounds of the fit within one zone of arrival."""
NOISE_SD = 0.5
"""Standard deviations of the null model that the initial hazards of these rounds must exceed."""
OUTSIDE_FIRST = 0.5
"""Share of the arrivals that come from outside, kept fixed in these rounds."""
OVERLAP_FALSE = 0.05
"""Probability that overlap is found for any pair of the cameras of a site without overlap."""
LIKELY_MIN = 0.001
"""Candidates of at most this probability are dropped."""
LIKELY_MAX, LIKELY_PER_ARRIVAL = 3_000_000, 8
"""Limits of the candidates kept for the fit, the likeliest: in all, and per arrival.

The larger of the two counts.
"""


class FollowedSources(Struct):
    """Sources followed of one zone of arrival."""

    sources: Longs
    """Zones of departure, by `place`."""
    looked: int
    """Number of events learned at the last look at this zone; -1 if there was none."""


class ScreenInput(NamedTuple):
    """Departures and arrivals of a window, prepared for looks and weighing."""

    departures: Departures
    arrivals: Arrivals
    leaving: list[Rows]
    """(zones,) rows of the departures of each zone."""
    coming: list[Rows]
    """(zones,) rows of the arrivals of each zone."""
    exposure: Floats
    """(zones, bins) exposed departures."""
    chance: NullRates
    """Rates of arrivals under the null model."""
    bins: LagBins


class CandidateScreen:
    """Selects the candidates of each fit, and remembers which pairs of zones are followed.

    While pairs of zones and candidates are few, all candidates are returned and nothing is
    remembered.
    """

    def __init__(self) -> None:
        self.followed: dict[int, FollowedSources] = {}
        """Sources followed, by `place` of the zone of arrival."""

    @staticmethod
    def is_needed(
        departures: Departures, arrivals: Arrivals, bins: LagBins, zones: int, candidates_max: int
    ) -> bool:
        """Return True if there are more candidates, or pairs of zones, than can all be weighed."""
        low, high = departures_in_reach(departures.t, arrivals.t, bins)
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
        """Return the candidates of a window, screened if there are too many.

        places (zones,): keys of the zones that stay the same from one fit to the next, see `place`.
        until (seconds): end of the window.
        learned: number of events learned so far.
        everywhere: look at every zone now, as there is no other fit.
        """
        if not self.is_needed(departures, arrivals, bins, len(places), candidates_max):
            self.followed = {}
            return find_candidates(departures, arrivals, bins, len(places))

        # Look at the zones whose turn it is.
        low, high = departures_in_reach(departures.t, arrivals.t, bins)
        ends = screen_input(departures, arrivals, bins, len(places), until)
        self._look(ends, places, learned, high - low, everywhere)
        sources_of = self._sources(places)

        # Count the departures in reach of each arrival; beyond the limit, the arrivals with the
        # fewest are kept.
        reach, left = (
            np.zeros(len(arrivals.t), np.intp),
            [departures.t[rows] for rows in ends.leaving],
        )
        for zone, sources in sources_of.items():
            mine = ends.coming[zone]
            reach[mine] = _reach([left[source] for source in sources], arrivals.t[mine], bins)
        kept = arrivals_within(reach, WEIGHED_MAX)

        # Weigh the candidates of one zone of arrival at a time, in blocks.
        def parts() -> Iterator[Part]:
            for zone, sources in sources_of.items():
                mine = ends.coming[zone][kept[ends.coming[zone]]]
                block = (np.cumsum(reach[mine]) - 1) // WEIGHED_AT_ONCE
                for some in np.split(mine, np.flatnonzero(np.diff(block)) + 1):
                    if len(some):
                        yield _likely(ends, zone, sources, some)

        return _joined(parts(), departures, arrivals, len(places))

    def _sources(self, places: Longs) -> dict[int, Longs]:
        """Return the sources followed of each zone that has any, as ascending zone indices."""
        row_of = {place: zone for zone, place in enumerate(places.tolist())}
        result = {}
        for zone, place in enumerate(places.tolist()):
            known = (row_of.get(source) for source in self.followed[place].sources.tolist())
            sources = np.array(sorted(row for row in known if row is not None), np.int64)
            if len(sources):
                result[zone] = sources
        return result

    def _look(
        self, ends: ScreenInput, places: Longs, learned: int, reach: Rows, everywhere: bool
    ) -> None:
        """Look at the zones with the oldest looks, within the budget; forget zones that are gone.

        reach: departures within the lags of each arrival, the cost of a look.
        """
        never = FollowedSources(np.zeros(0, np.int64), -1)
        self.followed = {place: self.followed.get(place, never) for place in places.tolist()}

        pairs_max = zone_pairs_max(len(np.unique(places >> 32)))
        budget = max(LOOKS_MIN, LOOKS_PER_EVENT * (len(ends.departures.t) + len(ends.arrivals.t)))
        for zone in sorted(
            range(len(places)), key=lambda zone: self.followed[int(places[zone])].looked
        ):
            if budget <= 0 and not everywhere:
                break
            sources = find_sources(ends, zone, pairs_max)
            self.followed[int(places[zone])] = FollowedSources(places[sources], learned)
            budget -= int(reach[ends.coming[zone]].sum()) + len(places) * ends.bins.size


def candidates_of_pairs(
    candidates: Candidates,
    pairs: Rows,
    departures: Departures,
    arrivals: Arrivals,
    bins: LagBins,
    zones: int,
) -> Candidates:
    """Return all candidates of the given pairs of zones, probable or not, to judge links by.

    Screened candidates are biased: those that remain of a pair have the lag that was looked for,
    whether there is a link or not. Beyond `JUDGED_MAX` candidates, all those of the arrivals with
    the fewest departures in reach are returned.

    candidates: the screened candidates, whose numbering of pairs is kept.
    pairs: indices of the pairs.
    """
    # Group events by zone, and pairs by zone of arrival.
    leaving, coming = rows_by_group(departures.zone, zones), rows_by_group(arrivals.zone, zones)
    pairs_to = {
        zone: pairs[rows]
        for zone, rows in enumerate(rows_by_group(candidates.target[pairs], zones))
        if len(rows)
    }

    # Count the departures in reach of each arrival; beyond the limit, the arrivals with the fewest
    # are kept.
    reach = np.zeros(len(arrivals.t), np.intp)
    for zone, here in pairs_to.items():
        left = [departures.t[leaving[source]] for source in candidates.source[here]]
        reach[coming[zone]] = _reach(left, arrivals.t[coming[zone]], bins)
    clear = arrivals_within(reach, JUDGED_MAX)

    # List the candidates of one zone of arrival at a time.
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

    # Order by arrival. Each part has its own arrivals, ordered by arrival and departure.
    lefts, cames, pairings, lags = zip(*parts, strict=True)
    arrival = np.concatenate(cames)
    order = np.argsort(arrival, kind="stable")
    return candidates._replace(
        departure=np.concatenate(lefts)[order],
        arrival=arrival[order],
        pair=np.concatenate(pairings)[order],
        lag=np.concatenate(lags)[order],
    )


def negative_without_overlap(
    candidates: Candidates,
    departures: Departures,
    arrivals: Arrivals,
    responsibility: Singles,
    overlapping: Bools,
) -> NDArray[np.bool_]:
    """Return a mask (M,) of candidates with a negative lag between views that do not overlap.

    Two views overlap if the search for overlapping views found that they do, or if the candidates
    with a negative lag, over all their zones and in both directions, have more evidence than the
    null model gives any pair of cameras with probability `OVERLAP_FALSE`.

    responsibility (M,): of each candidate.
    overlapping (cameras, cameras): True where the search found an overlap.
    """
    # Number the pairs of cameras among the candidates with a negative lag.
    cameras = len(overlapping)
    c = candidates
    ahead = np.flatnonzero(c.lag < 0)
    left, came = departures.camera[c.departure[ahead]], arrivals.camera[c.arrival[ahead]]
    views = np.minimum(left, came).astype(np.int64) * cameras + np.maximum(left, came)
    present, pair = np.unique(views, return_inverse=True)

    # Responsibility of each arrival, added up over its candidates from one camera.
    key, number = np.unique(c.arrival[ahead].astype(np.int64) * cameras + left, return_inverse=True)
    share = np.minimum(
        np.bincount(number, responsibility[ahead], minlength=len(key)), RESPONSIBILITY_MAX
    )

    # Evidence of each pair of cameras, against a Bonferroni threshold over all pairs.
    of_key = np.zeros(len(key), np.int64)
    of_key[number] = pair
    nats = np.bincount(of_key, -np.log1p(-share) - share, minlength=len(present))
    seen = nats >= np.log(max(cameras * (cameras - 1) / 2, 1.0) / OVERLAP_FALSE)
    seen |= (overlapping | overlapping.T)[present // cameras, present % cameras]

    result = np.zeros(len(c.lag), bool)
    result[ahead] = ~seen[pair]
    return result


def place(camera: int, number: int) -> int:
    """Return a key of a zone that stays the same from one fit to the next.

    camera: index of the camera.
    number: number of the zone there.
    """
    return camera << 32 | number


def screen_input(
    departures: Departures, arrivals: Arrivals, bins: LagBins, zones: int, until: float
) -> ScreenInput:
    """Prepare the departures and arrivals of a window that ends at ``until`` (seconds)."""
    return ScreenInput(
        departures,
        arrivals,
        rows_by_group(departures.zone, zones),
        rows_by_group(arrivals.zone, zones),
        exposures(departures, bins, zones, until),
        NullRates(departures.t, departures.zone, arrivals.t, arrivals.zone, zones),
        bins,
    )


def find_sources(ends: ScreenInput, zone: int, pairs_max: int = ZONE_PAIRS_MAX) -> Rows:
    """Return the zones whose departures the arrivals at ``zone`` follow most clearly, ascending.

    They are at most `SOURCES_PER_ZONE_MAX`, and at most the zone's share of ``pairs_max``, the
    pairs that all zones may follow together.
    """
    above = excess_by_source(ends, zone)
    best = np.argsort(-above, kind="stable")[: min(SOURCES_PER_ZONE_MAX, pairs_max // len(above))]
    return np.sort(best[above[best] > STANDS_OUT_SD])


def excess_by_source(ends: ScreenInput, zone: int) -> Floats:
    """Return how far the lag histogram of each zone of departure exceeds the null model.

    Returns standard deviations at the lag with the largest excess, (zones,); -inf where too few
    candidates were seen.

    zone: the zone of arrival.
    """
    zones, bins = len(ends.leaving), ends.bins
    seen = np.zeros(zones * bins.size)
    every = ends.coming[zone]
    low, high = departures_in_reach(ends.departures.t, ends.arrivals.t[every], bins)

    # Beyond the limit, count the candidates of every second arrival only, or every third, and so
    # on.
    most = ZONE_SCREEN_PAIRS_PER_EVENT_MAX * (len(ends.departures.t) + len(ends.arrivals.t))
    mine = every[:: -(-int((high - low).sum()) // most) or 1]

    # Histograms of the lags, by zone of departure.
    for departure, _, lag in possible(
        ends.departures, ends.arrivals, bins, mine, at_once=COUNTED_AT_ONCE
    ):
        cell = ends.departures.zone[departure].astype(np.int64) * bins.size + bins.index(lag)
        seen += np.bincount(cell, minlength=len(seen))

    # Compare those with enough candidates with the null model, thinned like the arrivals.
    counts = seen.reshape(zones, bins.size)
    some = np.flatnonzero(counts.sum(axis=1) >= SEEN_MIN)
    rate = ends.chance.rates_of(some, np.full(len(some), zone)) * (len(mine) / max(len(every), 1))
    usual = rate[:, None] * ends.exposure[some] * bins.widths
    result = np.full(zones, -np.inf)
    result[some] = _above(counts[some], usual, bins)
    return result


def _above(seen: Floats, chance: Floats, bins: LagBins) -> Floats:
    """Return the largest excess of each lag histogram over the null model, in sd, (P,).

    seen, chance (P, bins): observed counts, and those expected under the null model.
    """
    most = np.zeros(len(seen))
    for sd_bins in EXCESS_SMOOTHING_SD_BINS:
        spread = lag_smoothing_matrix(bins.size, sd_bins)
        noise = np.sqrt(np.maximum(chance, 0.5) @ (spread**2).T)
        most = np.maximum(most, (((seen - chance) @ spread.T) / noise).max(axis=1))
    return most


def _reach(left: list[Floats], came: Floats, bins: LagBins) -> Rows:
    """Return the number of departures in reach of each arrival.

    left: times of the departures of each of several zones, seconds, ascending.
    came (n,): times of the arrivals, seconds.
    """
    reach = np.zeros(len(came), np.intp)
    for times in left:
        low, high = departures_in_reach(times, came, bins)
        reach += high - low
    return reach


def _among(leaving: list[Rows], sources: Longs | Ints) -> Rows:
    """Return the rows of the departures of several zones, ascending."""
    return np.sort(np.concatenate([leaving[source] for source in sources]), kind="stable")


def _likely(ends: ScreenInput, zone: int, sources: Longs, mine: Rows) -> Part:
    """Return the probable candidates of some arrivals at one zone.

    sources: the zones of departure that are followed, ascending.
    mine: the arrivals, as indices.
    """
    bins = ends.bins
    among = _among(ends.leaving, sources)
    number = np.zeros(len(ends.leaving), np.int64)
    number[sources] = np.arange(len(sources))

    # List the candidates. Of each, only departure, index into ``mine``, cell (source and lag bin)
    # and lag are kept.
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

    # Initial hazards (sources, bins): the excess over the null model.
    size = len(sources) * bins.size
    exposed = ends.exposure[sources] * bins.widths
    usual = ends.chance.rates_of(sources, np.full(len(sources), zone))[:, None] * exposed
    seen = np.bincount(cell, minlength=size).reshape(-1, bins.size).astype(float)
    hazard = np.maximum(
        excess_over_null(seen, usual, bins, NOISE_SD), START_FLOOR * seen
    ) / np.maximum(exposed, bins.widths)

    # A few rounds of EM. E step: share each arrival among its candidates and the outside, and each
    # departure among at most one arrival. M step: count, smooth, divide by exposure.
    outside, share = OUTSIDE_FIRST * ends.arrivals.rate[mine], np.zeros(0)
    for _ in range(ROUNDS):
        weight = hazard.ravel()[cell]
        share = weight / (outside + np.bincount(at, weight, minlength=len(mine)))[at]
        once = share / np.maximum(np.bincount(departure, share), 1.0)[departure]
        moved = np.bincount(cell, once, minlength=size).reshape(-1, bins.size).astype(float)
        hazard = smooth(moved)[0] / (np.maximum(ends.exposure[sources], 1.0) * bins.widths)

    # Drop improbable candidates.
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
    """Return the likeliest candidates of all parts, ordered by arrival."""
    most = max(LIKELY_MAX, LIKELY_PER_ARRIVAL * len(arrivals.t))

    # Collect the parts, reduced to the likeliest now and then to limit memory.
    held: list[Part] = []
    n = 0
    for part in parts:
        held.append(part)
        n += len(part[0])
        if n > 2 * most:  # a candidate that is not among the likeliest now cannot be later
            held = [_likeliest(held, most, most + most // 2)]
            n = len(held[0][0])

    # Order by arrival. Each part has its own arrivals, ordered by arrival and departure.
    departure, arrival, lag, _ = _likeliest(held, most, most)
    order = np.argsort(arrival, kind="stable")
    departure, arrival, lag = departure[order], arrival[order], lag[order]
    pair, source, target = number_pairs(departures.zone[departure], arrivals.zone[arrival], zones)
    return Candidates(departure, arrival, pair, lag, source, target)


def _likeliest(parts: list[Part], most: int, room: int) -> Part:
    """Return the ``most`` likeliest candidates, and those as likely as the last up to ``room``."""
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
