"""Change points of links: links that opened, closed or changed their share (METHOD 11).

The *share* of a pair of zones is the share of the departures at the first zone that appear next at
the second. The joint fit estimates one share for the whole window. `find_changes` tests each pair
of the fit for a moment at which its share changed; `present` replaces shares in a `LinkTable` by
those since the change.

Let the fit give an arrival the responsibility ``r`` of being a transition of the pair. If the share
were ``f`` times as large, the log likelihood of a stretch of time would be larger by

``sum over arrivals of log(1 - r + f r) - (f - 1) * expected transitions``.

The change is where two factors, one before and one after, exceed a single factor by most log
likelihood. It counts if this difference, divided by the overdispersion that remains, exceeds the
value that the null model reaches at any split of any pair in less than `FALSE_ALARM` of the
windows: a union bound over Wilks' theorem (related: Killick, Fearnhead and Eckley, 2012).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from camtopod.arrays import Floats, rows_by_group
from camtopod.learn.association import LIKELY_MIN, Fit, Problem
from camtopod.learn.links import (
    PARTS,
    TRANSITIONS_MIN,
    LinkTable,
    PublishingRule,
    log_likelihood_ratio,
)
from camtopod.learn.traffic import Departures
from camtopod.topology import LagBins

FALSE_ALARM = 5e-3
"""Theoretical probability of any false change in one window. The measured probability is far
smaller, as uncertain arrivals vary less than the theory assumes.
"""
FACTORS = np.concatenate(([0.0], np.geomspace(0.01, 100.0, 27)))
"""Factors that are tried: share in a stretch of time over the share in the whole window."""
SPLIT_DEPARTURES_MIN = 4
"""Least number of departures before a change, and after it."""
COME_SHARE = 0.99
"""Share of a pair's transitions that have arrived when a departure counts: the newest departures
may still arrive, but on a way of seconds that takes no longer because there is one of half an hour.
"""
RESPONSIBILITY_MAX = 0.99
"""Upper bound on the responsibility of an arrival, so that a single arrival does not prove that a
path is open.
"""


Silence = tuple[float, float]
"""Beginning and end of an interval in which a camera reported nothing, seconds."""


class ChangePoint(NamedTuple):
    """The latest change of the share of a pair of zones."""

    source: int
    """Zone of departure."""
    target: int
    """Zone of arrival."""
    since: float
    """Time of the change, seconds."""
    before: float
    """Share of the departures at ``source`` that appear next at ``target``, before the change."""
    after: float
    """Share after the change."""
    nats: float
    """Evidence for the change, nats."""
    link_nats: float = 0.0
    """Evidence from the time after the change that the zones are linked, nats."""


class Trials(NamedTuple):
    """Input of the test of one pair: n departures of its first zone, its J transitions, by time."""

    t: Floats
    """(n,) times of departure, seconds."""
    weight: Floats
    """(n,) weight of each departure: 1, or 0 during silences of the second zone's camera."""
    departure_t: Floats
    """(J,) time of departure of each transition, seconds."""
    share: Floats
    """(J,) responsibility of each transition."""


def find_changes(problem: Problem, fit: Fit, silences: list[list[Silence]]) -> list[ChangePoint]:
    """Return the latest change of each pair of zones of a fit that has one, in order of pairs.

    silences: intervals in which each camera reported nothing. Departures in an interval do not
        count for pairs that lead to the camera, as their arrivals could not be recorded.
    """
    departures, arrivals, bins, _, until, *_ = problem
    longest = _usual_longest(fit.counts, bins)

    # Pairs to test, and the departures of each zone.
    delays = problem.delays(fit.candidates.source, fit.candidates.target)
    pairs = np.flatnonzero(fit.counts.sum(axis=1) >= TRANSITIONS_MIN)
    threshold = threshold_nats(len(pairs), len(departures.t))
    camera_of = dict(zip(arrivals.zone.tolist(), arrivals.camera.tolist(), strict=True))
    departures_of = rows_by_group(departures.zone, problem.zones)

    result = []
    for pair, departure_t, share in transitions_by_pair(problem, fit, pairs):
        # Departures and transitions of the pair; later ones may still have an arrival.
        source = int(fit.candidates.source[pair])
        target = int(fit.candidates.target[pair])
        over = until - longest[pair] - delays[pair]
        t = departures.t[departures_of[source]]
        t = t[t <= over]
        weight = np.ones(len(t))
        for begin, end in silences[camera_of[target]]:
            weight[(t + delays[pair] >= begin) & (t + delays[pair] < end)] = 0.0
        counts = departure_t <= over

        # Test it.
        change = latest_change(Trials(t, weight, departure_t[counts], share[counts]), threshold)
        if change is None:
            continue
        since, before, after, _ = change
        link_nats = _linked(
            fit, departures, pair, since, after * weight.sum() / share[counts].sum()
        )

        # A higher share is a path that opened only if its transitions have a transit time.
        if after < before or link_nats >= threshold:
            result.append(ChangePoint(source, target, *change, link_nats=link_nats))
    return result


def _usual_longest(counts: Floats, bins: LagBins) -> Floats:
    """Return the lag (P, seconds), at least 0, by which nearly all transitions of a pair have come.

    counts (P, bins): expected transitions by lag.
    """
    cumulative = np.cumsum(counts, axis=1)
    last = (cumulative < COME_SHARE * cumulative[:, -1:]).sum(axis=1)
    longest: Floats = np.maximum(np.array(bins.limits)[last + 1], 0.0)
    return longest


def _linked(fit: Fit, departures: Departures, pair: int, since: float, factor: float) -> float:
    """Return the evidence (nats), from the time after a change, that a pair of zones is linked.

    pair: number of the pair in the fit.
    since (seconds): time of the change.
    factor: share after the change, over the share in the fit.
    """
    rows = np.flatnonzero(fit.candidates.pair == pair)
    rows = rows[departures.t[fit.candidates.departure[rows]] >= since]
    pair_number = np.zeros(len(rows), np.int32)
    share = _scaled(fit.responsibility[rows], factor)
    return float(log_likelihood_ratio(pair_number, share, fit.flat[rows], 1)[0])


def threshold_nats(series: int, trials: int) -> float:
    """Return the evidence (nats) above which a change counts.

    series: number of series of departures that are tested for changes.
    trials: number of departures.

    If nothing changes, any series exceeds it in less than `FALSE_ALARM` of the windows. Splits of
    which one has less than twice as many departures after it as the other count as one test, as
    they are nearly the same.
    """
    splits = max(math.log2(max(trials, 1) / SPLIT_DEPARTURES_MIN), 1.0)
    return float(chdtri(1.0, FALSE_ALARM / (max(series, 1) * splits))) / 2.0


def transitions_by_pair(
    problem: Problem, fit: Fit, pairs: NDArray[np.intp]
) -> list[tuple[int, Floats, Floats]]:
    """Return the transitions of each pair: (pair, departure times (J,), responsibilities (J,)).

    pairs (n,): numbers of the pairs, ascending.

    Transitions are in order of time. Candidates of one pair and one arrival are merged into one
    transition: its responsibility is the sum, its time of departure the weighted mean.
    """
    # Candidates of these pairs.
    departures, arrivals, *_ = problem
    c = fit.candidates
    is_asked = np.zeros(len(c.source), bool)
    is_asked[pairs] = True
    rows = np.flatnonzero(is_asked[c.pair] & (fit.responsibility > LIKELY_MIN))

    # Merge those of one pair and one arrival: sum of responsibilities, mean time of departure.
    key = c.pair[rows].astype(np.int64) * len(arrivals.t) + c.arrival[rows]
    present, number = np.unique(key, return_inverse=True)
    weight = fit.responsibility[rows]
    share = np.bincount(number, weight, minlength=len(present))
    departure_t = (
        np.bincount(number, weight * departures.t[c.departure[rows]], minlength=len(present))
        / share
    )

    # Order by pair and time, and split by pair.
    pair = present // max(len(arrivals.t), 1)
    order = np.lexsort((departure_t, pair))
    starts = np.searchsorted(pair[order], pairs)
    stops = np.searchsorted(pair[order], pairs, side="right")
    return [
        (int(p), departure_t[order[a:b]], np.minimum(share[order[a:b]], RESPONSIBILITY_MAX))
        for p, a, b in zip(pairs, starts, stops, strict=True)
    ]


def latest_change(trials: Trials, threshold: float) -> tuple[float, float, float, float] | None:
    """Return time (seconds), share before, share after and evidence (nats) of the latest change.

    trials: departures of one zone and the transitions to test.
    threshold (nats): least evidence of a change; None is returned if there is no such change.
    """
    if trials.weight.sum() == 0 or trials.share.sum() == 0:
        return None
    n = len(trials.t)
    table = _Table(trials)
    changes = table.changes(0, n, threshold)
    if not changes:
        return None

    # The share before the latest change holds since the change before that.
    begin = changes[-2][0] if len(changes) > 1 else 0
    split, nats = changes[-1]
    return float(trials.t[split]), table.share(begin, split), table.share(split, n), nats


class _Table:
    """Cumulative log likelihoods of every factor for one pair of zones.

    A *stretch* is a range of departures, in order of time; its log likelihood is the difference of
    two columns.
    """

    def __init__(self, trials: Trials) -> None:
        self.weight = np.concatenate(([0.0], np.cumsum(trials.weight)))
        rate = float(trials.share.sum()) / self.weight[-1]
        self.factors = FACTORS[FACTORS * rate <= max(1.0, rate)][:, None]
        """(F, 1) factors with which the share is at most 1."""
        self.at = np.append(np.searchsorted(trials.departure_t, trials.t), len(trials.departure_t))
        """(n + 1,) number of transitions before each departure, and in all."""
        log = np.log1p((self.factors - 1.0) * trials.share).cumsum(axis=1)
        log = np.pad(log, ((0, 0), (1, 0)))
        self.log = log[:, self.at] - (self.factors - 1.0) * rate * self.weight
        """(F, n + 1) log likelihood of every factor up to each departure."""
        self.shares = trials.share

    def changes(self, begin: int, end: int, threshold: float) -> list[tuple[int, float]]:
        """Return the changes within a stretch: first departure after each, and evidence (nats).

        begin, end: first departure of the stretch, and one past the last.
        threshold (nats): least evidence.
        """
        # By how many nats two factors explain the stretch better than one, by split.
        splits = np.arange(begin + SPLIT_DEPARTURES_MIN, end - SPLIT_DEPARTURES_MIN + 1)
        if len(splits) == 0:
            return []
        first, last = self.log[:, [begin]], self.log[:, [end]]
        at = self.log[:, splits]
        gain = (at - first).max(axis=0) + (last - at).max(axis=0) - (last - first).max()

        # The best split, its evidence corrected for overdispersion; then on either side of it.
        split = int(splits[np.argmax(gain)])
        nats = float(gain.max())
        if nats > threshold:
            nats /= self.overdispersion(begin, split, end)
        if nats <= threshold:
            return []
        before, after = (self.changes(*part, threshold) for part in ((begin, split), (split, end)))
        return [*before, (split, nats), *after]

    def moved(self, begin: int, end: int) -> Floats:
        """Return the responsibilities in a stretch with its likeliest factor."""
        factor = float(self.factors[np.argmax(self.log[:, end] - self.log[:, begin]), 0])
        return _scaled(self.shares[self.at[begin] : self.at[end]], factor)

    def share(self, begin: int, end: int) -> float:
        """Return the likeliest share in a stretch: one EM step from the best factor on the grid."""
        trials = max(float(self.weight[end] - self.weight[begin]), 1e-9)
        return min(float(self.moved(begin, end).sum()) / trials, 1.0)

    def overdispersion(self, begin: int, split: int, end: int) -> float:
        """Return the variance of the transitions per block over that of the null model, at least 1.

        begin, end: first departure of the stretch, and one past the last.
        split: first departure after the change, on either side of which the share is constant.
        """
        # Squared deviations from a constant share on either side, and their expectation.
        square = chance = 0.0
        for low, high in ((begin, split), (split, end)):
            edges = np.linspace(low, high, min(PARTS // 2, high - low) + 1).astype(np.int64)
            transitions = self.moved(low, high)
            cumulative = np.concatenate(([0.0], np.cumsum(transitions)))
            count = np.diff(cumulative[self.at[edges] - self.at[low]])
            trials = np.diff(self.weight[edges])
            square += float(((count - trials * count.sum() / max(trials.sum(), 1e-9)) ** 2).sum())
            chance += float((transitions**2).sum()) * (1.0 - 1.0 / len(count))
        return max(1.0, square / max(chance, 1e-9)) if chance > 0 else 1.0


def _scaled(share: Floats, factor: float) -> Floats:
    """Return responsibilities if the share of their pair were ``factor`` times as large."""
    return factor * share / (1.0 - share + factor * share)


def present(
    table: LinkTable, changes: list[ChangePoint], zones: int, rule: PublishingRule
) -> LinkTable:
    """Return a link table with present shares, without pairs that have closed.

    table: pairs of zones with their shares over the whole window, as probability.
    changes: the latest change of each pair that has one.
    zones: number of zones.
    rule: a changed pair that is not taken often enough for it any more is left out.

    The evidence for a pair that opened is at least that for the change and for the link since then
    (the smaller of the two). Other shares of the same zone of departure are scaled down where all
    would add up to more than 1.
    """
    latest = {(change.source, change.target): change for change in changes}
    if not latest:
        return table

    # Shares and evidence of the pairs that changed.
    probability = table.probability.copy()
    ratio = table.ratio.copy()
    new = np.zeros(len(table.source), bool)
    for k, pair in enumerate(zip(table.source.tolist(), table.target.tolist(), strict=True)):
        change = latest.get(pair)
        if change is None:
            continue
        new[k] = True
        probability[k] = change.after
        if change.after > change.before:
            ratio[k] = max(ratio[k], min(change.nats, change.link_nats))
    is_open = ~new | rule.is_often_taken(probability)

    # Scale the other pairs of the same zones of departure to the remaining share.
    new_share, steady_share = (
        np.bincount(table.source, probability * rows, minlength=zones)
        for rows in (new & is_open, ~new)
    )
    room = np.minimum(1.0, np.maximum(1.0 - new_share, 0.0) / np.maximum(steady_share, 1e-9))
    probability = np.where(
        new, probability, probability * np.where(new_share > 0, room, 1.0)[table.source]
    )
    result = table._replace(probability=probability).with_evidence(ratio, zones * zones)
    return result.rows(np.flatnonzero(is_open))
