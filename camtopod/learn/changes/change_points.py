"""Change points of links: links that opened or closed, and since when their present share holds.

The joint fit gives one share to each pair of zones for the whole window, so it still shows a path
that was closed, and shows one that was opened too weakly. Here each pair of the fit is tested for a
moment before which its share of the *departures* was different. Traffic that rises and falls
changes departures and transitions alike, and is no change.

Let the fit ascribe an arrival to the pair with responsibility ``r``. If the share were ``f`` times
as large, the arrival would be ``1 - r + f r`` times as likely, and departures would take the path
``f`` times as often. The log likelihood of ``f`` over a stretch of time is therefore

``sum log(1 - r + f r) - (f - 1) * expected``,

in which an arrival that may well have come from elsewhere has little weight.

The change is where two factors, one before and one after, exceed a single one by most. It counts if
this ratio, divided by the overdispersion that remains (groups of people, shares that follow the
hour), exceeds what the null model reaches at any split of any pair in less than `FALSE_ALARM` of
the windows: a union bound over Wilks' theorem. Related: Killick, Fearnhead and Eckley (2012); cost
functions of the ruptures package.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from camtopod.arrays import Floats, Longs, rows_by_group
from camtopod.learn.association import Fit
from camtopod.learn.links import LinkTable, log_likelihood_ratio
from camtopod.learn.traffic import Arrivals, Departures

FALSE_ALARM = 5e-3
"""Theoretical probability of any false change in one window.

The measured probability is far smaller, as uncertain arrivals vary less than the theory assumes.
"""
FACTORS = np.concatenate(([0.0], np.geomspace(0.03, 100.0, 25)))
"""Ratios of the share in a stretch to the share over the whole window that are tried."""
SPLIT_DEPARTURES_MIN = 4
"""Least number of departures on either side of a change."""
SPLIT_RATIO = 1.15
"""Ratio between the numbers of departures since successive splits.

Splits are tried with 4, 4.6, 5.3, ... departures since, so that the resolution is proportional to
the age of a change.
"""
BLOCKS = 16
"""Number of blocks of the window from whose counts the overdispersion is estimated."""
CHANGES_MAX = 4
"""Largest number of changes of one pair within a window that are followed."""
RESPONSIBILITY_MIN = 1e-3
"""Candidates with a smaller responsibility are left out."""
RESPONSIBILITY_MAX = 0.99
"""Largest responsibility of an arrival, so that a single one does not prove that a path is open."""
TRANSITIONS_MIN = 2.0
"""Least expected transitions of a pair that is tested."""


Silence = tuple[float, float]
"""Beginning and end of an interval in which a camera reported nothing, seconds."""


class Change(NamedTuple):
    """The latest change of a pair of zones."""

    source: int
    """Zone of departure."""
    target: int
    """Zone of arrival."""
    since: float
    """Time of the change, seconds."""
    before: float
    """Share of the departures at ``source`` that appeared next at ``target`` until then."""
    after: float
    """The same share since then."""
    nats: float
    """Evidence for the change."""
    linked: float = 0.0
    """Evidence since then (nats) that the zones are linked, by transitions with a transit time."""


class Trials(NamedTuple):
    """Departures of one zone (n,), and transitions of one pair of zones (J,), both by time."""

    t: Floats
    """(n,) times of departure, seconds."""
    weight: Floats
    """(n,) weight of each departure, 0 during silences of the target's camera."""
    moved: Floats
    """(J,) time of departure of each transition, seconds."""
    share: Floats
    """(J,) responsibility of each transition."""


def find_changes(
    fit: Fit, departures: Departures, arrivals: Arrivals, over: float, silences: list[list[Silence]]
) -> list[Change]:
    """Return the latest change of each pair of the fit that has one, by pair.

    over (seconds): later departures may still arrive and do not count.
    silences: of each camera, the intervals in which it reported nothing. No arrival could be seen
        there, so departures in them do not count.
    """
    # Pairs to test, and the departures of each zone that count.
    pairs = np.flatnonzero(fit.counts.sum(axis=1) >= TRANSITIONS_MIN)
    threshold = threshold_nats(len(pairs), len(departures.t))
    camera_of = dict(zip(arrivals.zone.tolist(), arrivals.camera.tolist(), strict=True))
    done = departures.t[: np.searchsorted(departures.t, over, side="right")]
    left = rows_by_group(
        departures.zone[: len(done)], int(fit.candidates.source.max(initial=-1)) + 1
    )

    found = []
    for pair, moved, share in transitions_by_pair(fit, departures, arrivals, pairs):
        # Departures and transitions of the pair.
        source, target = int(fit.candidates.source[pair]), int(fit.candidates.target[pair])
        t = done[left[source]]
        weight = np.ones(len(t))
        for begin, end in silences[camera_of[target]]:
            weight[(t >= begin) & (t < end)] = 0.0
        counts = moved <= over

        # Test it.
        change = latest_change(Trials(t, weight, moved[counts], share[counts]), threshold)
        if change is None:
            continue
        since, before, after, _ = change
        linked = _linked(fit, departures, pair, since, after * weight.sum() / share[counts].sum())

        # A higher share is a path that opened only if its transitions have a transit time.
        if after < before or linked >= threshold:
            found.append(Change(source, target, *change, linked=linked))
    return found


def _linked(fit: Fit, departures: Departures, pair: int, since: float, factor: float) -> float:
    """Return the evidence in nats that a pair of zones is linked, since a change.

    since (seconds): time of the change.
    factor: share since then, over the share in the fit.
    """
    rows = np.flatnonzero(fit.candidates.pair == pair)
    rows = rows[departures.t[fit.candidates.departure[rows]] >= since]
    one = np.zeros(len(rows), np.int32)
    share = fit.responsibility[rows]
    share = factor * share / (1.0 - share + factor * share)
    return float(log_likelihood_ratio(one, share, fit.flat[rows], 1)[0])


def threshold_nats(series: int, trials: int) -> float:
    """Return the evidence that any false change exceeds in less than `FALSE_ALARM` of the windows.

    Splits count as one test if one has less than twice the departures of the other since, as they
    are nearly the same.

    series: number of series that are tested.
    trials: number of departures.
    """
    splits = max(math.log2(max(trials, 1) / SPLIT_DEPARTURES_MIN), 1.0)
    return float(chdtri(1.0, FALSE_ALARM / (max(series, 1) * splits))) / 2.0


def transitions_by_pair(
    fit: Fit, departures: Departures, arrivals: Arrivals, pairs: NDArray[np.intp]
) -> list[tuple[int, Floats, Floats]]:
    """Return the transitions of each pair: pair, times of departure (J,), responsibilities (J,).

    There is one for each arrival, by time: departures that compete for one arrival are merged.

    pairs (n,): the pairs, ascending.
    """
    # Candidates of these pairs.
    c = fit.candidates
    asked = np.zeros(len(c.source), bool)
    asked[pairs] = True
    kept = np.flatnonzero(asked[c.pair] & (fit.responsibility >= RESPONSIBILITY_MIN))

    # Merge those of one pair and one arrival: sum of responsibilities, mean time of departure.
    key = c.pair[kept].astype(np.int64) * len(arrivals.t) + c.arrival[kept]
    present, number = np.unique(key, return_inverse=True)
    weight = fit.responsibility[kept]
    share = np.bincount(number, weight, minlength=len(present))
    moved = (
        np.bincount(number, weight * departures.t[c.departure[kept]], minlength=len(present))
        / share
    )

    # Order by pair and time, and split by pair.
    pair = present // max(len(arrivals.t), 1)
    order = np.lexsort((moved, pair))
    starts = np.searchsorted(pair[order], pairs)
    stops = np.searchsorted(pair[order], pairs, side="right")
    return [
        (int(p), moved[order[a:b]], np.minimum(share[order[a:b]], RESPONSIBILITY_MAX))
        for p, a, b in zip(pairs, starts, stops, strict=True)
    ]


def latest_change(trials: Trials, threshold: float) -> tuple[float, float, float, float] | None:
    """Return time, share before, share after and evidence (nats) of the latest change, if any."""
    n = len(trials.t)
    if n < 2 * SPLIT_DEPARTURES_MIN or trials.weight.sum() == 0 or trials.share.sum() == 0:
        return None

    # The latest change: look for another one after each that is found.
    table = _Table(trials)
    start, split, nats = 0, 0, 0.0
    for _ in range(CHANGES_MAX):
        later, more = table.change(split, n, threshold)
        if later is None:
            break
        start, split, nats = split, later, more
    if split == 0:
        return None

    # The share before: it need not have held for long, so look for the change before.
    for _ in range(CHANGES_MAX):
        begun, _ = table.change(start, split, threshold)
        if begun is None:
            break
        start = begun
    return float(trials.t[split]), table.share(start, split), table.share(split, n), nats


class _Table:
    """Cumulative log likelihoods of one pair; that of a stretch is a difference of two columns."""

    def __init__(self, trials: Trials) -> None:
        self.weight = np.concatenate(([0.0], np.cumsum(trials.weight)))
        self.rate = float(trials.share.sum()) / self.weight[-1]
        """Share over the whole window."""
        self.at = np.append(np.searchsorted(trials.moved, trials.t), len(trials.moved))
        """(n + 1,) number of transitions before each departure, and in all."""
        log = np.log1p((FACTORS[:, None] - 1.0) * trials.share)
        self.log = np.concatenate((np.zeros((len(FACTORS), 1)), np.cumsum(log, axis=1)), axis=1)
        self.shares = trials.share
        self.possible = FACTORS * self.rate <= max(1.0, self.rate)

    def likelihood(self, begin: Longs, end: Longs) -> Floats:
        """Return the log likelihood (factors, S) of every factor over stretches of departures.

        begin, end (S,): first departure of each stretch, and one past the last.
        """
        expected = self.rate * (self.weight[end] - self.weight[begin])
        log: Floats = self.log[:, self.at[end]] - self.log[:, self.at[begin]]
        log -= (FACTORS[:, None] - 1.0) * expected
        log[~self.possible] = -np.inf
        return log

    def change(self, begin: int, end: int, threshold: float) -> tuple[int | None, float]:
        """Return the first departure of a new factor in a stretch, and the evidence (nats).

        Returns None and 0 if the evidence is too little.
        """
        # Best split on the coarse grid, then among all between its neighbours.
        splits = _splits(begin, end)
        if len(splits) == 0 or self.weight[end] == self.weight[begin]:
            return None, 0.0
        best = int(np.argmax(self._gain(begin, splits, end)))
        near = np.arange(splits[min(best + 1, len(splits) - 1)], splits[max(best - 1, 0)] + 1)
        gain = self._gain(begin, near, end)
        split = int(near[np.argmax(gain)])

        # Evidence, corrected for overdispersion.
        if gain.max() <= threshold:
            return None, 0.0
        nats = float(gain.max()) / self.overdispersion(begin, split, end)
        return (split, nats) if nats > threshold else (None, 0.0)

    def _gain(self, begin: int, splits: Longs, end: int) -> Floats:
        """Return the nats (S,) by which two factors explain a stretch better than one, by split."""
        first, last = np.full_like(splits, begin), np.full_like(splits, end)
        apart = self.likelihood(first, splits).max(axis=0) + self.likelihood(splits, last).max(
            axis=0
        )
        whole = self.likelihood(first[:1], last[:1]).max()
        gain: Floats = apart - whole
        return gain

    def factor(self, begin: int, end: int) -> float:
        """Return the likeliest factor for a stretch."""
        return float(FACTORS[np.argmax(self.likelihood(np.array([begin]), np.array([end])))])

    def share(self, begin: int, end: int) -> float:
        """Return the likeliest share in a stretch: one EM step from the best factor on the grid."""
        trials = max(float(self.weight[end] - self.weight[begin]), 1e-9)
        return min(float(self._moved(begin, end, self.factor(begin, end)).sum()) / trials, 1.0)

    def overdispersion(self, begin: int, split: int, end: int) -> float:
        """Return the variance of block counts over that of the null model, at least 1.

        The change at ``split`` is taken out.
        """
        # Blocks, cut at the change, too.
        edges = np.unique(np.linspace(begin, end, BLOCKS + 1).astype(np.int64))
        edges = np.unique(np.append(edges, split))

        # Squared deviations from a constant share on either side, and their expectation.
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
        """Return the responsibilities of a stretch, were the share ``factor`` times as large."""
        share = self.shares[self.at[begin] : self.at[end]]
        return factor * share / (1.0 - share + factor * share)


def _splits(begin: int, end: int) -> Longs:
    """Return the splits of the stretch ``begin`` to ``end`` that are tried, latest first."""
    n = end - begin
    if n < 2 * SPLIT_DEPARTURES_MIN:
        return np.zeros(0, np.int64)
    steps = (
        int(math.log((n - SPLIT_DEPARTURES_MIN) / SPLIT_DEPARTURES_MIN) / math.log(SPLIT_RATIO)) + 1
    )
    late = np.unique((SPLIT_DEPARTURES_MIN * SPLIT_RATIO ** np.arange(steps)).astype(np.int64))
    return (end - late[late <= n - SPLIT_DEPARTURES_MIN]).astype(np.int64)


def present(table: LinkTable, changes: list[Change], zones: int, share_min: float) -> LinkTable:
    """Return the table with present shares, without changed pairs that are below ``share_min`` now.

    Evidence for a pair that opened comes from its own past and from the transitions since. Other
    shares of a source are scaled down where they would add up to more than 1 with a changed one.

    changes: the latest change of each pair that has one.
    """
    latest = {(change.source, change.target): change for change in changes}
    if not latest:
        return table

    # Shares and evidence of the pairs that changed.
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

    # Scale the other pairs of their sources to the room that is left.
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
