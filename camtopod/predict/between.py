"""How many objects are between cameras: they left a view, will appear again, and have not yet.

An exit's prediction says with which probability, where and about when its object appears next. The
match of an entry says which exits it may continue. By Bayes' rule an object is still to come with
the odds of its next appearances that are later than now, against leaving, and against the entries
that may be of it.

The predictions alone make the number a sum of independent yes-or-no questions, one an exit. But
they are off for all exits of a site alike, which is far more than chance. So intervals are those
of a Poisson number whose mean is gamma distributed: a negative binomial one.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection

import numpy as np

from camtopod.arrays import Floats, Rows
from camtopod.records import Between, BetweenPair, Match, Prediction

HORIZON_SECONDS = 3600.0
"""Time within which objects are expected to appear, seconds; older exits are forgotten."""
EXITS_MAX = 20_000
"""Largest number of exits that are remembered."""
APPEARANCES_MAX = 200_000
"""Largest number of next appearances of these exits that are remembered."""
PROBABILITY_MIN = 1e-3
"""Least probability of an appearance that counts, and least number of a pair that is told."""
SETTLED_MAX = 1e-5
"""Probability of being between cameras below which an exit is forgotten."""
CLAIMS_MAX = 20
"""Number of the newest entries that may be of an exit and are kept by name, for a second match."""
SURE_MAX = 1.0 - 1e-6
"""Largest probability that an entry continues an exit."""
SPAN_SECONDS_MIN = 1e-3
"""Least length of a span between two quantiles, seconds."""
PREDICTION_ERROR = 2.0
"""Standard error of an expected number as a share of it.

With it, intervals of 80 % hold the truth at 77 % of the moments of `bench between` in the mean over
recordings, which is nearest; with what is nearest without a kind of recordings, at 74 % of its own.
"""

ExitKey = tuple[str, float, str | None]
"""Camera, time and track of an event."""


class _PendingExit:
    """An exit whose object may still be between cameras.

    to: number of the camera of each possible next appearance.
    probability, window: of each of them, (n,) and (n, 3): quantiles of the time, seconds.
    """

    def __init__(self, prediction: Prediction, number: Callable[[str], int]) -> None:
        rows = [row for row in prediction.next if row.probability >= PROBABILITY_MIN]
        self.t = prediction.t
        self.camera = number(prediction.camera)
        self.to = np.array([number(row.camera) for row in rows], np.intp)
        self.probability = np.array([row.probability for row in rows])
        self.window = np.array([(row.q10, row.q50, row.q90) for row in rows]).reshape(-1, 3)
        self.absence = 1.0 - float(self.probability.sum())
        """Odds that it is not to come: it leaves, or has been seen already."""
        if len(early := np.flatnonzero(self.window[:, 0] < 0.0)):
            seen_share = 1.0 - share_later(self.window[early], np.zeros(len(early)))
            self.absence += float(self.probability[early] @ seen_share)
        self.claims: dict[ExitKey, float] = {}
        """Odds that it is the object of each of the newest entries."""

    def unclaimed(self, t: float) -> float:
        """Return the odds of all but the newest entries, at a time (Unix seconds)."""
        age = np.full(len(self.to), max(t - self.t, 0.0))
        return self.absence + float(self.probability @ share_later(self.window, age))


class BetweenCameras:
    """The exits of the last hour whose objects may be between cameras; in memory only.

    since (Unix seconds): the beginning; earlier exits do not count.
    """

    def __init__(self, since: float) -> None:
        self.since = since
        self._exits: dict[ExitKey, list[_PendingExit]] = {}
        """By camera, time and track; those without a track may have these in common."""
        self._in_order: deque[tuple[ExitKey, _PendingExit]] = deque()
        self._appearances = 0
        """Number of all their possible next appearances."""
        self._numbers: dict[str, int] = {}
        """Number of each camera."""

    def left(self, prediction: Prediction) -> None:
        """Observe an exit."""
        key = (prediction.camera, prediction.t, prediction.track)
        exit_ = _PendingExit(prediction, self._number)
        if prediction.t < self.since or not len(exit_.to):
            return
        self._exits.setdefault(key, []).append(exit_)
        self._in_order.append((key, exit_))
        self._appearances += len(exit_.to)
        while len(self._in_order) > EXITS_MAX or self._appearances > APPEARANCES_MAX:
            self._forget_oldest()

    def entered(self, match: Match) -> None:
        """Observe the first or the second match of an entry."""
        entry = (match.camera, match.t, match.track)
        for passage in match.from_:
            exits = self._exits.get((passage.camera, passage.t, passage.track), [])
            for exit_ in exits:
                probability = min(passage.probability / len(exits), SURE_MAX)
                exit_.claims.pop(entry, None)
                other_odds = exit_.unclaimed(match.t) + sum(exit_.claims.values())
                exit_.claims[entry] = other_odds * probability / (1.0 - probability)
                if len(exit_.claims) > CLAIMS_MAX:
                    exit_.absence += exit_.claims.pop(next(iter(exit_.claims)))

    def forget_cameras(self, cameras: Collection[str]) -> None:
        """Forget the exits from cameras, and that objects may appear there."""
        numbers = [self._numbers[name] for name in cameras if name in self._numbers]
        items = [(key, exit_) for key, exit_ in self._in_order if exit_.camera not in numbers]
        self._keep(items)
        for _, exit_ in items:
            exit_.probability[np.isin(exit_.to, numbers)] = 0.0

    def expected(
        self, now: float, pairs_max: int | None = None, horizon: float = HORIZON_SECONDS
    ) -> Between:
        """Return how many are between cameras, and will be seen within ``horizon`` seconds.

        now (Unix seconds): moment of the question; later than what has been observed.
        pairs_max: number of pairs of cameras, those with most objects; None for all.
        """
        while self._in_order and now - self._in_order[0][1].t > HORIZON_SECONDS:
            self._forget_oldest()
        exits = [
            departure
            for _, departure in self._in_order
            if departure.t <= now <= departure.t + HORIZON_SECONDS
        ]
        if not exits:
            return Between(now, self.since, 0.0, 0, 0, [])

        # The probability of each appearance that is still to come, within the horizon.
        exit_ = np.repeat(np.arange(len(exits)), [len(departure.to) for departure in exits])
        age = now - np.array([departure.t for departure in exits])
        chance = np.concatenate([departure.probability for departure in exits])
        window = np.concatenate([departure.window for departure in exits])
        later = chance * share_later(window, age[exit_])
        too_late = chance * share_later(window, age[exit_] + horizon)
        against = [departure.absence + sum(departure.claims.values()) for departure in exits]
        no_arrival = np.array(against) + np.bincount(exit_, later, len(exits))
        probability = (later - too_late) / np.maximum(no_arrival[exit_], 1e-300)

        # Forget those who have almost certainly been seen again, or left.
        is_settled = np.bincount(exit_, later, len(exits)) < SETTLED_MAX * no_arrival
        over = {id(exits[k]) for k in np.flatnonzero(is_settled)}
        self._keep([row for row in self._in_order if id(row[1]) not in over])

        # By pair of cameras, and in all.
        cameras = len(self._numbers)
        to = np.concatenate([departure.to for departure in exits])
        pair = np.array([departure.camera for departure in exits])[exit_] * cameras + to
        by_pair = self._pairs(pair, probability, pairs_max)
        number = float(probability.sum())
        [low], [high] = intervals(np.array([number]))
        return Between(now, self.since, round(number, 3), low, high, by_pair)

    def _pairs(self, pair: Rows, probability: Floats, pairs_max: int | None) -> list[BetweenPair]:
        """Return the pairs of cameras, those with most objects first.

        pair, probability: of each appearance; a pair is a number of two cameras.
        """
        codes, at = np.unique(pair, return_inverse=True)
        number = np.bincount(at, probability).astype(float)
        order = np.argsort(-number, kind="stable")[:pairs_max]
        order = order[number[order] >= PROBABILITY_MIN]
        mean, names = number[order], list(self._numbers)
        columns = (codes[order].tolist(), mean.tolist(), *intervals(mean))
        return [
            BetweenPair(
                names[code // len(names)], names[code % len(names)], round(mean, 3), low, high
            )
            for code, mean, low, high in zip(*columns, strict=True)
        ]

    def _keep(self, items: list[tuple[ExitKey, _PendingExit]]) -> None:
        """Forget all exits but these, which are in order."""
        self._in_order, self._exits = deque(items), {}
        for key, exit_ in items:
            self._exits.setdefault(key, []).append(exit_)
        self._appearances = sum(len(exit_.to) for _, exit_ in items)

    def _number(self, camera: str) -> int:
        return self._numbers.setdefault(camera, len(self._numbers))

    def _forget_oldest(self) -> None:
        key, exit_ = self._in_order.popleft()
        self._exits[key].remove(exit_)
        if not self._exits[key]:
            del self._exits[key]
        self._appearances -= len(exit_.to)


def share_later(window: Floats, age: Floats) -> Floats:
    """Return the share (n,) of appearances later than some ages.

    window (n, 3): quantiles of 0.1, 0.5 and 0.9 of the time of an appearance, seconds.
    age (n,): seconds since the exit, at least 0.

    Between the quantiles times are uniform, before the first one since the exit; after the last
    one they go on as from the median to there: each such span leaves a fifth.
    """
    q10, q50, q90 = window.T
    begin = np.minimum(q10, 0.0)
    later = 1.0 - 0.1 * _part(age, begin, q10) - 0.4 * (_part(age, q10, q50) + _part(age, q50, q90))
    late = 0.2 ** (np.maximum(age - q90, 0.0) / np.maximum(q90 - q50, SPAN_SECONDS_MIN))
    return np.where(age < q90, later, 0.1 * late)


def _part(age: Floats, begin: Floats, end: Floats) -> Floats:
    """Return the part of each span, 0 to 1, that is over at each age."""
    part: Floats = np.clip((age - begin) / np.maximum(end - begin, SPAN_SECONDS_MIN), 0.0, 1.0)
    return part


def intervals(mean: Floats) -> tuple[list[int], list[int]]:
    """Return the 0.1 and the 0.9 quantiles (n,) of numbers whose means (n,) are expected."""
    shape = PREDICTION_ERROR**-2
    success = shape / (shape + mean)[:, None]
    number = np.arange(int(4.0 * mean.max(initial=0.0)) + 10)  # well beyond the 0.9 quantile
    mass = np.empty((len(mean), len(number) + 1))
    mass[:, :1] = success**shape
    mass[:, 1:] = (number + shape) / (number + 1.0) * (1.0 - success)  # over that of one less
    below = mass.cumprod(axis=1).cumsum(axis=1)
    low, high = (np.count_nonzero(below < share, axis=1).tolist() for share in (0.1, 0.9))
    return low, high
