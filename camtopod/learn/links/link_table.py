"""Table of links: the figures of every pair of zones.

The joint fit gives the responsibility of each candidate. `tabulate` turns these (`Transitions`)
into a `LinkTable`: probability, evidence, transit times and the thesis's Var(d) of each pair of
zones. `publishing` has the rule by which they are published; `select_weak_links` picks the
likeliest of the other pairs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Ints, Longs, find_pairs, find_rows, row_slices
from camtopod.learn.association import Fit, LagRanges, Problem, exposures, number_pairs
from camtopod.learn.links import mahalanobis, monte_carlo
from camtopod.learn.links.significance import log_likelihood_ratio, q_values
from camtopod.learn.links.transit_time import TransitFigures, transit_figures
from camtopod.topology import LagBins, smooth

TRANSITIONS_MIN = 2.0
"""Least expected number of transitions of a published link."""
FAINT_TRANSITIONS = 0.2
"""Transitions that the fit for prediction adds to every pair of zones, and least expected number of
those of a weak link.
"""
NEXT_ZONES_MAX = 24
"""Largest number of places that are considered next of one place: of weak links from one zone, next
zones that prediction reads, paths from one camera, and overlaps with one view.
"""
MONTE_CARLO_SEED = 2011
"""Seed of the Monte Carlo observations, fixed so that versions are reproducible."""


class Transitions(NamedTuple):
    """M possible transitions, each with the probability that it is one; columns are (M,)."""

    source: Ints
    """Zone of departure."""
    target: Ints
    """Zone of arrival."""
    lag: Floats
    """Seconds from departure to arrival."""
    weight: Floats
    """Probability that departure and arrival are of one object (the responsibility)."""
    flat: Floats
    """Hazard of the pair of zones if it were the same at all lags, over its hazard at this lag."""


def concatenate_transitions(parts: list[Transitions]) -> Transitions:
    """Return several tables of transitions as one."""
    no_transitions = Transitions(
        np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0), np.zeros(0), np.zeros(0)
    )
    return Transitions(
        *(np.concatenate(columns) for columns in zip(no_transitions, *parts, strict=True))
    )


def transitions_of(fit: Fit, least: float = 0.0) -> Transitions:
    """Return the candidates of a joint fit as possible transitions.

    least: least expected number of transitions of a pair of zones; other pairs are left out.
    """
    c = fit.candidates
    enough = np.bincount(c.pair, fit.responsibility, minlength=len(c.source)) >= least
    rows = np.flatnonzero(enough[c.pair])
    pair = c.pair[rows]
    lag = c.lag[rows].astype(float)
    return Transitions(
        c.source[pair], c.target[pair], lag, fit.responsibility[rows], fit.flat[rows]
    )


def exposed_departures(problem: Problem) -> Floats:
    """Return the departures of each range of lags to which a probability refers, (R, bins).

    For a lag after the exit, these are the departures that could have been seen to arrive after the
    lag: an object that has just left may still be under way. For lags before the exit, they are all
    departures.
    """
    exposure = exposures(problem)
    departure_counts = np.bincount(problem.delayed_departures()[0], minlength=len(exposure))[
        :, None
    ]
    return np.where(problem.bins.edges[1:] > 0, exposure, departure_counts)


class LinkTable(NamedTuple):
    """Figures of P pairs of zones; columns are (P,) unless stated otherwise."""

    source: Ints
    """Zone of departure."""
    target: Ints
    """Zone of arrival."""
    probability: Floats
    """Share of the departures at ``source`` that appear next at ``target``."""
    ratio: Floats
    """Evidence that the zones are linked: log likelihood ratio, nats."""
    q: Floats
    """False discovery rate at which the pair would be published as a link."""
    transit: TransitFigures
    """Number of transitions and figures of their transit times."""
    variance: Floats
    """The thesis's Var(d), a variance of Mahalanobis distances (table 4.3)."""
    counts: Floats
    """(P, bins) expected transitions per lag bin."""
    delay: Floats
    """Seconds to add to the lags of ``counts``; not 0 on long paths (`camtopod.learn.long_paths`).
    """
    weight: Floats
    """Weight of the pair among all that are tested (`camtopod.learn.declarations`)."""

    def rows(self, keep: NDArray[np.intp]) -> LinkTable:
        """Return the table with the rows ``keep`` only, in that order."""
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
            self.weight[keep],
        )

    def with_evidence(self, ratio: Floats, tests: int) -> LinkTable:
        """Return the table with its evidence, and so its false discovery rates, replaced.

        ratio (P,): the new evidence, nats.
        tests: number of pairs of zones that were tested.
        """
        return self._replace(ratio=ratio, q=q_values(ratio, tests, self.weight))

    def with_weights(self, weights: Floats | None) -> LinkTable:
        """Return the table with the weight of each pair of zones; its evidence is still to be set.

        weights (zones, zones): with a mean of 1; None for 1.
        """
        if weights is None:
            return self
        return self._replace(weight=weights[self.source, self.target])

    def evidence_of(self, source: Ints, target: Ints) -> Floats:
        """Return the evidence (n, nats) of pairs of zones; 0 of those that are not in the table."""
        row, exists = find_pairs((self.source, self.target), (source, target))
        evidence = np.zeros(len(source))
        evidence[exists] = self.ratio[row[exists]]
        return evidence


AGREEMENT_NATS = 2.0
"""Least evidence of its own with which a pair of zones gets that of the second opinion, too."""


class PathEvidence(NamedTuple):
    """Evidence for K paths between cameras, the second opinion (`camtopod.learn.paths`)."""

    source: Longs
    """(K,) camera of departure."""
    target: Longs
    """(K,) camera of arrival."""
    place: Floats
    """(K,) median lag, seconds."""
    width: Floats
    """(K,) scale of the lags, seconds."""
    nats: Floats
    """(K,) evidence for the path, nats."""


def with_second_opinion(
    table: LinkTable, paths: PathEvidence, camera: Ints, zones: int
) -> LinkTable:
    """Return the table with the evidence of the second opinion added where both opinions agree.

    camera (zones,): camera of each zone.

    Of each pair of cameras, the pair of zones with the most transitions gets it, of the paths whose
    lag is one of its transit times.
    """
    cameras = int(camera.max(initial=0)) + 1
    pair = camera[table.source].astype(np.int64) * cameras + camera[table.target]
    order = np.lexsort((-table.transit.total, pair))
    best_rows = order[np.diff(pair[order], prepend=-1) != 0]
    agreeing_rows = best_rows[table.ratio[best_rows] >= AGREEMENT_NATS]

    row, exists = find_rows(pair[agreeing_rows], paths.source * cameras + paths.target)
    row, place, width, nats = agreeing_rows[row[exists]], *(column[exists] for column in paths[2:])
    early, _, late = table.transit.quantiles[row].T
    is_same = (place >= early - width) & (place <= late + width)
    ratio = table.ratio + np.bincount(row[is_same], nats[is_same], len(table.ratio))
    return table.with_evidence(ratio, zones**2)


def tabulate(
    transitions: Transitions,
    departures: Floats,
    bins: LagBins,
    zones: int,
    ranges: LagRanges | None = None,
) -> LinkTable:
    """Return the figures of every pair of zones that occurs among possible transitions.

    departures (R, bins): departures of each range of lags to which probabilities refer
        (`exposed_departures`); (R, 1) if they do not depend on the lag.
    zones: number of zones.
    ranges: `Problem.ranges`.
    """
    # The pairs of zones that occur.
    pair, source, target = number_pairs(transitions.source, transitions.target, zones)
    pairs = len(source)
    of = source if ranges is None else ranges.of[source, target]
    later = np.zeros(pairs) if ranges is None else ranges.delay[of]

    # Expected transitions per lag bin, and their smoothed density per second.
    at = bins.index(transitions.lag - later[pair])
    inside = at >= 0
    flat = np.bincount(
        pair[inside].astype(np.int64) * bins.size + at[inside],
        transitions.weight[inside],
        minlength=pairs * bins.size,
    )
    counts: Floats = flat.astype(float, copy=False).reshape(pairs, bins.size)
    density = smooth(counts)[0]
    density /= bins.widths

    # Transit times.
    transit = transit_figures(pair, transitions.lag, transitions.weight, density, bins)
    transit = transit._replace(mode=transit.mode + later)

    # Evidence, Var(d) and transition probability.
    ratio = log_likelihood_ratio(pair, transitions.weight, transitions.flat, pairs)
    variance = np.nan_to_num(transit.sd) ** 2 / mahalanobis.null_variance(
        bins.lag_min, bins.lag_max
    )
    probability = np.zeros(pairs)
    for rows in row_slices(pairs):
        probability[rows] = np.minimum(
            (counts[rows] / np.maximum(departures[of[rows]], 1.0)).sum(axis=1), 1.0
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
        np.ones(pairs),
    )


def with_monte_carlo_variance(table: LinkTable, bins: LagBins) -> LinkTable:
    """Return the table with ``Var(d)`` computed from Monte Carlo observations (thesis 4.3).

    As in the thesis, these take the place of the observed transit times, which are few.
    """
    density = smooth(table.counts)[0] / bins.widths
    samples = monte_carlo.observe(density, np.nan_to_num(table.transit.sd), bins, MONTE_CARLO_SEED)
    chance = mahalanobis.null_variance(bins.lag_min, bins.lag_max)
    return table._replace(variance=mahalanobis.distance_variance(samples, chance))


def zone_pairs_of(table: LinkTable) -> set[tuple[int, int]]:
    """Return the pairs (zone of departure, zone of arrival) of the table."""
    return set(zip(table.source.tolist(), table.target.tolist(), strict=True))


def select_weak_links(likely: LinkTable, published_links: LinkTable, zones: int) -> LinkTable:
    """Return the weak links: of each zone of departure, the likeliest pairs that are not published.

    likely: pairs of zones by the fit for prediction, the posterior.
    published_links: links that meet the rule for publishing.
    zones: number of zones.

    The share of a zone's departures that published links leave over is divided among its weak links
    and leaving the site, in the proportions of the posterior.
    """
    # Scale the probabilities of each zone of departure to what its published links leave over.
    _, is_published = find_pairs(
        (published_links.source, published_links.target), (likely.source, likely.target)
    )
    published_share = np.bincount(
        published_links.source, published_links.probability, minlength=zones
    )
    before, other_share = (
        np.bincount(likely.source[rows], likely.probability[rows], minlength=zones)
        for rows in (is_published, ~is_published)
    )
    left_over = np.maximum(np.maximum(1.0 - before, other_share), 1e-9)
    scale = np.maximum(1.0 - published_share, 0.0) / left_over
    likely = likely._replace(probability=np.minimum(likely.probability * scale[likely.source], 1.0))

    # Order the unpublished pairs by source and probability, and keep the first of each source.
    rows = np.flatnonzero(~is_published & (likely.transit.total >= FAINT_TRANSITIONS))
    rows = rows[np.lexsort((likely.target[rows], -likely.probability[rows], likely.source[rows]))]
    source = likely.source[rows]
    starts = np.diff(source, prepend=-1) != 0
    rank = np.arange(len(rows)) - np.maximum.accumulate(np.where(starts, np.arange(len(rows)), 0))
    return likely.rows(rows[rank < NEXT_ZONES_MAX])
