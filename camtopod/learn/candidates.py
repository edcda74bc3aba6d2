"""Candidates: every departure and arrival that may be one object, within the range of lags."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.learn.lags import LagBins, smoother

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

CHUNK = 1_000_000
"""About how many candidates are made at once."""
PAIR_TABLE_MAX = 20_000_000
"""Largest dense table over pairs of zones, entries."""
EXCESS_SMOOTHING_SD_BINS = (1.5, 3.0, 6.0)


class Departures(NamedTuple):
    """Objects leaving, by time, (n,) each: ``t`` seconds, ``zone``, ``camera``, ``since`` when the passage began (-inf:
    unknown), and its log slowness (nan: unknown)."""

    t: Floats
    zone: Ints
    camera: Ints
    since: Floats
    slow: Floats


class Arrivals(NamedTuple):
    """Objects appearing, by time, (n,) each: ``t`` seconds, ``zone``, ``camera``, the local rate of arrivals there
    (1/s), and the log slowness of the passage that begins (nan: unknown).
    """

    t: Floats
    zone: Ints
    camera: Ints
    rate: Floats
    slow: Floats


class Candidates(NamedTuple):
    """Candidates (M,) in order of arrival: indices, pair of zones, lag in seconds; and the pairs' zones (P,)."""

    departure: Ints
    arrival: Ints
    pair: Ints
    lag: Floats
    source: Ints
    target: Ints


def find_candidates(
    departures: Departures, arrivals: Arrivals, bins: LagBins, zones: int, candidates_max: int
) -> Candidates:
    """All candidates; beyond ``candidates_max`` the oldest arrivals do without."""
    low = np.searchsorted(departures.t, arrivals.t - bins.lag_max, side="left")
    high = np.searchsorted(departures.t, arrivals.t - bins.lag_min, side="right")
    parts: list[tuple[NDArray[np.int64], NDArray[np.int64], Floats]] = []
    total = 0
    for part in _newest_first(departures, arrivals, low, high, bins):
        total += len(part[0])
        if total > candidates_max and parts:
            break
        parts.append(part)
    parts.reverse()
    departure, arrival, lag = (np.concatenate(column) for column in zip(*parts, strict=True)) if parts else _nothing()
    key = departures.zone[departure].astype(np.int64) * zones + arrivals.zone[arrival]
    pair, present = _number_pairs(key, zones)
    source, target = present // max(zones, 1), present % max(zones, 1)
    return Candidates(
        departure.astype(np.int32),
        arrival.astype(np.int32),
        pair,
        lag,
        source.astype(np.int32),
        target.astype(np.int32),
    )


def _nothing() -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0)


def _newest_first(
    departures: Departures, arrivals: Arrivals, low: NDArray[np.int64], high: NDArray[np.int64], bins: LagBins
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], Floats]]:
    """Candidates (departure, arrival, lag) in blocks of arrivals, the newest block first, in order within a block."""
    count = high - low
    reached = np.cumsum(count[::-1])
    stop = len(count)
    while stop > 0:
        before = reached[len(count) - stop - 1] if stop < len(count) else 0
        start = min(len(count) - int(np.searchsorted(reached, before + CHUNK, side="right")), stop - 1)
        n = count[start:stop]
        arrival = np.repeat(np.arange(start, stop), n)
        departure = np.arange(len(arrival)) + np.repeat(low[start:stop] - (np.cumsum(n) - n), n)
        lag = arrivals.t[arrival] - departures.t[departure]
        # A negative lag means two views at once: another camera, and the passage there had begun.
        ahead = (departures.camera[departure] != arrivals.camera[arrival]) & (
            arrivals.t[arrival] > departures.since[departure]
        )
        keep = np.flatnonzero((lag >= bins.lag_min) & (lag <= bins.lag_max) & ((lag > 0) | ahead))
        yield departure[keep], arrival[keep], lag[keep]
        stop = start


def excess(seen: Floats, chance: Floats, bins: LagBins, noise_sd: float) -> Floats:
    """What a histogram of lags (P, bins) has above chance and ``noise_sd`` standard deviations of it, smoothed, at
    least 0.

    Cross-correlation (Makris, Ellis and Black 2004), at several widths, as some transit times are kept closely,
    others not.
    """
    result = np.zeros_like(seen)
    for sd_bins in EXCESS_SMOOTHING_SD_BINS:
        spread = smoother(bins.size, sd_bins)
        noise = np.sqrt(np.maximum(chance, 0.5) @ (spread**2).T)
        result = np.maximum(result, (seen - chance) @ spread.T - noise_sd * noise)
    return result


def _number_pairs(key: NDArray[np.int64], zones: int) -> tuple[Ints, NDArray[np.int64]]:
    """Consecutive numbers for the pairs of zones that occur, and their keys."""
    if zones * zones > PAIR_TABLE_MAX:
        present, number = np.unique(key, return_inverse=True)
        return number.astype(np.int32), present
    seen = np.zeros(zones * zones, bool)
    seen[key] = True
    present = np.flatnonzero(seen)
    table = np.zeros(zones * zones, np.int32)
    table[present] = np.arange(len(present), dtype=np.int32)
    return table[key], present
