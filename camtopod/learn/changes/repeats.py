"""Find recordings that are played in a loop: a camera's events come again, place and interval.

Each of a camera's newest events is matched, at every possible lag, with an earlier event of the
same kind and place. Only the agreement within tenths of a second is evidence: a rhythm of seconds,
such as a timetable, a guard's round or traffic lights, may be exact. So without a loop, an event
that has a match within `RHYTHM_SECONDS` of a lag finds it anywhere in that time.

A *repetition* is a lag with the stretch of newest events that speaks most for it. Its evidence is a
log likelihood ratio: chance reaches x nats with a probability of exp(-x) at most, for each stretch
and lag. A camera repeats itself if its repetitions together are clear enough for `FALSE_ALARM`, and

* half of the newest period has two of them, so this is the third play at least;
* one period alone is more than chance: a sign that is switched each minute is no recording;
* the events do not come in between as well, less exactly, as those of a rhythm do.

After a random pause a recording has another lag; its stretches end with each play.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Bools, Floats, Indices, Rows
from camtopod.event_time import MICROSECONDS
from camtopod.learn.changes.camera_moved import FALSE_ALARM
from camtopod.learn.window import Window
from camtopod.topology import POSITION_ONE

KNOWN_MAX = 1_000
"""Newest events of a camera in which earlier plays are looked for: three plays must fit in."""
JUDGED_MAX = 100
"""Newest events of a camera that are matched with earlier ones."""
PLACE = 0.05 * POSITION_ONE
"""Largest difference of two positions, in x and in y, that count as the same place."""
AGREE_SECONDS = 0.4
"""Range of lags that count as the same: a grabber sees each event up to a frame later."""
RHYTHM_SECONDS = 5.0
"""Deviation from a lag within which all lags are equally likely without a loop; the least lag."""
TOGETHER_SECONDS = 2.0
"""Events within this time of each other count as one: a group, a lamp, a short passage."""
MATCHED = 0.9
"""Probability that an event of a recording has a match in an earlier play."""
_CHANCE_NATS = math.log(KNOWN_MAX * JUDGED_MAX)
"""Evidence that chance reaches about once among all stretches and lags of a camera."""
_WHOLE_SECONDS = 1e-3
"""Deviation from whole seconds up to which times have no tenths that could be compared."""


class _Matches(NamedTuple):
    """Judged events with an earlier match, lags (seconds) and evidence (nats), by event and lag."""

    event: Rows
    lag: Floats
    gain: Floats


class _Repetition(NamedTuple):
    """Evidence (nats), lag (seconds), and matched events, ascending, with the evidence of each."""

    evidence: float
    lag: float
    events: Rows
    gain: Floats


def find_repeats(window: Window) -> list[str]:
    """Return for each camera how its events repeat themselves, in words; "" if they do not."""
    has_position = window.has_position()
    descriptions = []
    for rows in window.rows_of_cameras():
        camera_rows = rows[has_position[rows]][-KNOWN_MAX:]
        t = window.column("t")[camera_rows] / MICROSECONDS
        descriptions.append(
            repeats_of(t, *(window.column(name)[camera_rows] for name in ("entry", "px", "py")))
        )
    return descriptions


def repeats_of(t: Floats, entry: Bools, px: Indices, py: Indices) -> str:
    """Return how n events of one camera repeat themselves, in words; "" if they do not.

    t (n, seconds): ascending.
    entry, px, py (n,): True for an entry, False for an exit; position in fixed point.
    """
    if len(t) < 2 or np.abs(t - np.round(t)).max() < _WHOLE_SECONDS:
        return ""
    first = max(len(t) - JUDGED_MAX, 0)
    newest_t = t[first:]
    weight = 1.0 / _count_within(newest_t, TOGETHER_SECONDS)
    matches = _matches(t, entry, px, py, first, weight)
    cost = -math.log(1.0 - MATCHED) * weight
    repetitions = _separate(
        [repetition for phase in (0.0, 0.5) for repetition in _repetitions(matches, cost, phase)]
    )

    # Together they must be clear, each at the price of the choice of its lag.
    evidence = sum(repetition.evidence - math.log(len(t)) for repetition in repetitions)
    if evidence < math.log(len(t) / FALSE_ALARM):
        return ""

    # Number of earlier plays of each event, and the lag of the nearest one of its stretch.
    plays = np.zeros(len(newest_t), np.intp)
    nearest = np.full(len(newest_t), np.inf)
    for repetition in repetitions:
        plays[repetition.events] += 1
        stretch = slice(repetition.events[0], repetition.events[-1] + 1)
        nearest[stretch] = np.minimum(nearest[stretch], repetition.lag)
    newest = newest_t > newest_t[-1] - nearest.min() + AGREE_SECONDS
    if (
        2 * np.count_nonzero(plays[newest] >= 2) < np.count_nonzero(newest)
        or max(repetition.gain[newest[repetition.events]].sum() for repetition in repetitions)
        < _CHANCE_NATS
        or _is_rhythm(matches, repetitions, nearest)
    ):
        return ""

    # Usual least and most time from one play to the next.
    least, longest = np.quantile(nearest[plays > 0], (0.1, 0.9))
    interval = f"{least:.1f}"
    if longest - least > AGREE_SECONDS:
        interval += f" to {longest:.1f}"
    return f"repeats itself every {interval} s: a recording in a loop?"


def _matches(
    t: Floats, entry: Bools, px: Indices, py: Indices, first: int, weight: Floats
) -> _Matches:
    """Return the matches of the judged events: those from row ``first``, with a weight each."""
    lag = (t[first:, None] - t)[:, ::-1]  # ascending
    like = (lag > RHYTHM_SECONDS) & (entry[first:, None] == entry)[:, ::-1]
    for p in (px, py):
        like &= (np.abs(p[first:, None] - p) <= PLACE)[:, ::-1]
    event, earlier = np.nonzero(like)
    lags = lag[event, earlier]
    apart = lags.max(initial=0.0) + RHYTHM_SECONDS  # lags of two events are further apart
    near = _count_within(event * apart + lags, RHYTHM_SECONDS)
    by_chance = near * AGREE_SECONDS / (2 * RHYTHM_SECONDS)
    return _Matches(event, lags, weight[event] * np.log(np.maximum(MATCHED / by_chance, 1.0)))


def _repetitions(matches: _Matches, cost: Floats, phase: float) -> list[_Repetition]:
    """Return the best stretch of each range of lags, if it has more evidence than chance.

    cost (m,): evidence against a loop of each judged event without a match, nats.
    phase: offset of the ranges of lags, as a share of `AGREE_SECONDS`.
    """
    # The best match of each event in each range; the ranges one after the other.
    part = np.floor(matches.lag / AGREE_SECONDS + phase).astype(np.int64)
    order = np.lexsort((-matches.gain, matches.event, part))
    key = part[order] * JUDGED_MAX + matches.event[order]
    order = order[np.diff(key, prepend=-1) > 0]
    part = part[order]
    event = matches.event[order]
    gain = matches.gain[order]

    # Evidence of the best stretch that ends with each match: the running sum of gains and costs,
    # less its least value before, in the same range.
    costs = np.cumsum(cost)
    after = np.cumsum(gain + cost[event]) - costs[event]
    before = after - gain
    begins = np.diff(part, prepend=-1) > 0
    down = (after.max(initial=0.0) - before.min(initial=0.0) + 1.0) * np.cumsum(begins)
    evidence = after - down - np.minimum.accumulate(before - down)

    # The best of each range.
    starts = np.flatnonzero(begins)
    ends = np.append(starts[1:], len(part))
    clear = np.maximum.reduceat(evidence, starts) > _CHANCE_NATS if len(part) else begins
    repetitions = []
    for start, end in zip(starts[clear], ends[clear], strict=True):
        last = start + int(np.argmax(evidence[start:end]))
        begin = start + int(np.argmin(before[start : last + 1]))
        rows = slice(begin, last + 1)
        lag = float(np.median(matches.lag[order[rows]]))
        repetitions.append(_Repetition(float(evidence[last]), lag, event[rows], gain[rows]))
    return repetitions


def _separate(repetitions: list[_Repetition]) -> list[_Repetition]:
    """Return repetitions without those that share events and lag with one of more evidence."""
    result: list[_Repetition] = []
    for repetition in sorted(repetitions, key=lambda repetition: -repetition.evidence):
        if not any(
            abs(repetition.lag - neighbour.lag) < RHYTHM_SECONDS
            and np.isin(repetition.events, neighbour.events).any()
            for neighbour in result
        ):
            result.append(repetition)
    return result


def _is_rhythm(matches: _Matches, repetitions: list[_Repetition], nearest: Floats) -> bool:
    """Return True if half of the events come before their ``nearest`` repetition, less exactly.

    What a busy view shows at any lag does not count.
    """
    events = 0
    between = 0.0
    for repetition in repetitions:
        if np.count_nonzero(nearest[repetition.events] == repetition.lag) * 2 >= len(
            repetition.events
        ):
            events += len(repetition.events)
            rows = np.isin(matches.event, repetition.events) & (
                matches.lag < repetition.lag - TOGETHER_SECONDS
            )
            lags = np.sort(matches.lag[rows])
            count_max = _count_within(lags, TOGETHER_SECONDS / 2).max(initial=0)
            between += count_max - len(lags) * TOGETHER_SECONDS / repetition.lag
    return 2 * between >= events


def _count_within(values: Floats, reach: float) -> NDArray[np.intp]:
    """Return how many of ascending values (n,) are within ``reach`` of each, itself included."""
    above = np.searchsorted(values, values + reach, "right")
    return above - np.searchsorted(values, values - reach)
