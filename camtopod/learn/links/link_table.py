"""Links between zones: every figure of every pair of zones, and which of them are published.

The joint fit says which departures and arrivals belong together; from those the transit times, the
Monte Carlo observations and the thesis's tests are taken, pair by pair.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Ints, rows_together
from camtopod.learn.association import Fit, exposures
from camtopod.learn.links import mahalanobis, monte_carlo
from camtopod.learn.links.significance import log_likelihood_ratio, q_values
from camtopod.learn.links.transit_time import MEDIAN_ERROR, TransitFigures, transit_figures
from camtopod.learn.settings import Settings
from camtopod.learn.traffic import Arrivals, Departures, combined
from camtopod.topology import LagBins, smooth

TRANSITIONS_MIN = 2.0
"""A published link rests on at least this many expected transitions."""
WEAK_TRANSITIONS_MIN = 0.2
"""A weak link has at least so many."""
WEAK_LINKS_PER_ZONE_MAX = 24
LEFT_OVER_MIN = 0.05
MONTE_CARLO_SEED = 2011


class Transitions(NamedTuple):
    """Joined departures and arrivals, (M,) each: zones, lag in seconds, the probability that they
    are one object, and the hazard over the lag's own of a link without a transit time.
    """

    source: Ints
    target: Ints
    lag: Floats
    weight: Floats
    flat: Floats


def join(parts: list[Transitions]) -> Transitions:
    """Several lists of transitions as one."""
    none = Transitions(
        np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0), np.zeros(0), np.zeros(0)
    )
    return Transitions(*(np.concatenate(columns) for columns in zip(none, *parts, strict=True)))


def transitions_of(fit: Fit, least: float = 0.0) -> Transitions:
    """The candidates of a joint fit, of pairs of zones with at least so many transitions."""
    c = fit.candidates
    enough = np.bincount(c.pair, fit.responsibility, minlength=len(c.source)) >= least
    rows = np.flatnonzero(enough[c.pair])
    pair, lag = c.pair[rows], c.lag[rows].astype(float)
    return Transitions(
        c.source[pair], c.target[pair], lag, fit.responsibility[rows], fit.flat[rows]
    )


def leaving(departures: Departures, bins: LagBins, zones: int, until: float) -> Floats:
    """Departures of each zone that would have been seen to arrive by ``until`` (seconds) if they
    took so long: (zones, bins). Who has just left may still be on the way, and says nothing yet of
    how many take it.
    """
    every = np.bincount(departures.zone, minlength=zones)[:, None]
    return np.where(bins.edges[1:] > 0, exposures(departures, bins, zones, until), every)


class Pace(NamedTuple):
    """How fast the objects of transitions were."""

    slow: Floats
    """(M,) by what power of e slower than usual, as far as that bears on lags; nan where
    unknown.
    """
    left: Floats
    """(zones,) standard error of what is usual among those that leave there."""
    came: Floats
    """(zones,) the same among those that come there."""


def pace_of(fit: Fit, departures: Departures, arrivals: Arrivals, zones: int) -> Pace | None:
    """Of the candidates of a joint fit; None where speeds tell nothing."""
    scaling, _, sd = fit.persistence
    if scaling <= 0:
        return None
    c = fit.candidates
    slow = scaling * combined(departures.slow[c.departure], arrivals.slow[c.arrival])
    number = (
        np.bincount(ends.zone[np.isfinite(ends.slow)], minlength=zones)
        for ends in (departures, arrivals)
    )
    left, came = (scaling * MEDIAN_ERROR * sd / np.sqrt(np.maximum(n, 1)) for n in number)
    return Pace(slow, left, came)


class LinkTable(NamedTuple):
    """Figures of P pairs of zones, (P,) each; ``counts`` are expected transitions per lag bin, (P,
    bins).
    """

    source: Ints
    target: Ints
    probability: Floats
    ratio: Floats
    q: Floats
    transit: TransitFigures
    variance: Floats
    counts: Floats
    delay: Floats
    """Seconds to add to the lags of ``counts`` (see `long_ways`)."""

    def rows(self, keep: NDArray[np.intp]) -> LinkTable:
        """The rows ``keep``, in that order."""
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
        """The same without the transitions per lag bin, which take most of the memory."""
        return self._replace(counts=np.zeros((len(self.source), 0)))

    def with_evidence(self, ratio: Floats, tests: int) -> LinkTable:
        """The same with evidence (P,) in nats from elsewhere, and the false discovery rates among
        ``tests`` pairs looked at.
        """
        return self._replace(ratio=ratio, q=q_values(ratio, tests))


def tabulate(
    transitions: Transitions,
    left: Floats,
    bins: LagBins,
    zones: int,
    pace: Pace | None = None,
    delay: Floats | None = None,
) -> LinkTable:
    """Figures of every pair of zones that has a transition. ``left`` (zones, bins): how many could
    have taken one and been seen to; (zones, 1) where that does not depend on the lag. ``delay``
    (zones,): seconds that transit times from a zone are longer than lags.
    """
    key = transitions.source.astype(np.int64) * zones + transitions.target
    present, pair = np.unique(key, return_inverse=True)
    pair = pair.astype(np.int32)
    pairs = len(present)
    source, target = (
        (present // max(zones, 1)).astype(np.int32),
        (present % max(zones, 1)).astype(np.int32),
    )
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
    ratio = log_likelihood_ratio(pair, transitions.weight, transitions.flat, pairs)
    variance = np.nan_to_num(transit.sd) ** 2 / mahalanobis.chance_variance(
        bins.lag_min, bins.lag_max
    )
    probability = np.zeros(pairs)
    for rows in rows_together(pairs):
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


def refresh_monte_carlo(table: LinkTable, bins: LagBins) -> LinkTable:
    """The table with ``Var(d)`` from Monte Carlo observations (thesis 4.3) in place of the few that
    were seen.
    """
    density = smooth(table.counts)[0] / bins.widths
    samples = monte_carlo.observe(density, np.nan_to_num(table.transit.sd), bins, MONTE_CARLO_SEED)
    chance = mahalanobis.chance_variance(bins.lag_min, bins.lag_max)
    return table._replace(variance=mahalanobis.distance_variance(samples, chance))


def significant(table: LinkTable, settings: Settings) -> NDArray[np.bool_]:
    """Pairs (P,) whose evidence meets the rule for publishing."""
    return (
        (table.q <= settings.publish_q_max)
        & (table.probability >= settings.publish_probability_min)
        & (table.transit.total >= TRANSITIONS_MIN)
        & (table.variance <= mahalanobis.LINKED_VARIANCE_MAX)
    )


def joined_by(table: LinkTable) -> set[tuple[int, int]]:
    """The pairs of zones of the table."""
    return set(zip(table.source.tolist(), table.target.tolist(), strict=True))


def beside(likely: LinkTable, published: LinkTable, zones: int) -> LinkTable:
    """Weak links for prediction: rows of the posterior that are not published, the likeliest few of
    each source.

    What the published links leave over of each source is shared among them and leaving as the
    posterior shares it.
    """
    key, done = (
        table.source.astype(np.int64) * zones + table.target for table in (likely, published)
    )
    known = np.isin(key, done)
    taken = np.bincount(published.source, published.probability, minlength=zones)
    before = np.bincount(likely.source[known], likely.probability[known], minlength=zones)
    scale = np.maximum(1.0 - taken, 0.0) / np.maximum(1.0 - before, LEFT_OVER_MIN)
    likely = likely._replace(probability=np.minimum(likely.probability * scale[likely.source], 1.0))
    rows = np.flatnonzero(~known & (likely.transit.total >= WEAK_TRANSITIONS_MIN))
    rows = rows[np.lexsort((likely.target[rows], -likely.probability[rows], likely.source[rows]))]
    source = likely.source[rows]
    starts = np.concatenate(([True], source[1:] != source[:-1])) if len(rows) else np.zeros(0, bool)
    rank = np.arange(len(rows)) - np.maximum.accumulate(np.where(starts, np.arange(len(rows)), 0))
    return likely.rows(rows[rank < WEAK_LINKS_PER_ZONE_MAX])
