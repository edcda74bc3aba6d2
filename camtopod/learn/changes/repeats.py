"""Find recordings that are played in a loop: a camera's events come again, place and interval.

Each of a camera's newest events is matched, at every possible lag, with an earlier event of the
same kind and place. Only the agreement within tenths of a second is evidence: a rhythm of seconds,
such as a timetable, a guard's round or traffic lights, may be exact. So without a loop, an event
that has a match within `RHYTHM_SECONDS` of a lag finds it anywhere in that time.

The evidence for a lag is a log likelihood ratio over the stretch of newest events that speaks most
for it: chance reaches x nats with a probability of exp(-x) at most. A camera repeats itself if two
lags, so this is the third play at least, are clear enough for `FALSE_ALARM` together, and one
period alone is more than chance: a sign that is switched each minute is no recording.

After a random pause a recording has another lag; the newest events, if they are enough, have two.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Bools, Floats, Indices
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
RHYTHM_SECONDS = 2.0
"""Deviation from a lag within which all lags are equally likely without a loop; the least lag.
Events within this time of each other count as one: a group, a lamp, a short passage.
"""
MATCHED = 0.9
"""Probability that an event of a recording has a match in an earlier play."""


def find_repeats(window: Window) -> list[str]:
    """Return for each camera how its events repeat themselves, in words; "" if they do not."""
    placed = window.has_position()
    found = []
    for rows in window.rows_of_cameras():
        own = rows[placed[rows]][-KNOWN_MAX:]
        t = window.column("t")[own] / MICROSECONDS
        found.append(repeats_of(t, *(window.column(name)[own] for name in ("entry", "px", "py"))))
    return found


def repeats_of(t: Floats, entry: Bools, px: Indices, py: Indices) -> str:
    """Return how n events of one camera repeat themselves, in words; "" if they do not.

    t (n, seconds): ascending.
    entry, px, py (n,): True for an entry, False for an exit; position in fixed point.
    """
    if len(t) < 2 or not (t % 1.0).any():  # whole seconds have no tenths to compare
        return ""

    # Matches of the newest events, newest first: event, lag (seconds), evidence (nats).
    times = t[-JUDGED_MAX:][::-1]
    lags = times[:, None] - t[::-1]  # ascending in each row
    like = lags > RHYTHM_SECONDS
    for value, most in ((entry.astype(np.int8), 0), (px, PLACE), (py, PLACE)):
        like &= (np.abs(value[-JUDGED_MAX:, None] - value) <= most)[::-1, ::-1]
    event, other = np.nonzero(like)
    lag = lags[event, other]
    apart = lags.max() + RHYTHM_SECONDS  # lags of two events are further apart
    near = _count_within(event * apart + lag, RHYTHM_SECONDS)
    by_chance = near * AGREE_SECONDS / (2 * RHYTHM_SECONDS)
    weight = 1.0 / _count_within(times[::-1], RHYTHM_SECONDS)[::-1]
    gain = weight[event] * np.log(np.maximum(MATCHED / by_chance, 1.0))

    # The evidence for each range of lags that may have enough.
    chance = math.log(len(t) * len(times))
    found = []
    for phase in (0.0, 0.5):
        _, number = np.unique(np.floor(lag / AGREE_SECONDS + phase), return_inverse=True)
        for one in np.flatnonzero(np.bincount(number, gain) > chance):
            rows = np.flatnonzero(number == one)
            each = math.log(1.0 - MATCHED) * weight
            order = rows[np.argsort(gain[rows])]
            each[event[order]] = gain[order]  # the best match of each event
            evidence = float(np.cumsum(each).max())
            if evidence > chance:
                period = float(np.median(lag[rows]))
                own = each[times > times[0] - period + AGREE_SECONDS]
                found.append((evidence, period, float(own[own > 0].sum())))

    # Two lags must be clear together, each at the price of its choice, and one period by itself.
    best, at, _ = max(found, default=(0.0, 0.0, 0.0))
    second = max((one[0] for one in found if abs(one[1] - at) > RHYTHM_SECONDS), default=0.0)
    if best + second < math.log(len(t) ** 3 / FALSE_ALARM):
        return ""
    period, alone = min(one[1:] for one in found if one[0] >= second)
    if alone < chance:
        return ""
    return f"repeats itself every {period:.1f} s: a recording in a loop?"


def _count_within(values: Floats, reach: float) -> NDArray[np.intp]:
    """Return how many of ascending values (n,) are within ``reach`` of each, itself included."""
    above = np.searchsorted(values, values + reach, "right")
    return above - np.searchsorted(values, values - reach)
