"""Find recordings that are played in a loop: a camera's events come again, place and interval.

Each of a camera's newest events is matched, at every possible lag, with an earlier event of the
same kind and place. Only the agreement within tenths of a second is evidence: a rhythm of seconds,
such as a timetable, a guard's round or traffic lights, is allowed to be exact. So an event that has
a match within `RHYTHM_SECONDS` of a lag would, without a loop, find it anywhere in that time.

A *repetition* is a lag with the stretch of newest events that speaks most for it. Its evidence is a
log likelihood ratio, so chance reaches x nats with a probability of exp(-x) at most, for each
stretch and lag. A camera repeats itself if two earlier stretches of its events together speak
clearly enough for that (`FALSE_ALARM`), and if

* at least half of the newest period comes from these repetitions,
* one period alone is more than chance: a sign that is switched each minute is no recording,
* the events do not come in between as well, less exactly, as those of a rhythm do.

After a random pause a recording has another lag; its stretches end with each play.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Bools, Floats, Indices, Rows, rows_by_group
from camtopod.topology import POSITION_ONE

FALSE_ALARM = 1e-6
"""Largest expected number of false alarms of one camera in a year."""
KNOWN_MAX = 1_000
"""Newest events of a camera in which earlier plays are looked for: three plays must fit in."""
JUDGED_MAX = 100
"""Newest events of a camera that are matched with earlier ones."""
PLACE = 0.05 * POSITION_ONE
"""Largest difference of two positions, in x and in y, that count as the same place."""
AGREE_SECONDS = 0.4
"""Range of lags that count as the same: a grabber sees each event up to a frame later."""
RHYTHM_SECONDS = 5.0
"""Deviation from a lag within which all lags are equally likely without a loop. Shorter lags are
not considered.
"""
TOGETHER_SECONDS = 2.0
"""Events of a camera within this time of each other count as one: a group, a lamp, a short passage.
"""
MATCHED = 0.9
"""Probability that an event of a recording has a match in an earlier play."""
_YEAR_SECONDS = 365.25 * 86_400.0
_CHANCE_NATS = math.log(KNOWN_MAX * JUDGED_MAX)
"""Evidence that chance reaches about once among all stretches and lags of a camera."""
_WHOLE_SECONDS = 1e-3
"""Deviation from whole seconds up to which times have none of the tenths that are compared."""
_APART = 1e9
"""More than any lag, seconds."""
_LOWER = 1e4
"""More than the evidence of any stretch, nats."""


class Repeats(NamedTuple):
    """Seconds from one play of a recording to the next: usual least and most."""

    least: float
    most: float


class _Match(NamedTuple):
    """Matches of judged events with earlier ones; n matches, sorted by event and lag."""

    event: Rows
    """(n,) number of the judged event."""
    lag: Floats
    """(n,) seconds since the earlier event."""
    gain: Floats
    """(n,) evidence for a loop if the match is at the lag of a repetition, nats."""


class _Repetition(NamedTuple):
    """A stretch of judged events that came before at one lag."""

    evidence: float
    """Nats."""
    lag: float
    """Seconds."""
    events: Rows
    """(k,) numbers of the matched events, ascending."""
    gain: Floats
    """(k,) evidence of each match, nats."""


def find_repeats(
    t: Floats, camera: Indices, entry: Bools, px: Indices, py: Indices, cameras: int
) -> list[Repeats | None]:
    """Return for each camera how its events repeat themselves, None if they do not.

    t (n, seconds): time of each event of the window, ascending.
    camera, entry (n,): index of its camera; True for an entry, False for an exit.
    px, py (n,): position in fixed point, negative if unknown: such events are left out.
    cameras: number of cameras.
    """
    placed = np.flatnonzero(px >= 0)
    found = []
    for rows in rows_by_group(camera[placed], cameras):
        own = placed[rows[-KNOWN_MAX:]]
        found.append(_repeats(t[own], entry[own], px[own], py[own]))
    return found


def _repeats(t: Floats, entry: Bools, px: Indices, py: Indices) -> Repeats | None:
    """Return how the events of one camera repeat themselves, None if they do not."""
    if len(t) < 2 or np.abs(t - np.round(t)).max() < _WHOLE_SECONDS:
        return None
    first = max(len(t) - JUDGED_MAX, 0)
    judged = t[first:]
    weight = 1.0 / _count_within(judged, TOGETHER_SECONDS)
    matches = _matches(t, entry, px, py, first, weight)
    cost = -math.log(1.0 - MATCHED) * weight
    found = _separate([one for phase in (0.0, 0.5) for one in _repetitions(matches, cost, phase)])

    # Together they must be clear, each at the price of the choice of its lag.
    evidence = sum(one.evidence - math.log(len(t)) for one in found)
    a_year = _YEAR_SECONDS * len(t) / max(t[-1] - t[0], 1.0)
    if evidence < math.log(a_year / FALSE_ALARM):
        return None

    # Number of earlier plays of each event, and the lag of the nearest one of its stretch.
    plays = np.zeros(len(judged), np.intp)
    nearest = np.full(len(judged), np.inf)
    for one in found:
        plays[one.events] += 1
        stretch = slice(one.events[0], one.events[-1] + 1)
        nearest[stretch] = np.minimum(nearest[stretch], one.lag)
    newest = judged > judged[-1] - nearest.min() + AGREE_SECONDS
    if (
        2 * np.count_nonzero(plays[newest] >= 2) < np.count_nonzero(newest)
        or max(one.gain[newest[one.events]].sum() for one in found) < _CHANCE_NATS
        or _is_rhythm(matches, found, nearest)
    ):
        return None
    least, most = np.quantile(nearest[plays > 0], (0.1, 0.9))
    return Repeats(float(least), float(most))


def _matches(
    t: Floats, entry: Bools, px: Indices, py: Indices, first: int, weight: Floats
) -> _Match:
    """Return the matches of the judged events, which are those from the row ``first``.

    weight (m,): weight of each judged event.
    """
    lag = t[first:, None] - t
    like = (lag > RHYTHM_SECONDS) & (entry[first:, None] == entry)
    for p in (px, py):
        like &= np.abs(p[first:, None] - p) <= PLACE
    event, other = np.nonzero(like[:, ::-1])  # the newest of the others first
    lags = lag[:, ::-1][event, other]
    near = _count_within(event * _APART + lags, RHYTHM_SECONDS)
    by_chance = near * AGREE_SECONDS / (2 * RHYTHM_SECONDS)
    return _Match(event, lags, weight[event] * np.log(np.maximum(MATCHED / by_chance, 1.0)))


def _repetitions(matches: _Match, cost: Floats, phase: float) -> list[_Repetition]:
    """Return the best stretch of each range of lags, if it has more evidence than chance.

    cost (m,): evidence against a loop of each judged event without a match, nats.
    phase: offset of the ranges of lags, as a share of `AGREE_SECONDS`.
    """
    if len(matches.lag) == 0:
        return []

    # The best match of each event in each range; the ranges one after the other.
    part = np.floor(matches.lag / AGREE_SECONDS + phase).astype(np.int64)
    order = np.lexsort((-matches.gain, matches.event, part))
    key = part[order] * JUDGED_MAX + matches.event[order]
    order = order[np.append(True, np.diff(key) > 0)]
    part = part[order]
    event = matches.event[order]
    gain = matches.gain[order]

    # Evidence of the best stretch that ends with each match: the running sum of gains and costs,
    # less its least value before, in the same range.
    costs = np.cumsum(cost)
    after = np.cumsum(gain + cost[event]) - costs[event]
    before = after - gain
    begins = np.append(True, np.diff(part) > 0)
    down = _LOWER * np.cumsum(begins)
    evidence = after - down - np.minimum.accumulate(before - down)

    # The best of each range.
    starts = np.flatnonzero(begins)
    ends = np.append(starts[1:], len(part))
    clear = np.maximum.reduceat(evidence, starts) > _CHANCE_NATS
    found = []
    for start, end in zip(starts[clear], ends[clear], strict=True):
        last = start + int(np.argmax(evidence[start:end]))
        begin = start + int(np.argmin(before[start : last + 1]))
        rows = slice(begin, last + 1)
        lag = float(np.median(matches.lag[order[rows]]))
        found.append(_Repetition(float(evidence[last]), lag, event[rows], gain[rows]))
    return found


def _separate(found: list[_Repetition]) -> list[_Repetition]:
    """Return repetitions without those that share events and lag with one of more evidence."""
    kept: list[_Repetition] = []
    for one in sorted(found, key=lambda one: -one.evidence):
        if not any(
            abs(one.lag - other.lag) < RHYTHM_SECONDS and np.isin(one.events, other.events).any()
            for other in kept
        ):
            kept.append(one)
    return kept


def _is_rhythm(matches: _Match, found: list[_Repetition], nearest: Floats) -> bool:
    """Return True if half of the events come in between as well, less exactly.

    nearest (m,): lag of the nearest repetition of each judged event.

    What a busy view shows at any lag does not count.
    """
    events = 0
    between = 0.0
    for one in found:
        if np.count_nonzero(nearest[one.events] == one.lag) * 2 < len(one.events):
            continue
        events += len(one.events)
        rows = np.isin(matches.event, one.events) & (matches.lag < one.lag - TOGETHER_SECONDS)
        most = 0
        usual = np.count_nonzero(rows) * TOGETHER_SECONDS / one.lag
        for phase in (0.0, 0.5):
            part = np.floor(matches.lag[rows] / TOGETHER_SECONDS + phase).astype(np.int64)
            once = np.unique(part * JUDGED_MAX + matches.event[rows]) // JUDGED_MAX
            most = max(most, *np.unique(once, return_counts=True)[1].tolist(), 0)
        between += most - usual
    return 2 * between >= events


def _count_within(values: Floats, reach: float) -> NDArray[np.intp]:
    """Return how many of ascending values (n,) are within ``reach`` of each, itself included."""
    return np.searchsorted(values, values + reach, "right") - np.searchsorted(
        values, values - reach
    )
