"""Table of links: the figures of every pair of zones, and the rules for publishing them.

The joint fit gives the responsibility of each departure and arrival. From those, transit times,
evidence, Monte Carlo observations and the thesis's tests are computed pair by pair.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Ints, row_slices
from camtopod.learn.association import Fit, exposures
from camtopod.learn.links import mahalanobis, monte_carlo
from camtopod.learn.links.significance import log_likelihood_ratio, q_values
from camtopod.learn.links.transit_time import MEDIAN_ERROR, TransitFigures, transit_figures
from camtopod.learn.settings import Settings
from camtopod.learn.traffic import Arrivals, Departures, mean_slowness
from camtopod.topology import LagBins, smooth

TRANSITIONS_MIN = 2.0
"""Least expected transitions of a published link."""
WEAK_TRANSITIONS_MIN = 0.2
"""Least expected transitions of a weak link."""
WEAK_LINKS_PER_ZONE_MAX = 24
"""Largest number of weak links from one zone."""
LEFT_OVER_MIN = 0.05
"""Least share of a source that published links leave over in the posterior: no division by 0."""
MONTE_CARLO_SEED = 2011
"""Seed of the Monte Carlo observations, fixed so that versions are reproducible."""


class Transitions(NamedTuple):
    """Departures and arrivals that may be of one object, (M,) each."""

    source: Ints
    """Zone of departure."""
    target: Ints
    """Zone of arrival."""
    lag: Floats
    """Seconds from departure to arrival."""
    weight: Floats
    """Responsibility."""
    flat: Floats
    """Hazard of a link of the same size without a transit time, over the hazard at the lag."""


def concatenate_transitions(parts: list[Transitions]) -> Transitions:
    """Return several tables of transitions as one."""
    none = Transitions(
        np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0), np.zeros(0), np.zeros(0)
    )
    return Transitions(*(np.concatenate(columns) for columns in zip(none, *parts, strict=True)))


def transitions_of(fit: Fit, least: float = 0.0) -> Transitions:
    """Return the candidates of a joint fit as transitions.

    least: pairs of zones with fewer expected transitions are left out.
    """
    c = fit.candidates
    enough = np.bincount(c.pair, fit.responsibility, minlength=len(c.source)) >= least
    rows = np.flatnonzero(enough[c.pair])
    pair, lag = c.pair[rows], c.lag[rows].astype(float)
    return Transitions(
        c.source[pair], c.target[pair], lag, fit.responsibility[rows], fit.flat[rows]
    )


def exposed_departures(departures: Departures, bins: LagBins, zones: int, until: float) -> Floats:
    """Return the departures of each zone that could have been seen to arrive: (zones, bins).

    For lags before the exit these are all departures. Objects that have just left may still be
    under way, and do not count for longer lags.

    until (seconds): end of the window.
    """
    every = np.bincount(departures.zone, minlength=zones)[:, None]
    return np.where(bins.edges[1:] > 0, exposures(departures, bins, zones, until), every)


class TransitionSlowness(NamedTuple):
    """Slowness of the objects behind transitions."""

    slow: Floats
    """(M,) slowness (natural log), as far as it affects lags; nan if unknown."""
    left: Floats
    """(zones,) standard error of the usual log dwell time before exits there, scaled likewise."""
    came: Floats
    """(zones,) standard error of the usual log dwell time after entries there, scaled likewise."""


def transition_slowness(
    fit: Fit, departures: Departures, arrivals: Arrivals, zones: int
) -> TransitionSlowness | None:
    """Return the slowness behind the candidates of a joint fit; None if it does not affect lags."""
    scaling, _, sd = fit.persistence
    if scaling <= 0:
        return None

    # Slowness of each candidate, scaled to its effect on lags.
    c = fit.candidates
    slow = scaling * mean_slowness(departures.slow[c.departure], arrivals.slow[c.arrival])

    # Standard error of a median, from the number of events with a known slowness.
    number = (
        np.bincount(ends.zone[np.isfinite(ends.slow)], minlength=zones)
        for ends in (departures, arrivals)
    )
    left, came = (scaling * MEDIAN_ERROR * sd / np.sqrt(np.maximum(n, 1)) for n in number)
    return TransitionSlowness(slow, left, came)


class LinkTable(NamedTuple):
    """Figures of P pairs of zones, (P,) each."""

    source: Ints
    """Zone of departure."""
    target: Ints
    """Zone of arrival."""
    probability: Floats
    """Share of the departures at ``source`` that appear next at ``target``."""
    ratio: Floats
    """Evidence, nats."""
    q: Floats
    """False discovery rate at which the pair would be published."""
    transit: TransitFigures
    """Transit times."""
    variance: Floats
    """The thesis's Var(d) (table 4.3)."""
    counts: Floats
    """(P, bins) expected transitions per lag bin."""
    delay: Floats
    """Seconds to add to the lags of ``counts`` on long paths (see `camtopod.learn.long_paths`)."""

    def rows(self, keep: NDArray[np.intp]) -> LinkTable:
        """Return the given rows, in that order."""
        return LinkTable(
            self.source[keep],
            self.target[keep],
            self.probability[keep],
            self.ratio[keep],
            self.q[keep],
            TransitFigures(*(column[keep] for column in self.transit)),
            self.variance[keep],
            self.counts[keep],
            self.delay[keep],
        )

    def without_counts(self) -> LinkTable:
        """Return the table without the transitions per lag bin, which take most of the memory."""
        return self._replace(counts=np.zeros((len(self.source), 0)))

    def with_evidence(self, ratio: Floats, tests: int) -> LinkTable:
        """Return the table with other evidence and the false discovery rates that follow from it.

        ratio (P,): evidence, nats.
        tests: number of pairs of zones that were tested.
        """
        return self._replace(ratio=ratio, q=q_values(ratio, tests))


def tabulate(
    transitions: Transitions,
    left: Floats,
    bins: LagBins,
    zones: int,
    pace: TransitionSlowness | None = None,
    delay: Floats | None = None,
) -> LinkTable:
    """Return the figures of every pair of zones that has a transition.

    left (zones, bins): departures that could have been seen to arrive after each lag; (zones, 1) if
        that does not depend on the lag.
    pace: slowness behind the transitions.
    delay (zones,): seconds that transit times from a zone are longer than lags.
    """
    # Number the pairs of zones that occur.
    key = transitions.source.astype(np.int64) * zones + transitions.target
    present, pair = np.unique(key, return_inverse=True)
    pair = pair.astype(np.int32)
    pairs = len(present)
    source, target = (
        (present // max(zones, 1)).astype(np.int32),
        (present % max(zones, 1)).astype(np.int32),
    )

    # Expected transitions per lag bin, and their smoothed density per second.
    at = bins.index(transitions.lag)
    inside = at >= 0
    flat = np.bincount(
        pair[inside].astype(np.int64) * bins.size + at[inside],
        transitions.weight[inside],
        minlength=pairs * bins.size,
    )
    counts: Floats = flat.astype(float, copy=False).reshape(pairs, bins.size)
    density = smooth(counts)[0]
    density /= bins.widths

    # Transit times, corrected for slowness and delay.
    slow, error = (
        (None, None)
        if pace is None
        else (pace.slow, 0.5 * np.hypot(pace.left[source], pace.came[target]))
    )
    later = np.zeros(pairs) if delay is None else delay[source]
    transit = transit_figures(
        pair, transitions.lag + later[pair], transitions.weight, density, bins, slow, error
    )
    transit = transit._replace(mode=transit.mode + later)

    # Evidence, Var(d) and transition probability.
    ratio = log_likelihood_ratio(pair, transitions.weight, transitions.flat, pairs)
    variance = np.nan_to_num(transit.sd) ** 2 / mahalanobis.null_variance(
        bins.lag_min, bins.lag_max
    )
    probability = np.zeros(pairs)
    for rows in row_slices(pairs):
        probability[rows] = np.minimum(
            (counts[rows] / np.maximum(left[source[rows]], 1.0)).sum(axis=1), 1.0
        )
    return LinkTable(
        source,
        target,
        probability,
        ratio,
        q_values(ratio, pairs),
        transit,
        variance,
        counts,
        later,
    )


def with_monte_carlo_variance(table: LinkTable, bins: LagBins) -> LinkTable:
    """Return the table with ``Var(d)`` computed from Monte Carlo observations (thesis 4.3).

    They take the place of the observed transit times, which are few.
    """
    density = smooth(table.counts)[0] / bins.widths
    samples = monte_carlo.observe(density, np.nan_to_num(table.transit.sd), bins, MONTE_CARLO_SEED)
    chance = mahalanobis.null_variance(bins.lag_min, bins.lag_max)
    return table._replace(variance=mahalanobis.distance_variance(samples, chance))


def significant(table: LinkTable, settings: Settings) -> NDArray[np.bool_]:
    """Return a mask (P,) of the pairs that meet the rule for publishing."""
    return (
        (table.q <= settings.publish_q_max)
        & (table.probability >= settings.publish_probability_min)
        & (table.transit.total >= TRANSITIONS_MIN)
        & (table.variance <= mahalanobis.LINKED_VARIANCE_MAX)
    )


def zone_pairs_of(table: LinkTable) -> set[tuple[int, int]]:
    """Return the pairs of zones of the table."""
    return set(zip(table.source.tolist(), table.target.tolist(), strict=True))


def select_weak_links(likely: LinkTable, published: LinkTable, zones: int) -> LinkTable:
    """Return the weak links: unpublished pairs of the posterior, the likeliest of each source.

    The share of a source that published links leave over is divided among its weak links and
    leaving the site, in the proportions of the posterior.

    likely: table of the posterior.
    """
    # Scale the posterior of each source to what its published links leave over.
    key, done = (
        table.source.astype(np.int64) * zones + table.target for table in (likely, published)
    )
    known = np.isin(key, done)
    taken = np.bincount(published.source, published.probability, minlength=zones)
    before = np.bincount(likely.source[known], likely.probability[known], minlength=zones)
    scale = np.maximum(1.0 - taken, 0.0) / np.maximum(1.0 - before, LEFT_OVER_MIN)
    likely = likely._replace(probability=np.minimum(likely.probability * scale[likely.source], 1.0))

    # Order the unpublished pairs by source and probability, and keep the first of each source.
    rows = np.flatnonzero(~known & (likely.transit.total >= WEAK_TRANSITIONS_MIN))
    rows = rows[np.lexsort((likely.target[rows], -likely.probability[rows], likely.source[rows]))]
    source = likely.source[rows]
    starts = np.concatenate(([True], source[1:] != source[:-1])) if len(rows) else np.zeros(0, bool)
    rank = np.arange(len(rows)) - np.maximum.accumulate(np.where(starts, np.arange(len(rows)), 0))
    return likely.rows(rows[rank < WEAK_LINKS_PER_ZONE_MAX])
