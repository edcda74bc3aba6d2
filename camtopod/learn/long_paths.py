"""Long paths: pairs of cameras whose transit time the lag bins of the joint fit do not resolve.

Lag bins are a tenth of the lag wide, too wide where many arrive; but a path of five minutes that
all objects take within ten seconds stands out of the correlogram of its two cameras
(`clocks.correlogram`). If its clearest peak is at a long lag (`find_long_paths`), the lags from the
first camera to the second are *delayed*: counted from the peak on (`long_ranges`), so that the
joint fit covers it with narrow bins. Whether there is a link is decided by the evidence of the fit,
as for any other pair.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import uniform_filter1d

from camtopod.arrays import Floats, Ints, rows_by_group
from camtopod.learn.association import CandidateScreen, LagRanges, Problem
from camtopod.learn.clocks import (
    LAGS,
    ROWS_AT_ONCE,
    Correlograms,
    Counts,
    cache_friendly_order,
    null_expectation,
)
from camtopod.learn.lags import BIN_SECONDS, FALSE_PROBABILITY, poisson_nats
from camtopod.learn.traffic import Arrivals, Departures
from camtopod.topology import LAG_STEP

LONG_SECONDS_MIN = 60.0
"""Least lag of a long path; the lag bins are fine enough for shorter ones."""
LONG_SHARE_MAX = 0.25
"""Largest lag of a long path, as a share of the duration of the window, so that a path is observed
more than once.
"""
WIDTHS_BINS = (5, 11, 25, 61)
"""Widths, in bins, of the windows of lags in which arrivals are counted."""


def find_long_paths(
    departures: Departures, arrivals: Arrivals, cameras: int
) -> list[tuple[int, int, float]]:
    """Find the long paths between cameras, as (source, target, seconds), sorted.

    The seconds are the lag of the peak, about the transit time.

    cameras: number of cameras.
    """
    left, reached = (np.unique(events.camera).tolist() for events in (departures, arrivals))
    pairs = [(a, b) for a in left for b in reached if a != b]
    if not pairs:
        return []
    source, target = np.array(pairs, np.int32).T

    # The clearest peak of each pair of cameras, from the correlograms of both halves of the window.
    first = min(departures.t[0], arrivals.t[0])
    last = max(departures.t[-1], arrivals.t[-1])
    longest = min(LAGS * BIN_SECONDS, LONG_SHARE_MAX * float(last - first))
    middle = int(np.searchsorted(departures.t, 0.5 * (first + last)))
    halves = []
    for half in (slice(middle), slice(middle, None)):
        t, camera = departures.t[half], departures.camera[half]
        if len(t):
            # Of a long window, correlograms cover the newest stretch: here that of the half.
            end = max(int(np.searchsorted(arrivals.t, t[-1] + LAGS * BIN_SECONDS, "right")), 1)
            in_reach = arrivals.t[:end], arrivals.camera[:end]
            halves.append(Correlograms((t, camera), in_reach, cameras, BIN_SECONDS))
    nats, seconds = np.zeros((2, len(pairs)))
    order = cache_friendly_order(source, target, min(half.at_once for half in halves))
    for k in range(0, len(order), ROWS_AT_ONCE):
        part = order[k : k + ROWS_AT_ONCE]
        counts = np.stack([half.between(source[part], target[part]) for half in halves])
        nats[part], seconds[part] = clearest_peaks(counts, longest)
    false = len(pairs) * max(longest, 1.0) / BIN_SECONDS * np.exp(-nats)
    clear = false < FALSE_PROBABILITY

    # The peaks at long lags of paths that do not lead over a camera between.
    lag = np.full((cameras, cameras), np.nan)
    lag[source[clear], target[clear]] = seconds[clear]
    dwell = _usual_dwell_time(departures, cameras)
    return [
        (*pairs[k], float(seconds[k]))
        for k in np.flatnonzero(clear & (seconds >= LONG_SECONDS_MIN)).tolist()
        if not _is_over(lag, dwell, *pairs[k])
    ]


def clearest_peaks(counts: Counts, longest: float) -> tuple[Floats, Floats]:
    """Return the evidence (nats) for each camera pair's clearest peak, and its lag (seconds), (P,).

    counts (halves, P, lags): correlograms of the P pairs in each half of the window; both must have
        the peak, as a single coincidence makes none.
    longest (seconds): largest lag at which peaks are looked for.

    The null model is a Poisson process with the local rate. The log likelihood ratio is divided by
    the dispersion at negative lags, at which no transition can be.
    """
    lag = np.arange(-LAGS, LAGS + 1) * BIN_SECONDS
    before = lag < -LONG_SECONDS_MIN
    near = np.abs(lag) < LONG_SECONDS_MIN
    usual = np.stack([null_expectation(half) for half in counts])
    usual = np.maximum(usual, counts.mean(axis=2, keepdims=True))
    best, place = np.zeros((2, counts.shape[1]))
    for width in WIDTHS_BINS:
        observed, expected = (
            width * uniform_filter1d(part.astype(float), width) for part in (counts, usual)
        )
        in_both = (observed > expected).all(axis=0)

        # Log likelihood ratio of both halves together, corrected for dispersion.
        observed, expected = observed.sum(axis=0), expected.sum(axis=0)
        deviation = ((observed - expected) / np.sqrt(expected))[:, before]
        dispersion = np.var(deviation, axis=1, keepdims=True)
        nats = poisson_nats(observed, expected) / np.maximum(dispersion, 1.0)

        # The highest peak, be it at a short lag or at a long one.
        sharp = width * BIN_SECONDS <= 2 * LAG_STEP * lag  # as wide as two lag bins
        far = sharp & (lag > 0) & (lag <= longest)
        peaks = np.where((near | far) & in_both, nats, 0.0)
        at = peaks.argmax(axis=1)
        top = peaks.max(axis=1)
        place = np.where(top > best, lag[at], place)
        best = np.maximum(best, top)
    return best, place


def _usual_dwell_time(departures: Departures, cameras: int) -> Floats:
    """Return the median dwell time in each view (cameras, seconds); 0 where it is unknown."""
    is_known = np.isfinite(departures.since)
    dwell = (departures.t - departures.since)[is_known]
    camera = departures.camera[is_known]
    return np.array(
        [np.median(dwell[rows]) if len(rows) else 0.0 for rows in rows_by_group(camera, cameras)]
    )


def _is_over(lag: Floats, dwell: Floats, source: int, target: int) -> bool:
    """Return True if the path between two cameras is as long as one over a third camera.

    lag (cameras, cameras): transit time from each camera to each, seconds; nan without a path.
    dwell (cameras,): median dwell time in each view, seconds.
    source, target: the two cameras.
    """
    over = lag[source] + dwell + lag[:, target]
    ahead = (lag[source] > 0) & (lag[:, target] > 0)
    apart = np.abs(over - lag[source, target])
    return bool(np.any(ahead & (apart <= 2 * LAG_STEP * lag[source, target])))


def long_ranges(problem: Problem, camera: Ints, candidates_max: int) -> LagRanges | None:
    """Return the ranges of the lags of a problem; None if there are no long paths.

    There are none if there are too many candidates for one fit (`CandidateScreen`).

    camera (zones,): camera of each zone.
    candidates_max: number of candidates beyond which they are screened.
    """
    departures, arrivals, _, zones, *_ = problem
    if CandidateScreen.is_needed(problem, candidates_max):
        return None
    cameras = int(camera.max(initial=0)) + 1
    paths = find_long_paths(departures, arrivals, cameras)
    if not paths:
        return None

    # Range z is that of zone z; the delayed ones follow, path by path.
    of = np.tile(np.arange(zones, dtype=np.int32)[:, None], zones)
    sources = of[:, 0].copy()
    delay = np.zeros(zones)
    for source, target, seconds in paths:
        [source_zones], [target_zones] = (np.nonzero(camera == end) for end in (source, target))
        of[np.ix_(source_zones, target_zones)] = (
            len(sources) + np.arange(len(source_zones))[:, None]
        )
        sources = np.append(sources, source_zones.astype(np.int32))
        delay = np.append(delay, np.full(len(source_zones), seconds))
    return LagRanges(sources, delay, of)
