"""Screening: select the candidates for the joint fit on sites with too many candidates for one fit.

On a large site two cheaper steps go before the joint fit (`CandidateScreen.find`):

* *Looks, now and then.* A look at a zone of arrival compares the lag histogram from every zone of
  departure with the null model (Makris, Ellis and Black 2004). The zones of departure that stand
  out most are *followed* until the next look. Each fit looks at as many zones of arrival as its
  number of events allows, those with the oldest look first.
* *Weighing, in every fit.* Candidates along the followed pairs of zones are weighed by a few rounds
  of EM within one zone of arrival. Improbable candidates are dropped.
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
    listed,
    number_pairs,
)
from camtopod.learn.association.em import START_FLOOR
from camtopod.learn.association.exposure import exposures
from camtopod.learn.association.problem import Problem
from camtopod.learn.limits import (
    JUDGED_MAX,
    WEIGHED_AT_ONCE,
    WEIGHED_MAX,
    ZONE_PAIRS_MAX,
    ZONE_PAIRS_PER_CAMERA_MAX,
    ZONE_SCREEN_PAIRS_PER_EVENT_MAX,
    arrivals_within,
)
from camtopod.learn.traffic import NullRates
from camtopod.topology import LagBins, lag_smoothing_matrix, smooth

Part = tuple[Ints, Ints, Singles, Singles]
"""Part of the candidates, as columns (n,): row of the departure, row of the arrival, lag in
seconds, probability.
"""

PAIRS_FEW = 20_000
"""Number of pairs of zones up to which candidates are not screened, unless they are too many."""
SOURCES_PER_ZONE_MAX = 32
"""Largest number of zones of departure that are followed for one zone of arrival."""
SEEN_MIN = 3
"""Least number of candidates, in a look, of a pair of zones that is followed."""
STANDS_OUT_SD = 2.0
"""Least excess over the null model, in standard deviations, of a pair of zones that is followed."""
WIDE_BINS = 4
"""Lag bins that are taken together for a first look, which tells which zones of departure to look
at more closely.
"""
CLOSER_LOOKS = 16
"""Zones of departure that are looked at closely for each that may be followed."""
LOOKS_PER_EVENT = 400
"""Budget of a fit for looks, per event of the window. The unit is a candidate counted or a cell of
a histogram. `ZONE_SCREEN_PAIRS_PER_EVENT_MAX` limits a single look.
"""
LOOKS_MIN = 20_000_000
"""Least budget of a fit for looks, in the unit of `LOOKS_PER_EVENT`; takes about a second."""
ROUNDS = 2
"""Rounds of EM within one zone of arrival, when candidates are weighed."""
NOISE_SD = 0.5
"""Standard deviations of the null model subtracted from lag histograms for the first hazards, when
candidates are weighed.
"""
OUTSIDE_FIRST = 0.5
"""Share of the arrivals that come from outside; it is not estimated when candidates are weighed."""
OVERLAP_FALSE = 0.05
"""Probability that `negative_without_overlap` finds any overlap on a site without overlaps."""
LIKELY_MIN = 0.001
"""Probability, after weighing, up to which candidates are dropped."""
LIKELY_MAX = 3_000_000
LIKELY_PER_ARRIVAL = 8
"""Limits of the candidates kept for the joint fit, the likeliest: in all, or for each arrival if
that is more.
"""

_NO_ROWS = np.zeros(0, np.int32)


class FollowedSources(Struct):
    """The zones of departure that are followed as sources of one zone of arrival."""

    sources: Longs
    """Keys (`place`) of these zones of departure."""
    looked: int
    """Number of events learned at the last look at the zone of arrival; -1 if there was none."""


class ScreenInput(NamedTuple):
    """A problem, prepared for looks and weighing (`screen_input`)."""

    problem: Problem
    leaving: list[Rows]
    """(zones,) rows of the departures from each zone."""
    coming: list[Rows]
    """(zones,) rows of the arrivals at each zone."""
    exposure: Floats
    """(zones, bins) exposed departures."""
    exposed_wide: Floats
    """(zones, wide bins) exposed departures times seconds, in wide bins (`WIDE_BINS`)."""
    chance: NullRates
    """Rates of arrivals under the null model."""


class CandidateScreen:
    """Selects the candidates of each fit, and remembers which pairs of zones are followed.

    On a small site, `find` returns all candidates, and no pair is remembered.
    """

    def __init__(self) -> None:
        self.followed: dict[int, FollowedSources] = {}
        """Zones of departure that are followed, by key (`place`) of the zone of arrival."""

    @staticmethod
    def is_needed(problem: Problem, candidates_max: int) -> bool:
        """Return True if there are too many candidates or pairs of zones for one fit.

        candidates_max: limit of the candidates; that of the pairs is `PAIRS_FEW`.
        """
        low, high = departures_in_reach(problem.departures.t, problem.arrivals.t, problem.bins)
        return int((high - low).sum()) > candidates_max or problem.zones**2 > PAIRS_FEW

    def find(
        self,
        problem: Problem,
        places: Longs,
        learned: int,
        candidates_max: int,
        everywhere: bool = False,
    ) -> Candidates:
        """Return the candidates of a window, screened if there are too many.

        places (zones,): key of each zone that stays the same from fit to fit (`place`).
        learned: number of events learned so far.
        candidates_max: number of candidates up to which all are returned.
        everywhere: True to look at every zone of arrival now, as there is no later fit.
        """
        if not self.is_needed(problem, candidates_max):
            self.followed = {}
            return find_candidates(problem)

        # Look at the zones whose turn it is.
        departures, arrivals, bins, *_ = problem
        low, high = departures_in_reach(departures.t, arrivals.t, bins)
        ends = screen_input(problem)
        self._look(ends, places, learned, high - low, everywhere)
        sources_of = self._sources(places)

        # Count the departures in reach of each arrival; beyond the limit, the arrivals with the
        # fewest are kept.
        reach = np.zeros(len(arrivals.t), np.intp)
        departure_times = [departures.t[rows] for rows in ends.leaving]
        for zone, sources in sources_of.items():
            arrival_rows = ends.coming[zone]
            reach[arrival_rows] = _reach(
                [departure_times[source] for source in sources], arrivals.t[arrival_rows], bins
            )
        kept = arrivals_within(reach, WEIGHED_MAX)

        # Weigh the candidates of one zone of arrival at a time, in blocks.
        def parts() -> Iterator[Part]:
            for zone, sources in sources_of.items():
                arrival_rows = ends.coming[zone][kept[ends.coming[zone]]]
                block = (np.cumsum(reach[arrival_rows]) - 1) // WEIGHED_AT_ONCE
                for arrivals_of_block in np.split(arrival_rows, np.flatnonzero(np.diff(block)) + 1):
                    if len(arrivals_of_block):
                        yield _likely(ends, zone, sources, arrivals_of_block)

        return _joined(parts(), problem)

    def _sources(self, places: Longs) -> dict[int, Longs]:
        """Return, by zone of arrival, the zones of departure that are followed, ascending.

        places (zones,): key of each zone (`place`). Zones without any source are left out.
        """
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
        """Look at the zones of arrival with the oldest looks, as far as the budget goes.

        Zones that exist no more are forgotten.

        reach (m,): number of departures within the lags of each arrival, the cost of looking at it.
        """
        never = FollowedSources(np.zeros(0, np.int64), -1)
        self.followed = {place: self.followed.get(place, never) for place in places.tolist()}

        cameras = len(np.unique(places >> 32))
        pairs_max = max(ZONE_PAIRS_MAX, ZONE_PAIRS_PER_CAMERA_MAX * cameras)
        departures, arrivals, bins, *_ = ends.problem
        budget = max(LOOKS_MIN, LOOKS_PER_EVENT * (len(departures.t) + len(arrivals.t)))
        for zone in sorted(
            range(len(places)), key=lambda zone: self.followed[int(places[zone])].looked
        ):
            if budget <= 0 and not everywhere:
                break
            sources = find_sources(ends, zone, pairs_max)
            self.followed[int(places[zone])] = FollowedSources(places[sources], learned)
            budget -= int(reach[ends.coming[zone]].sum()) + len(places) * bins.size


def candidates_of_pairs(problem: Problem, candidates: Candidates, pairs: Rows) -> Candidates:
    """Return all candidates of the given pairs of zones, probable or not, as evidence for links.

    Screened candidates are biased as evidence: those that remain of a pair have similar lags,
    whether there is a link or not. Beyond `JUDGED_MAX` candidates, those of the arrivals with the
    fewest departures in reach are returned.

    candidates: the screened candidates, whose numbering of pairs is kept.
    pairs (k,): numbers of the pairs.
    """
    departures, arrivals, bins, zones, *_ = problem

    # Group events by zone, and pairs by zone of arrival.
    leaving = rows_by_group(departures.zone, zones)
    coming = rows_by_group(arrivals.zone, zones)
    pairs_to = {
        zone: pairs[rows]
        for zone, rows in enumerate(rows_by_group(candidates.target[pairs], zones))
        if len(rows)
    }

    # Count the departures in reach of each arrival; beyond the limit, the arrivals with the fewest
    # are kept.
    reach = np.zeros(len(arrivals.t), np.intp)
    for zone, pairs_here in pairs_to.items():
        departure_times = [
            departures.t[leaving[source]] for source in candidates.source[pairs_here]
        ]
        reach[coming[zone]] = _reach(departure_times, arrivals.t[coming[zone]], bins)
    clear = arrivals_within(reach, JUDGED_MAX)

    # List the candidates of one zone of arrival at a time.
    parts = [(_NO_ROWS, _NO_ROWS, _NO_ROWS, np.zeros(0, np.float32))]
    for zone, pairs_here in pairs_to.items():
        number = np.full(zones, -1, np.int32)
        number[candidates.source[pairs_here]] = pairs_here
        departure_rows = _among(leaving, candidates.source[pairs_here])
        arrival_rows = coming[zone][clear[coming[zone]]]
        departure, at, lag = listed(problem, arrival_rows, departure_rows)
        pair = number[departures.zone[departure]]
        arrival = arrival_rows[at].astype(np.int32)
        parts.append((departure, arrival, pair, lag.astype(np.float32)))

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
    problem: Problem,
    candidates: Candidates,
    responsibility: Singles,
    overlapping: Bools,
) -> NDArray[np.bool_]:
    """Return a mask (M,) of candidates with a negative lag between views that do not overlap.

    Such candidates are impossible: an object does not appear in the next view before it leaves the
    first one. Two views are taken to overlap if the search for overlapping views has found it, or
    if the candidates with a negative lag, over all zones of the two and in both directions, have
    more evidence than the null model gives any pair of cameras with probability `OVERLAP_FALSE`.

    responsibility (M,): probability that the candidate is of one object.
    overlapping (cameras, cameras): True where the search found an overlap.
    """
    # Number the pairs of cameras among the candidates with a negative lag.
    cameras = len(overlapping)
    c = candidates
    ahead = np.flatnonzero(c.lag < 0)
    camera_left = problem.departures.camera[c.departure[ahead]]
    camera_reached = problem.arrivals.camera[c.arrival[ahead]]
    views = np.minimum(camera_left, camera_reached).astype(np.int64) * cameras + np.maximum(
        camera_left, camera_reached
    )
    present, pair = np.unique(views, return_inverse=True)

    # Responsibility of each arrival, added up over its candidates from one camera.
    key, number = np.unique(
        c.arrival[ahead].astype(np.int64) * cameras + camera_left, return_inverse=True
    )
    arrival_share = np.minimum(
        np.bincount(number, responsibility[ahead], minlength=len(key)), RESPONSIBILITY_MAX
    )

    # Evidence of each pair of cameras, against a Bonferroni threshold over all pairs.
    of_key = np.zeros(len(key), np.int64)
    of_key[number] = pair
    nats = np.bincount(of_key, -np.log1p(-arrival_share) - arrival_share, minlength=len(present))
    overlaps = nats >= np.log(max(cameras * (cameras - 1) / 2, 1.0) / OVERLAP_FALSE)
    overlaps |= (overlapping | overlapping.T)[present // cameras, present % cameras]

    result = np.zeros(len(c.lag), bool)
    result[ahead] = ~overlaps[pair]
    return result


def place(camera: int, number: int) -> int:
    """Return the key of a zone, which stays the same from one fit to the next.

    camera: index of the camera.
    number: number of the zone among the camera's zones.
    """
    return camera << 32 | number


def screen_input(problem: Problem) -> ScreenInput:
    """Prepare a problem for looks and weighing."""
    departures, arrivals, bins, zones, *_ = problem
    exposure = exposures(problem)
    wide = np.arange(0, bins.size, WIDE_BINS)
    return ScreenInput(
        problem,
        rows_by_group(departures.zone, zones),
        rows_by_group(arrivals.zone, zones),
        exposure,
        np.add.reduceat(exposure * bins.widths, wide, axis=1),
        NullRates(departures.t, departures.zone, arrivals.t, arrivals.zone, zones),
    )


def find_sources(ends: ScreenInput, zone: int, pairs_max: int = ZONE_PAIRS_MAX) -> Rows:
    """Look at a zone of arrival: return the zones of departure that stand out most, ascending.

    ends: departures and arrivals of the window.
    zone: the zone of arrival.
    pairs_max: largest number of pairs of zones that are followed on the whole site. The result has
        at most an equal share of it, and at most `SOURCES_PER_ZONE_MAX` zones.
    """
    above = excess_by_source(ends, zone)
    best = np.argsort(-above, kind="stable")[: min(SOURCES_PER_ZONE_MAX, pairs_max // len(above))]
    return np.sort(best[above[best] > STANDS_OUT_SD])


def excess_by_source(ends: ScreenInput, zone: int) -> Floats:
    """Return by how much the lag histogram from each zone to one zone exceeds the null model.

    ends: departures and arrivals of the window.
    zone: the zone of arrival.

    The result (zones,) is by zone of departure, in standard deviations of the null model at the lag
    with the largest excess; -inf where there are fewer than `SEEN_MIN` candidates.
    """
    departures, arrivals, bins, zones, *_ = ends.problem
    arrival_rows = ends.coming[zone]
    low, high = departures_in_reach(departures.t, arrivals.t[arrival_rows], bins)

    # Beyond the limit, count the candidates of every second arrival only, or every third, and so
    # on.
    most = ZONE_SCREEN_PAIRS_PER_EVENT_MAX * (len(departures.t) + len(arrivals.t))
    thinned = slice(None, None, -(-int((high - low).sum()) // most) or 1)
    counts = _lag_histograms(ends, arrival_rows[thinned])

    # Expected candidates under the null model, thinned like the arrivals.
    enough = np.flatnonzero(counts.sum(axis=1) >= SEEN_MIN)
    share = len(arrival_rows[thinned]) / max(len(arrival_rows), 1)
    rate = share * ends.chance.rates_of(enough, np.full(len(enough), zone))[:, None]

    # Compare the histograms in wide bins first; those that exceed the null model most, in lag bins.
    wide = np.arange(0, bins.size, WIDE_BINS)
    observed = np.add.reduceat(counts[enough], wide, axis=1)
    expected = rate * ends.exposed_wide[enough]
    roughly = ((observed - expected) / np.sqrt(np.maximum(expected, 0.5))).max(axis=1, initial=0.0)
    best = np.argsort(-roughly, kind="stable")[: CLOSER_LOOKS * SOURCES_PER_ZONE_MAX]
    closer = enough[best]
    result = np.full(zones, -np.inf)
    usual = rate[best] * ends.exposure[closer] * bins.widths
    result[closer] = _above(counts[closer], usual, bins)
    return result


def _lag_histograms(ends: ScreenInput, arrival_rows: Rows) -> Floats:
    """Return the lag histograms (zones, bins) of the candidates of arrivals, by zone of departure.

    arrival_rows: rows of arrivals at one zone.

    The departures with lags of one bin are a range of rows, so hardly any lag is computed.
    """
    departures, arrivals, bins, zones, *_ = ends.problem
    first_cell = departures.zone.astype(np.intp) * bins.size
    arrived = arrivals.t[arrival_rows]
    low, high = departures_in_reach(departures.t, arrived, bins)

    # Lags after the exit: the departures of each bin, from the longest lag to the shortest.
    after = np.flatnonzero(bins.edges[:-1] >= 0)[::-1]
    ends_at = np.searchsorted(departures.t, arrived[:, None] - bins.edges[after], side="right")
    ends_at[:, -1] = left = np.searchsorted(departures.t, arrived, side="left")
    times = np.diff(ends_at, axis=1, prepend=low[:, None])
    cell = np.repeat(np.tile(after, len(arrived)), times.ravel())
    cell += np.concatenate(
        [first_cell[:0], *(first_cell[a:b] for a, b in zip(low, left, strict=True))]
    )
    counts = np.bincount(cell, minlength=zones * bins.size)

    # Lags before the exit: only passages that had begun in the view of another camera.
    camera = arrivals.camera[arrival_rows]
    for here, t, a, b in zip(camera, arrived, left, high, strict=True):
        begun = (departures.since[a:b] <= t) & (departures.camera[a:b] != here)
        in_view = a + np.flatnonzero(begun)
        np.add.at(counts, first_cell[in_view] + bins.index(t - departures.t[in_view]), 1)
    return counts.reshape(zones, bins.size).astype(float)


def _above(observed: Floats, expected: Floats, bins: LagBins) -> Floats:
    """Return the largest excess of each lag histogram over the null model, in its sd, (P,).

    observed, expected (P, bins): observed counts, and expected counts under the null model.
    """
    most = np.zeros(len(observed))
    for sd_bins in EXCESS_SMOOTHING_SD_BINS:
        spread = lag_smoothing_matrix(bins.size, sd_bins)
        noise = np.sqrt(np.maximum(expected, 0.5) @ (spread**2).T)
        most = np.maximum(most, (((observed - expected) @ spread.T) / noise).max(axis=1))
    return most


def _reach(departure_times: list[Floats], arrival_times: Floats, bins: LagBins) -> Rows:
    """Return the number (n,) of departures within the lags of each of n arrivals.

    departure_times: times of the departures from each of several zones, seconds, ascending.
    arrival_times (n,): times of the arrivals, seconds.
    """
    reach = np.zeros(len(arrival_times), np.intp)
    for times in departure_times:
        low, high = departures_in_reach(times, arrival_times, bins)
        reach += high - low
    return reach


def _among(leaving: list[Rows], sources: Longs | Ints) -> Rows:
    """Return the rows of the departures from the zones ``sources``, ascending.

    leaving (zones,): rows of the departures from each zone.
    """
    return np.sort(np.concatenate([leaving[source] for source in sources]), kind="stable")


def _likely(ends: ScreenInput, zone: int, sources: Longs, arrival_rows: Rows) -> Part:
    """Weigh the candidates of some arrivals at one zone, and return the probable ones.

    zone: the zone of arrival.
    sources: the zones of departure that are followed, ascending.
    arrival_rows: rows of the arrivals.
    """
    departures, arrivals, bins, *_ = ends.problem
    departure_rows = _among(ends.leaving, sources)
    number = np.zeros(len(ends.leaving), np.int64)
    number[sources] = np.arange(len(sources))

    # List the candidates: departure, index of the arrival, lag, and cell (source and lag bin).
    departure, at, lag = listed(ends.problem, arrival_rows, departure_rows)
    cell = number[departures.zone[departure]] * bins.size + bins.index(lag)

    # Initial hazards (sources, bins): the excess over the null model.
    size = len(sources) * bins.size
    exposed = ends.exposure[sources] * bins.widths
    usual = ends.chance.rates_of(sources, np.full(len(sources), zone))[:, None] * exposed
    counts = np.bincount(cell, minlength=size).reshape(-1, bins.size).astype(float)
    hazard = np.maximum(
        excess_over_null(counts, usual, bins, NOISE_SD), START_FLOOR * counts
    ) / np.maximum(exposed, bins.widths)

    # A few rounds of EM. E step: share each arrival among its candidates and the outside, and each
    # departure among at most one arrival. M step: count, smooth, divide by exposure.
    outside = OUTSIDE_FIRST * arrivals.rate[arrival_rows]
    share = np.zeros(0)
    for _ in range(ROUNDS):
        weight = hazard.ravel()[cell]
        share = weight / (outside + np.bincount(at, weight, minlength=len(arrival_rows)))[at]
        once = share / np.maximum(np.bincount(departure, share), 1.0)[departure]
        moved = np.bincount(cell, once, minlength=size).reshape(-1, bins.size).astype(float)
        hazard = smooth(moved)[0] / (np.maximum(ends.exposure[sources], 1.0) * bins.widths)

    # Drop improbable candidates.
    kept = share > LIKELY_MIN
    return (
        departure[kept],
        arrival_rows[at[kept]].astype(np.int32),
        lag[kept].astype(np.float32),
        share[kept].astype(np.float32),
    )


def _joined(parts: Iterable[Part], problem: Problem) -> Candidates:
    """Return the likeliest candidates of all parts, ordered by arrival."""
    departures, arrivals, _, zones, *_ = problem
    most = max(LIKELY_MAX, LIKELY_PER_ARRIVAL * len(arrivals.t))

    # Collect the parts; now and then, reduce them to the likeliest candidates to limit memory.
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
    departure = departure[order]
    arrival = arrival[order]
    lag = lag[order]
    pair, source, target = number_pairs(departures.zone[departure], arrivals.zone[arrival], zones)
    return Candidates(departure, arrival, pair, lag, source, target)


def _likeliest(parts: list[Part], most: int, room: int) -> Part:
    """Return the ``most`` likeliest candidates of some parts.

    Candidates as likely as the last of them are returned, too, as long as there are at most
    ``room`` in all.
    """
    nothing = (_NO_ROWS, _NO_ROWS, np.zeros(0, np.float32), np.zeros(0, np.float32))
    departure, arrival, lag, share = (
        np.concatenate(column) for column in zip(nothing, *parts, strict=True)
    )
    if len(share) <= most:
        return departure, arrival, lag, share
    least = np.partition(share, len(share) - most)[len(share) - most]
    kept = np.flatnonzero(share >= least)[:room]
    return departure[kept], arrival[kept], lag[kept], share[kept]
