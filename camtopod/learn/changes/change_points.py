"""Has a way opened or closed? Since when the present share of each pair of zones holds.

The joint fit gives one share to each pair of zones for the whole window, so a path that was closed
lives on in it and one that was opened is thinned out. Here every pair the fit follows is asked
whether its share of the *departures* was another before some moment: traffic that swells and ebbs
changes the departures and the transitions alike and is no change.

An arrival that the fit ascribes to the pair with probability ``r`` has, were the share ``f`` times
as large, a likelihood ``1 - r + f r`` times as large, and a departure takes the way ``f`` times as
often; so the log likelihood of ``f`` over a stretch of time is ``sum log(1 - r + f r) - (f - 1) *
expected``, in which an arrival that may well have come from elsewhere says little. The change is
where two factors, one before and one after, exceed one for all by most. It counts when that ratio,
over the overdispersion that remains (people in groups, shares that follow the hour), exceeds what
chance reaches at any split of any pair in less than `FALSE_ALARM` of the windows: a union bound
over Wilks' law. Related: Killick, Fearnhead and Eckley (2012); ruptures' cost functions.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from camtopod.arrays import Floats, Longs, rows_of
from camtopod.learn.association import Fit
from camtopod.learn.links import LinkTable, log_likelihood_ratio
from camtopod.learn.traffic import Arrivals, Departures

FALSE_ALARM = 5e-3
"""Probability by theory that chance makes a change anywhere in one window; what is doubtful varies
less than theory has it, so that in measurement it is far less.
"""
FACTORS = np.concatenate(([0.0], np.geomspace(0.03, 100.0, 25)))
"""Shares after over shares on the whole that are tried."""
SPLIT_DEPARTURES_MIN = 4
"""Departures on either side of a change, at least."""
SPLIT_RATIO = 1.15
"""Splits are tried at moments since which there were 4, 4.6, 5.3, ... departures: as finely as a
change is old.
"""
BLOCKS = 16
"""Stretches of a window whose counts say how much more than by chance they vary."""
CHANGES_MAX = 4
"""Changes of one pair within a window that are unrolled."""
RESPONSIBILITY_MIN = 1e-3
RESPONSIBILITY_MAX = 0.99
"""However sure, one arrival does not prove a way open."""
TRANSITIONS_MIN = 2.0
"""Pairs with fewer expected transitions are not asked."""


Silence = tuple[float, float]
"""From when to when a camera reported nothing, seconds."""


class Change(NamedTuple):
    """The share of the departures at zone ``source`` that appear next at ``target``: ``after``
    since ``since`` (seconds), ``before`` until then; ``nats`` of evidence for that. ``linked``:
    evidence since then that they are joined at all, by transits of a certain time.
    """

    source: int
    target: int
    since: float
    before: float
    after: float
    nats: float
    linked: float = 0.0


class Trials(NamedTuple):
    """Departures of one zone, by time (n,), with what each counts; and the transitions of one pair,
    by time (J,).
    """

    t: Floats
    weight: Floats
    moved: Floats
    share: Floats


def find_changes(
    fit: Fit, departures: Departures, arrivals: Arrivals, over: float, silences: list[list[Silence]]
) -> list[Change]:
    """The latest change of every pair of the fit that has one, by pair.

    ``over``: what left later (seconds) may still arrive and does not count. ``silences``: for each
    camera the intervals in which it reported nothing at all; nobody could be seen to arrive there,
    so what left in them does not count.
    """
    pairs = np.flatnonzero(fit.counts.sum(axis=1) >= TRANSITIONS_MIN)
    threshold = threshold_nats(len(pairs), len(departures.t))
    camera_of = dict(zip(arrivals.zone.tolist(), arrivals.camera.tolist(), strict=True))
    done = departures.t[: np.searchsorted(departures.t, over, side="right")]
    left = rows_of(departures.zone[: len(done)], int(fit.candidates.source.max(initial=-1)) + 1)
    found = []
    for pair, moved, share in transitions_by_pair(fit, departures, arrivals, pairs):
        source, target = int(fit.candidates.source[pair]), int(fit.candidates.target[pair])
        t = done[left[source]]
        weight = np.ones(len(t))
        for begin, end in silences[camera_of[target]]:
            weight[(t >= begin) & (t < end)] = 0.0
        counts = moved <= over
        change = latest_change(Trials(t, weight, moved[counts], share[counts]), threshold)
        if change is None:
            continue
        since, before, after, _ = change
        linked = _linked(fit, departures, pair, since, after * weight.sum() / share[counts].sum())
        # More arrivals than before are a way that opened only if they come at a certain time after
        # the departures.
        if after < before or linked >= threshold:
            found.append(Change(source, target, *change, linked=linked))
    return found


def _linked(fit: Fit, departures: Departures, pair: int, since: float, factor: float) -> float:
    """Evidence in nats that a pair of zones is joined, from what left ``since`` (seconds) with
    ``factor`` times the hazard of the fit.
    """
    rows = np.flatnonzero(fit.candidates.pair == pair)
    rows = rows[departures.t[fit.candidates.departure[rows]] >= since]
    one = np.zeros(len(rows), np.int32)
    share = fit.responsibility[rows]
    share = factor * share / (1.0 - share + factor * share)
    return float(log_likelihood_ratio(one, share, fit.flat[rows], 1)[0])


def threshold_nats(series: int, trials: int) -> float:
    """Evidence that chance reaches in less than `FALSE_ALARM` of the windows, at any split of any
    of so many series.

    Splits since which there were less than twice as many departures tell nearly the same, so they
    count as one.
    """
    splits = max(math.log2(max(trials, 1) / SPLIT_DEPARTURES_MIN), 1.0)
    return float(chdtri(1.0, FALSE_ALARM / (max(series, 1) * splits))) / 2.0


def transitions_by_pair(
    fit: Fit, departures: Departures, arrivals: Arrivals, pairs: NDArray[np.intp]
) -> list[tuple[int, Floats, Floats]]:
    """For each pair: when its transitions left (J,), by time, and the probability (J,) of each. One
    for each arrival: departures that compete for one arrival are its one transition.
    """
    c = fit.candidates
    asked = np.zeros(len(c.source), bool)
    asked[pairs] = True
    kept = np.flatnonzero(asked[c.pair] & (fit.responsibility >= RESPONSIBILITY_MIN))
    key = c.pair[kept].astype(np.int64) * len(arrivals.t) + c.arrival[kept]
    present, number = np.unique(key, return_inverse=True)
    weight = fit.responsibility[kept]
    share = np.bincount(number, weight, minlength=len(present))
    moved = (
        np.bincount(number, weight * departures.t[c.departure[kept]], minlength=len(present))
        / share
    )
    pair = present // max(len(arrivals.t), 1)
    order = np.lexsort((moved, pair))
    starts = np.searchsorted(pair[order], pairs)
    stops = np.searchsorted(pair[order], pairs, side="right")
    return [
        (int(p), moved[order[a:b]], np.minimum(share[order[a:b]], RESPONSIBILITY_MAX))
        for p, a, b in zip(pairs, starts, stops, strict=True)
    ]


def latest_change(trials: Trials, threshold: float) -> tuple[float, float, float, float] | None:
    """``since``, share before and after, evidence in nats; None when the share has been the same
    all the time.
    """
    n = len(trials.t)
    if n < 2 * SPLIT_DEPARTURES_MIN or trials.weight.sum() == 0 or trials.share.sum() == 0:
        return None
    table = _Table(trials)
    start, split, nats = 0, 0, 0.0
    for _ in range(CHANGES_MAX):  # later and later
        later, more = table.change(split, n, threshold)
        if later is None:
            break
        start, split, nats = split, later, more
    if split == 0:
        return None
    for _ in range(CHANGES_MAX):  # what held just before need not have held long
        begun, _ = table.change(start, split, threshold)
        if begun is None:
            break
        start = begun
    return float(trials.t[split]), table.share(start, split), table.share(split, n), nats


class _Table:
    """Cumulative log likelihoods of one pair, so that any stretch of its departures is judged by a
    subtraction.
    """

    def __init__(self, trials: Trials) -> None:
        self.weight = np.concatenate(([0.0], np.cumsum(trials.weight)))
        self.rate = float(trials.share.sum()) / self.weight[-1]
        """Share of the departures on the whole."""
        self.at = np.append(np.searchsorted(trials.moved, trials.t), len(trials.moved))
        """(n + 1,) transitions before each departure, and in all."""
        log = np.log1p((FACTORS[:, None] - 1.0) * trials.share)
        self.log = np.concatenate((np.zeros((len(FACTORS), 1)), np.cumsum(log, axis=1)), axis=1)
        self.shares = trials.share
        self.possible = FACTORS * self.rate <= max(1.0, self.rate)

    def likelihood(self, begin: Longs, end: Longs) -> Floats:
        """Log likelihood of every factor (factors, S) for departures ``begin`` (S,) to ``end``."""
        expected = self.rate * (self.weight[end] - self.weight[begin])
        log: Floats = self.log[:, self.at[end]] - self.log[:, self.at[begin]]
        log -= (FACTORS[:, None] - 1.0) * expected
        log[~self.possible] = -np.inf
        return log

    def change(self, begin: int, end: int, threshold: float) -> tuple[int | None, float]:
        """Departure from which on another factor holds, and the evidence in nats; None if that is
        too little.
        """
        splits = _splits(begin, end)
        if len(splits) == 0 or self.weight[end] == self.weight[begin]:
            return None, 0.0
        best = int(np.argmax(self._gain(begin, splits, end)))
        near = np.arange(splits[min(best + 1, len(splits) - 1)], splits[max(best - 1, 0)] + 1)
        gain = self._gain(begin, near, end)
        split = int(near[np.argmax(gain)])
        if gain.max() <= threshold:
            return None, 0.0
        nats = float(gain.max()) / self.overdispersion(begin, split, end)
        return (split, nats) if nats > threshold else (None, 0.0)

    def _gain(self, begin: int, splits: Longs, end: int) -> Floats:
        """Nats (S,) by which two factors explain more than one."""
        first, last = np.full_like(splits, begin), np.full_like(splits, end)
        apart = self.likelihood(first, splits).max(axis=0) + self.likelihood(splits, last).max(
            axis=0
        )
        whole = self.likelihood(first[:1], last[:1]).max()
        gain: Floats = apart - whole
        return gain

    def factor(self, begin: int, end: int) -> float:
        """The likeliest factor for a stretch."""
        return float(FACTORS[np.argmax(self.likelihood(np.array([begin]), np.array([end])))])

    def share(self, begin: int, end: int) -> float:
        """The likeliest share for a stretch: one EM step from the best on the grid."""
        trials = max(float(self.weight[end] - self.weight[begin]), 1e-9)
        return min(float(self._moved(begin, end, self.factor(begin, end)).sum()) / trials, 1.0)

    def overdispersion(self, begin: int, split: int, end: int) -> float:
        """Variance of the counts of stretches over what chance would give, at least 1, the change
        being taken out.
        """
        edges = np.unique(np.linspace(begin, end, BLOCKS + 1).astype(np.int64))
        edges = np.unique(np.append(edges, split))
        square = chance = 0.0
        for low, high in ((begin, split), (split, end)):
            inside = edges[(edges >= low) & (edges <= high)]
            each = self._moved(low, high, self.factor(low, high))
            moved = np.concatenate(([0.0], np.cumsum(each)))
            count = np.diff(moved[self.at[inside] - self.at[low]])
            trials = np.diff(self.weight[inside])
            square += float(((count - trials * count.sum() / max(trials.sum(), 1e-9)) ** 2).sum())
            chance += float((each**2).sum()) * (1.0 - 1.0 / max(len(count), 1))
        return max(1.0, square / max(chance, 1e-9)) if chance > 0 else 1.0

    def _moved(self, begin: int, end: int, factor: float) -> Floats:
        share = self.shares[self.at[begin] : self.at[end]]
        return factor * share / (1.0 - share + factor * share)


def _splits(begin: int, end: int) -> Longs:
    """Splits of departures ``begin`` to ``end``, latest first."""
    n = end - begin
    if n < 2 * SPLIT_DEPARTURES_MIN:
        return np.zeros(0, np.int64)
    steps = (
        int(math.log((n - SPLIT_DEPARTURES_MIN) / SPLIT_DEPARTURES_MIN) / math.log(SPLIT_RATIO)) + 1
    )
    late = np.unique((SPLIT_DEPARTURES_MIN * SPLIT_RATIO ** np.arange(steps)).astype(np.int64))
    return (end - late[late <= n - SPLIT_DEPARTURES_MIN]).astype(np.int64)


def present(table: LinkTable, changes: list[Change], zones: int, share_min: float) -> LinkTable:
    """The table with the shares that hold now; pairs whose share is now below ``share_min`` are
    left out.

    What has opened is told from chance by its own past and by what has come since. Shares that make
    more than 1 with a new one beside them give way to it.
    """
    latest = {(change.source, change.target): change for change in changes}
    if not latest:
        return table
    probability, ratio, kept = (
        table.probability.copy(),
        table.ratio.copy(),
        np.ones(len(table.source), bool),
    )
    new = np.zeros(len(table.source), bool)
    for k, pair in enumerate(zip(table.source.tolist(), table.target.tolist(), strict=True)):
        change = latest.get(pair)
        if change is None:
            continue
        new[k], kept[k], probability[k] = True, change.after >= share_min, change.after
        if change.after > change.before:
            ratio[k] = max(ratio[k], min(change.nats, change.linked))
    taken, others = (
        np.bincount(table.source, probability * rows, minlength=zones)
        for rows in (new & kept, ~new)
    )
    room = np.minimum(1.0, np.maximum(1.0 - taken, 0.0) / np.maximum(others, 1e-9))
    probability = np.where(
        new, probability, probability * np.where(taken > 0, room, 1.0)[table.source]
    )
    changed = table._replace(probability=probability).with_evidence(ratio, zones * zones)
    return changed.rows(np.flatnonzero(kept))
