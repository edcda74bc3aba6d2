"""Long paths: pairs of cameras whose transit time the lag bins of the joint fit do not resolve.

Lag bins are a tenth of the lag wide and end at three minutes, but a path of five minutes that all
objects take within ten seconds stands out of the correlogram of its two cameras
(`clocks.correlogram`). If its clearest peak is at a long lag (`find_long_paths`), the departures
from the first camera are copied and *delayed* by that lag (`delayed`), so that the joint fit covers
the peak. Whether there is a link is decided by the evidence of the fit, as for any other pair.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from camtopod.arrays import Bools, Floats, Ints, rows_by_group
from camtopod.learn.association import Candidates, CandidateScreen, Problem
from camtopod.learn.changes import Change
from camtopod.learn.clocks import (
    LAGS,
    ROWS_AT_ONCE,
    Correlograms,
    Counts,
    cache_friendly_order,
    null_expectation,
)
from camtopod.learn.links import LinkTable
from camtopod.learn.next_camera import Posterior
from camtopod.learn.traffic import Arrivals, Departures

BIN_SECONDS = 1.0
"""Width of the bins of the correlograms."""
LONG_SECONDS_MIN = 60.0
"""Least lag of a long path; the lag bins are fine enough for shorter ones."""
LONG_SECONDS_MAX = 900.0
LONG_SHARE_MAX = 0.25
"""Largest lag of a long path, in seconds and as a share of the duration of the window. The share
ensures that a path is observed more than once.
"""
SHARP_SHARE_MAX = 0.1
"""Largest half width of a peak, as a share of its lag, at lags that have a lag bin."""
WIDTHS_BINS = (5, 11, 25, 61)
"""Widths, in bins, of the windows of lags in which arrivals are counted."""
FALSE_PROBABILITY = 0.01
"""Probability of any false peak on a site without links."""
FALSE_LEGS = 1.0
"""Expected false peaks, on a site without links, among those that may be parts of a longer path.
Used to recognise paths that lead over a camera between (`_is_over`).
"""
SAME_SHARE = 0.1
SAME_SECONDS = 10.0
"""Two paths count as equally long if their lags differ by at most this share of the lag plus this
number of seconds.
"""
HALF_SD_MIN = 1.0
"""Least height of the peak of a long path in each half of the window, in standard deviations. It
ensures that a single coincidence of events does not make a peak.
"""
LONG_PATHS_MAX = 256
"""Largest number of long paths; of more, those with the clearest peaks."""


class LongPath(NamedTuple):
    """A path from the view of camera ``source`` to that of camera ``target``.

    seconds: lag of its peak, about the transit time.
    """

    source: int
    target: int
    seconds: float


def find_long_paths(
    departures: Departures, arrivals: Arrivals, cameras: int, lag_max: float
) -> list[LongPath]:
    """Find the long paths between cameras; return them sorted by source, then target.

    cameras: number of cameras.
    lag_max (seconds): longest lag with a lag bin.
    """
    present = np.intersect1d(departures.camera, arrivals.camera)
    pairs = [(a, b) for a in present.tolist() for b in present.tolist() if a != b]
    if not pairs:
        return []
    source, target = np.array(pairs, np.int32).T

    # The clearest peak of each pair of cameras, from the correlograms of both halves of the window.
    first = min(departures.t[0], arrivals.t[0])
    last = max(departures.t[-1], arrivals.t[-1])
    longest = min(LONG_SECONDS_MAX, LONG_SHARE_MAX * float(last - first))
    middle = 0.5 * (first + last)
    halves = [
        Correlograms(
            (departures.t[half], departures.camera[half]),
            (arrivals.t, arrivals.camera),
            cameras,
            BIN_SECONDS,
        )
        for half in (departures.t < middle, departures.t >= middle)
        if half.any()
    ]
    nats = np.zeros(len(pairs))
    seconds = np.zeros(len(pairs))
    order = cache_friendly_order(source, target, min(half.at_once for half in halves))
    for k in range(0, len(order), ROWS_AT_ONCE):
        part = order[k : k + ROWS_AT_ONCE]
        counts = [half.between(source[part], target[part]) for half in halves]
        nats[part], seconds[part] = clearest_peaks(counts, lag_max, longest)
    false = len(pairs) * max(longest, 1.0) / BIN_SECONDS * np.exp(-nats)

    # The peaks at long lags of paths that do not lead over a camera between.
    lag = np.full((cameras, cameras), np.nan)
    dwell = _usual_dwell_time(departures, cameras)
    is_leg = false < FALSE_LEGS
    lag[source[is_leg], target[is_leg]] = seconds[is_leg]
    far = np.flatnonzero((false < FALSE_PROBABILITY) & (seconds >= LONG_SECONDS_MIN)).tolist()
    far = [k for k in far if not _is_over(lag, dwell, *pairs[k])]
    far = sorted(far, key=lambda k: -nats[k])[:LONG_PATHS_MAX]
    return sorted(LongPath(*pairs[k], float(seconds[k])) for k in far)


def clearest_peaks(counts: list[Counts], lag_max: float, longest: float) -> tuple[Floats, Floats]:
    """Return the evidence (P, nats) for the clearest peak of each pair of cameras, and its lag.

    counts: correlograms (P, lags) of the P pairs of cameras in each half of the window.
    lag_max (seconds): longest lag with a lag bin.
    longest (seconds): largest lag at which peaks are looked for.

    The second result is (P, seconds). The null model is a Poisson process with the local rate. The
    log likelihood ratio is divided by the dispersion at negative lags, at which no transition can
    be.
    """
    lag = np.arange(-LAGS, LAGS + 1) * BIN_SECONDS
    before = lag < -LONG_SECONDS_MIN
    near = np.abs(lag) < LONG_SECONDS_MIN
    usual = [
        np.maximum(null_expectation(half), half.mean(axis=1, keepdims=True)) for half in counts
    ]
    best = np.zeros(len(counts[0]))
    where = np.zeros(len(counts[0]))
    for width in WIDTHS_BINS:
        observed, expected = (
            np.stack(
                [width * uniform_filter1d(half.astype(float), width, axis=1) for half in halves]
            )
            for halves in (counts, usual)
        )
        # The lower height of the two halves, in standard deviations.
        least = ((observed - expected) / np.sqrt(expected)).min(axis=0)

        # Log likelihood ratio of both halves together, corrected for dispersion.
        observed = observed.sum(axis=0)
        expected = expected.sum(axis=0)
        excess = observed - expected
        dispersion = np.maximum(
            np.var((excess / np.sqrt(expected))[:, before], axis=1, keepdims=True), 1.0
        )
        nats = (observed * np.log(np.maximum(observed, 1e-9) / expected) - excess) / dispersion

        # The highest peak, be it at a short lag or at a long one, where both halves must have it.
        sharp = (lag > lag_max) | (width * BIN_SECONDS <= 2 * SHARP_SHARE_MAX * lag)
        far = sharp & (lag > 0) & (lag <= longest)
        peaks = np.where(
            (near & (excess > 0)) | (far & (least >= HALF_SD_MIN * np.sqrt(dispersion))), nats, 0.0
        )
        at = peaks.argmax(axis=1)
        top = peaks[np.arange(len(peaks)), at]
        where = np.where(top > best, lag[at], where)
        best = np.maximum(best, top)
    return best, where


def _usual_dwell_time(departures: Departures, cameras: int) -> Floats:
    """Return the median dwell time in each view (cameras, seconds); 0 where it is unknown."""
    known = np.isfinite(departures.since)
    dwell = (departures.t - departures.since)[known]
    camera = departures.camera[known]
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
    return bool(np.any(ahead & (apart <= SAME_SHARE * lag[source, target] + SAME_SECONDS)))


class Delayed(NamedTuple):
    """The departures of a fit, with a delayed copy of each departure that may begin a long path.

    The copies of a zone's departures belong to a virtual zone in a virtual view; there is one
    virtual view for each long path. From a virtual view, only the camera at the end of the path can
    be reached, and that camera cannot be reached from the original view. So the joint fit needs no
    code for long paths: `links_back`, `changes_back` and `posterior_back` translate its results
    from virtual zones to the real ones.
    """

    departures: Departures
    """All departures in order of time, copies included; ``of`` gives the original of a copy."""
    camera: Ints
    """(zones,) view of each zone, virtual views and zones included."""
    zone: Ints
    """(zones,) the real zone that each zone stands for."""
    seconds: Floats
    """(zones,) seconds by which the departures of each zone are delayed; 0 for real zones."""
    row: NDArray[np.intp]
    """(n,) row of each departure, or of its original, among the departures without copies."""
    reached: Bools
    """(views, views) True if arrivals in the second view may be of departures from the first."""

    def of(self, problem: Problem) -> Problem:
        """Return a problem with the departures replaced by these, copies and zones included."""
        return problem._replace(departures=self.departures, zones=len(self.zone))

    def places(self) -> Iterator[tuple[int, int]]:
        """Return the view of each zone, and the real zone that it stands for."""
        return zip(self.camera.tolist(), self.zone.tolist(), strict=True)

    def among(self, candidates: Candidates, arrivals: Arrivals) -> Candidates:
        """Return the candidates whose arrival's view may be reached from the departure's view."""
        if not self.seconds.any():
            return candidates
        view_left = self.departures.camera[candidates.departure]
        view_reached = arrivals.camera[candidates.arrival]
        return candidates.take(self.reached[view_left, view_reached])

    def overlapping(self, table: Bools) -> Bools:
        """Return a table (views, views) of overlapping views with virtual views included.

        table (cameras, cameras): True where real views overlap.

        A virtual view counts as overlapping: an arrival before a delayed departure is not before
        the exit itself, so it needs no overlap.
        """
        larger = np.ones(self.reached.shape, np.bool_)
        larger[: len(table), : len(table)] = table
        return larger

    def links_back(self, table: LinkTable) -> LinkTable:
        """Return a link table with virtual zones replaced by real ones, sorted by zones."""
        source = self.zone[table.source]
        moved = table._replace(source=source, delay=self.seconds[table.source])
        return moved.rows(np.lexsort((table.target, source)))

    def changes_back(self, changes: list[Change]) -> list[Change]:
        """Return changes of links with virtual zones replaced by real ones, and times undelayed."""
        return [
            change._replace(
                source=int(self.zone[change.source]),
                since=change.since - float(self.seconds[change.source]),
            )
            for change in changes
        ]

    def posterior_back(self, posterior: Posterior, zones: int) -> Posterior:
        """Return a posterior with virtual zones replaced by real ones.

        zones: number of real zones.
        """
        if not self.seconds.any():
            return posterior
        c = posterior.fit.candidates
        candidates = c._replace(departure=self.row[c.departure], source=self.zone[c.source])
        return posterior._replace(
            fit=posterior.fit._replace(
                candidates=candidates, outside=posterior.fit.outside[:zones]
            ),
            leave=posterior.leave[:zones],
            levels=[
                level._replace(zone=self.zone[level.zone].astype(np.int64))
                for level in posterior.levels
            ],
            delay=self.seconds[c.source],
        )


def delayed(departures: Departures, camera: Ints, cameras: int, paths: list[LongPath]) -> Delayed:
    """Add delayed copies for given long paths to the departures of a window.

    camera (zones,): camera of each zone.
    cameras: number of cameras.
    paths: the long paths.
    """
    reached = np.zeros((cameras + len(paths), cameras + len(paths)), np.bool_)
    reached[:cameras, :cameras] = True
    zone = [np.arange(len(camera), dtype=np.int32)]
    view = [camera]
    seconds = [np.zeros(len(camera))]
    row = [np.arange(len(departures.t))]
    copies = [departures]
    number = len(camera)

    for k, path in enumerate(paths, start=cameras):
        reached[path.source, path.target] = False
        reached[k, path.target] = True

        # Virtual zones for the copies.
        zones_of_source = np.flatnonzero(camera == path.source)
        zone.append(zones_of_source.astype(np.int32))
        view.append(np.full(len(zones_of_source), k, np.int32))
        seconds.append(np.full(len(zones_of_source), path.seconds))

        # The copies. No lag is before the exit; slowness is not used, as it would scale only the
        # part of the transit time beyond the delay.
        originals = np.flatnonzero(departures.camera == path.source)
        row.append(originals)
        copies.append(
            Departures(
                t=departures.t[originals] + path.seconds,
                zone=(number + np.searchsorted(zones_of_source, departures.zone[originals])).astype(
                    np.int32
                ),
                camera=np.full(len(originals), k, np.int32),
                since=np.full(len(originals), -np.inf),
                slow=np.full(len(originals), np.nan),
                own=departures.own[originals],
                block=departures.block[originals],
            )
        )
        number += len(zones_of_source)

    columns: list[Any] = [
        np.concatenate(originals) for originals in zip(*(one[:-1] for one in copies), strict=True)
    ]
    order = np.argsort(columns[0], kind="stable")
    rows = np.concatenate(row)[order]
    place = np.argsort(order)
    return Delayed(
        Departures(*(column[order] for column in columns))._replace(
            of=place[rows] if paths else None
        ),
        np.concatenate(view),
        np.concatenate(zone),
        np.concatenate(seconds),
        rows,
        reached,
    )


def with_long_paths(problem: Problem, camera: Ints, cameras: int, candidates_max: int) -> Delayed:
    """Find the long paths, and add delayed copies of departures for them.

    No copies are added on sites that are so large that candidates are screened (`screening`), or if
    the copies would make screening necessary.

    camera (zones,): camera of each zone.
    cameras: number of cameras.
    candidates_max: number of candidates beyond which they are screened.
    """
    departures, arrivals, bins, *_ = problem
    without = delayed(departures, camera, cameras, [])
    if CandidateScreen.is_needed(problem, candidates_max):
        return without
    paths = find_long_paths(departures, arrivals, cameras, bins.lag_max)
    late = delayed(departures, camera, cameras, paths)
    if CandidateScreen.is_needed(late.of(problem), candidates_max):
        return without
    return late
