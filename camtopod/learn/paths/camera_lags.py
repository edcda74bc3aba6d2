"""Candidates of pairs of cameras by lag: every departure and later arrival of the window.

Zones do not matter here, and lags are not binned. The range of lags reaches further than that of
the joint fit (`camtopod.learn.association`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from camtopod.arrays import Floats, Ints, Longs, Rows, Singles, ranges
from camtopod.learn.limits import EVENT_PAIRS_MAX
from camtopod.learn.traffic import (
    Arrivals,
    Departures,
    activity_rates,
    label_agreement,
    label_shares,
    local_rates,
)

LAG_SECONDS_MAX, ZONE_LAG_SECONDS_MAX = 900.0, 200.0
"""Longest lag between cameras, and between zones."""


class CameraLags(NamedTuple):
    """The M candidates, and the n departures and m arrivals that they are of.

    Pair p leads from camera p // C to camera p % C, with C ``cameras``.
    """

    departure_t: Floats
    """(n,) time of each departure, seconds."""
    dwell: Floats
    """(n,) seconds that its passage has lasted; inf if unknown."""
    source: Longs
    """(n,) its camera."""
    target: Longs
    """(m,) camera of each arrival."""
    rate: Floats
    """(m,) rate of arrivals at this camera around its time, 1/s."""
    active: Floats
    """(m,) that rate if arrivals also follow the activity of the site (`activity_rates`), 1/s."""
    departure: Rows
    """(M,) row of the departure of each candidate."""
    arrival: Rows
    """(M,) row of its arrival."""
    lag: Floats
    """(M,) seconds from departure to arrival."""
    key: Floats
    """(M,) ascending: `keys` of the pair and the lag of each candidate."""
    cameras: int
    lag_min: float
    """Least lag, seconds."""
    lag_max: float
    """Longest lag, seconds."""
    until: float
    """Time up to which arrivals are known, seconds."""
    likeness: Singles | None = None
    """(M,) likelihood ratio of one object over two, by the labels; None without labels."""

    def within(self, pair: Longs, low: Floats, high: Floats) -> tuple[Rows, Rows, Rows]:
        """Return the candidates within some ranges of lags.

        pair, low, high (k,): pair of cameras, and lags in seconds, of k ranges, not empty.

        The results are the range of each candidate in a range (e,), which may be in several; which
        of the n candidates that are in any range it is (e,); and the rows of these, (n,) ascending.
        """
        bounds = np.clip((low, high), self.lag_min, self.lag_max)
        first, last = (keys(pair, lag, self.lag_min, self.lag_max) for lag in bounds)
        begin = np.searchsorted(self.key, first)
        end = np.maximum(np.searchsorted(self.key, last, side="right"), begin)

        # Join the ranges that overlap.
        order = np.argsort(begin, kind="stable")
        end_so_far = np.maximum.accumulate(end[order])
        is_new = np.append(True, begin[order][1:] >= end_so_far[:-1])[: len(order)]
        group = np.empty(len(order), np.intp)
        group[order] = np.cumsum(is_new) - 1
        start = begin[order][is_new]
        size = np.maximum.reduceat(end_so_far, np.flatnonzero(is_new)) - start
        _, rows = ranges(start, size)
        before = np.cumsum(size) - size - start
        number, row = ranges(begin + before[group], end - begin)
        return number, row, rows


def keys(pair: Longs, lag: Floats, lag_min: float, lag_max: float) -> Floats:
    """Return numbers (n,) that ascend by pair of cameras, then lag; arguments as `CameraLags`."""
    result: Floats = pair * (lag_max - lag_min + 1.0) + (lag - lag_min)
    return result


def camera_lags(
    departures: Departures,
    arrivals: Arrivals,
    cameras: int,
    lag_min: float,
    until: float,
    by_zone: bool = False,
    label_persistence: float = 0.0,
) -> CameraLags:
    """Return the candidates of a window, `EVENT_PAIRS_MAX` at most, of its newest events.

    cameras: number of cameras.
    lag_min (seconds): least lag; an arrival is not before the entry of the departing object either.
    until: time up to which arrivals are known, seconds.
    by_zone: True for paths between zones of different cameras, not between cameras; ``cameras`` is
        the number of zones then.
    label_persistence: share of the objects whose label persists.
    """
    if by_zone:
        lag_min = 0.0
    span = max(until - float(min(departures.t[0], arrivals.t[0])), 1.0)
    lag_max = min(ZONE_LAG_SECONDS_MAX if by_zone else LAG_SECONDS_MAX, 0.5 * span)

    # Arrivals in reach of each departure, of the newest departures.
    first, end = _reach(departures, arrivals, lag_min, lag_max)
    newest = np.cumsum((end - first)[::-1])[::-1] <= EVENT_PAIRS_MAX
    late = arrivals.t >= departures.t[newest].min(initial=np.inf) + lag_min
    departures = departures.take(newest, late)
    arrivals = arrivals.take(late)
    first, end = _reach(departures, arrivals, lag_min, lag_max)
    departure, arrival = ranges(first, end - first)

    # An object does not return before it has left, and its own entry is no transition.
    source = (departures.zone if by_zone else departures.camera).astype(np.int64)
    arrival_place = arrivals.zone if by_zone else arrivals.camera
    lag = arrivals.t[arrival] - departures.t[departure]
    possible = departures.camera[departure] != arrivals.camera[arrival]
    if not by_zone:
        possible |= lag > 0
    possible &= departures.own[departure] != arrival

    rate = np.maximum(
        arrivals.rate if by_zone else local_rates(arrivals.t, arrival_place, cameras), 1e-7
    )

    # In order of pair and lag.
    pair = source[departure] * cameras + arrival_place[arrival]
    key = keys(pair, lag, lag_min, lag_max)
    order = np.flatnonzero(possible)
    order = order[np.argsort(key[order], kind="stable")]
    departure, arrival = departure[order], arrival[order]
    return CameraLags(
        departures.t,
        departures.t - departures.since,
        source,
        arrival_place.astype(np.int64),
        rate,
        activity_rates(arrivals.t, arrival_place, arrivals.camera, rate),
        departure,
        arrival,
        lag[order],
        key[order],
        cameras,
        lag_min,
        lag_max,
        until,
        _likeness(departures, arrivals, arrival_place, (departure, arrival), label_persistence),
    )


def _likeness(
    departures: Departures,
    arrivals: Arrivals,
    places: Ints,
    candidates: tuple[Rows, Rows],
    persistence: float,
) -> Singles | None:
    """Return the agreement of labels (M,) of each candidate; None without labels.

    places (m,): camera or zone of each arrival.
    candidates (M,): rows of their departures and arrivals.
    persistence: share of the objects whose label persists.
    """
    if departures.label is None or arrivals.label is None or persistence <= 0.0:
        return None
    departure, arrival = candidates
    share = label_shares(places, arrivals.label, int(places.max(initial=0)) + 1)
    return label_agreement(
        departures.label[departure], arrivals.label[arrival], share[arrival], persistence
    ).astype(np.float32)


def _reach(
    departures: Departures, arrivals: Arrivals, lag_min: float, lag_max: float
) -> tuple[Rows, Rows]:
    """Return the first arrival in reach of each departure (n,), and one past the last."""
    earliest = np.maximum(departures.since, departures.t + lag_min)
    return (
        np.searchsorted(arrivals.t, earliest),
        np.searchsorted(arrivals.t, departures.t + lag_max, side="right"),
    )
