"""Long ways: pairs of cameras with a transit time that the lag bins are too coarse or too short
for.

Lag bins are a tenth of the lag wide and end at three minutes. A way of five minutes that all take
within ten seconds has no bin, and one of two minutes drowns in the traffic of a bin of twelve
seconds. Such ways stand out of the correlogram of their two cameras, though. So each ordered pair
of cameras is looked at in bins of a second, over a quarter of an hour, and where its clearest peak
is far away, the joint fit is to look there: the departures are *delayed* by the lag of the peak,
and lags are measured from the delayed departures. A peak is only a candidate: whether there is a
link is decided by the evidence of the fit, as for any other pair.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from camtopod.arrays import Bools, Floats, Ints, rows_by_group
from camtopod.learn.association import Candidates, CandidateScreen
from camtopod.learn.changes import Change
from camtopod.learn.clocks import (
    LAGS,
    ROWS_AT_ONCE,
    Counts,
    cache_friendly_order,
    correlograms,
    null_expectation,
)
from camtopod.learn.links import LinkTable
from camtopod.learn.next_camera import Posterior
from camtopod.learn.traffic import Arrivals, Departures
from camtopod.topology import LagBins

BIN_SECONDS = 1.0
LONG_SECONDS_MIN = 60.0
"""Peaks at shorter lags are left to the lag bins, which are fine enough there."""
LONG_SECONDS_MAX, LONG_SHARE_MAX = 900.0, 0.25
"""Longest lag that is looked at, and its share of the time that was recorded: what happens once is
no rule.
"""
SHARP_SHARE_MAX = 0.1
"""Below the longest lag that has a bin, a peak must be narrower than this share of its lag."""
WIDTHS_BINS = (5, 11, 25, 61)
"""Widths of the windows in which arrivals are counted."""
FALSE_PROBABILITY = 0.01
"""Probability of any false peak on a site where cameras have nothing to do with each other."""
FALSE_LEGS = 1.0
"""The false peaks on such a site, where it is asked whether a way leads over a camera between."""
SAME_SHARE, SAME_SECONDS = 0.1, 10.0
"""Two ways count as equally long if their lags differ by at most this share of the lag plus these
seconds.
"""
HALF_SD_MIN = 1.0
"""Least height of a far peak in each half of the recording, in standard deviations: a single event
makes no way.
"""
LONG_PATHS_MAX = 256
"""Ways that are looked for, the clearest."""


class LongPath(NamedTuple):
    """Objects that leave the view of camera ``source`` appear in that of ``target`` about
    ``seconds`` later.
    """

    source: int
    target: int
    seconds: float


def find_long_paths(
    departures: Departures, arrivals: Arrivals, cameras: int, lag_max: float
) -> list[LongPath]:
    """The long ways between ``cameras`` views, by source, then target; ``lag_max``: longest lag
    with a bin, seconds.
    """
    present = np.intersect1d(departures.camera, arrivals.camera)
    pairs = [(a, b) for a in present.tolist() for b in present.tolist() if a != b]
    if not pairs:
        return []
    source, target = np.array(pairs, np.int32).T

    # The clearest peak of each pair of cameras.
    first, last = min(departures.t[0], arrivals.t[0]), max(departures.t[-1], arrivals.t[-1])
    longest, middle = (
        min(LONG_SECONDS_MAX, LONG_SHARE_MAX * float(last - first)),
        0.5 * (first + last),
    )
    halves = [
        correlograms(
            (departures.t[half], departures.camera[half]),
            (arrivals.t, arrivals.camera),
            cameras,
            BIN_SECONDS,
        )
        for half in (departures.t < middle, departures.t >= middle)
        if half.any()
    ]
    nats, seconds = np.zeros(len(pairs)), np.zeros(len(pairs))
    order = cache_friendly_order(source, target, min(half.at_once for half in halves))
    for k in range(0, len(order), ROWS_AT_ONCE):
        some = order[k : k + ROWS_AT_ONCE]
        counts = [half.correlograms_of(source[some], target[some]) for half in halves]
        nats[some], seconds[some] = clearest_peaks(counts, lag_max, longest)
    false = len(pairs) * max(longest, 1.0) / BIN_SECONDS * np.exp(-nats)

    # Those that are far away, and do not lead over a camera between.
    lag, stay = np.full((cameras, cameras), np.nan), _usual_stay(departures, cameras)
    leg = false < FALSE_LEGS
    lag[source[leg], target[leg]] = seconds[leg]
    far = np.flatnonzero((false < FALSE_PROBABILITY) & (seconds >= LONG_SECONDS_MIN)).tolist()
    far = [k for k in far if not _is_over(lag, stay, *pairs[k])]
    far = sorted(far, key=lambda k: -nats[k])[:LONG_PATHS_MAX]
    return sorted(LongPath(*pairs[k], float(seconds[k])) for k in far)


def clearest_peaks(counts: list[Counts], lag_max: float, longest: float) -> tuple[Floats, Floats]:
    """How clear, in nats, the clearest peak of each correlogram (P, lags) is, and where, in
    seconds; (P,) each. There is a correlogram of each half of the time. Beyond ``lag_max`` seconds
    there is no lag bin, beyond the ``longest`` nothing is looked at.

    The null model is a Poisson process with the local rate, its log likelihood ratio divided by the
    dispersion that the negative lags show, where nothing that left can have arrived.
    """
    lag = np.arange(-LAGS, LAGS + 1) * BIN_SECONDS
    before, near = lag < -LONG_SECONDS_MIN, np.abs(lag) < LONG_SECONDS_MIN
    usual = [
        np.maximum(null_expectation(half), half.mean(axis=1, keepdims=True)) for half in counts
    ]
    best, where = np.zeros(len(counts[0])), np.zeros(len(counts[0]))
    for width in WIDTHS_BINS:
        seen, expected = (
            np.stack(
                [width * uniform_filter1d(half.astype(float), width, axis=1) for half in halves]
            )
            for halves in (counts, usual)
        )
        least = ((seen - expected) / np.sqrt(expected)).min(
            axis=0
        )  # of the halves, in standard deviations
        seen, expected = seen.sum(axis=0), expected.sum(axis=0)
        apart = seen - expected
        dispersion = np.maximum(
            np.var((apart / np.sqrt(expected))[:, before], axis=1, keepdims=True), 1.0
        )
        nats = (seen * np.log(np.maximum(seen, 1e-9) / expected) - apart) / dispersion

        sharp = (lag > lag_max) | (width * BIN_SECONDS <= 2 * SHARP_SHARE_MAX * lag)
        far = sharp & (lag > 0) & (lag <= longest)
        peaks = np.where(
            (near & (apart > 0)) | (far & (least >= HALF_SD_MIN * np.sqrt(dispersion))), nats, 0.0
        )
        at = peaks.argmax(axis=1)
        top = peaks[np.arange(len(peaks)), at]
        where = np.where(top > best, lag[at], where)
        best = np.maximum(best, top)
    return best, where


def _usual_stay(departures: Departures, cameras: int) -> Floats:
    """Median seconds of the passages through each view, (cameras,); 0 where they are not known."""
    known = np.isfinite(departures.since)
    stay, camera = (departures.t - departures.since)[known], departures.camera[known]
    return np.array(
        [np.median(stay[rows]) if len(rows) else 0.0 for rows in rows_by_group(camera, cameras)]
    )


def _is_over(lag: Floats, stay: Floats, source: int, target: int) -> bool:
    """Whether the way between two cameras is as long as that over another: by the ``lag`` (cameras,
    cameras) from each to each, nan without a way, and the ``stay`` (cameras,) in each view,
    seconds.
    """
    over = lag[source] + stay + lag[:, target]
    ahead = (lag[source] > 0) & (lag[:, target] > 0)
    apart = np.abs(over - lag[source, target])
    return bool(np.any(ahead & (apart <= SAME_SHARE * lag[source, target] + SAME_SECONDS)))


class Delayed(NamedTuple):
    """The departures of a fit, with a delayed copy of each departure that a long way may start
    from.

    The copies of a zone's departures belong to a virtual zone in a virtual view. Only the camera at
    the end of the long way is reached from there, and that camera is not reached from the zone
    itself. So the joint fit needs to know nothing of long ways; the methods named `back` translate
    what it finds to real zones.
    """

    departures: Departures
    camera: Ints
    """(zones,) view of each zone, virtual ones included."""
    zone: Ints
    """(zones,) the real zone that each zone stands for."""
    seconds: Floats
    """(zones,) by which its departures are delayed."""
    row: NDArray[np.intp]
    """(n,) of each departure, its row among the departures without copies."""
    reached: Bools
    """(cameras, cameras) whether arrivals at the second may be of departures from the first."""

    def places(self) -> Iterator[tuple[int, int]]:
        """View of each zone, and the real zone that it stands for."""
        return zip(self.camera.tolist(), self.zone.tolist(), strict=True)

    def among(self, candidates: Candidates, arrivals: Arrivals) -> Candidates:
        """The ``candidates`` whose arrival's camera is reached from the departure's."""
        if not self.seconds.any():
            return candidates
        left, came = (
            self.departures.camera[candidates.departure],
            arrivals.camera[candidates.arrival],
        )
        return candidates.take(self.reached[left, came])

    def overlapping(self, table: Bools) -> Bools:
        """The ``table`` (cameras, cameras) of overlapping views, virtual views included: an arrival
        ahead of a delayed departure is not ahead of the exit, and needs no overlap.
        """
        larger = np.ones(self.reached.shape, np.bool_)
        larger[: len(table), : len(table)] = table
        return larger

    def links_back(self, table: LinkTable) -> LinkTable:
        """The ``table`` by real zones."""
        source = self.zone[table.source]
        moved = table._replace(source=source, delay=self.seconds[table.source])
        return moved.rows(np.lexsort((table.target, source)))

    def changes_back(self, changes: list[Change]) -> list[Change]:
        """The ``changes`` by real zones."""
        return [
            change._replace(
                source=int(self.zone[change.source]),
                since=change.since - float(self.seconds[change.source]),
            )
            for change in changes
        ]

    def posterior_back(self, posterior: Posterior, zones: int) -> Posterior:
        """The ``posterior`` by the ``zones`` real zones."""
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


def delayed(departures: Departures, camera: Ints, cameras: int, ways: list[LongPath]) -> Delayed:
    """The ``departures`` with delayed copies for the long ``ways``; ``camera`` (zones,): view of
    each zone, a number below ``cameras``.
    """
    reached = np.zeros((cameras + len(ways), cameras + len(ways)), np.bool_)
    reached[:cameras, :cameras] = True
    zone, view, seconds = (
        [np.arange(len(camera), dtype=np.int32)],
        [camera],
        [np.zeros(len(camera))],
    )
    row, copies, number = [np.arange(len(departures.t))], [departures], len(camera)

    for k, way in enumerate(ways, start=cameras):
        reached[way.source, way.target], reached[k, way.target] = False, True

        # Virtual zones for the copies.
        mine = np.flatnonzero(camera == way.source)
        zone.append(mine.astype(np.int32))
        view.append(np.full(len(mine), k, np.int32))
        seconds.append(np.full(len(mine), way.seconds))

        # The copies: no lag is before the exit, and pace says nothing of the rest of the way.
        some = np.flatnonzero(departures.camera == way.source)
        row.append(some)
        copies.append(
            Departures(
                t=departures.t[some] + way.seconds,
                zone=(number + np.searchsorted(mine, departures.zone[some])).astype(np.int32),
                camera=np.full(len(some), k, np.int32),
                since=np.full(len(some), -np.inf),
                slow=np.full(len(some), np.nan),
                own=departures.own[some],
                block=departures.block[some],
            )
        )
        number += len(mine)

    columns: list[Any] = [
        np.concatenate(some) for some in zip(*(one[:-1] for one in copies), strict=True)
    ]
    order = np.argsort(columns[0], kind="stable")
    rows, place = np.concatenate(row)[order], np.argsort(order)
    return Delayed(
        Departures(*(column[order] for column in columns))._replace(
            of=place[rows] if ways else None
        ),
        np.concatenate(view),
        np.concatenate(zone),
        np.concatenate(seconds),
        rows,
        reached,
    )


def with_long_paths(
    departures: Departures,
    arrivals: Arrivals,
    camera: Ints,
    cameras: int,
    bins: LagBins,
    candidates_max: int,
) -> Delayed:
    """The ``departures`` with delayed copies for the long ways that are found; without any where
    the candidates would have to be screened (`screening`). ``camera`` (zones,): as of `delayed`.
    """
    without = delayed(departures, camera, cameras, [])
    if CandidateScreen.is_needed(departures, arrivals, bins, len(camera), candidates_max):
        return without
    late = delayed(
        departures, camera, cameras, find_long_paths(departures, arrivals, cameras, bins.lag_max)
    )
    return (
        without
        if CandidateScreen.is_needed(
            late.departures, arrivals, bins, len(late.zone), candidates_max
        )
        else late
    )
