"""Overlapping views: which cameras see an object at the moment it leaves another camera's view.

At the moment of each exit, some passages in other views are *open*: begun and not ended. They are
counted by *offset*, the seconds by which the open passage began later than the passage that ends
with the exit. Passages of one object begin at nearly constant offsets. The null model is the same
count with all exits shifted by some seconds, which keeps rhythms and platoons of objects but breaks
identities. The excess over the null model is attributed to passages of the same object. Two views
overlap if the counts of each half of the exits predict the offsets in the other half better than no
overlap does, and better than the null offsets at a higher rate, which platoons alone produce.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Longs, Rows, ranges_in_parts
from camtopod.learn.association import CANDIDATES_AT_ONCE
from camtopod.learn.lags import CLEAR_NOISE_SD, FALSE_PROBABILITY, NOISE_SD, excess_sd
from camtopod.learn.limits import EVENT_PAIRS_MAX
from camtopod.learn.links import NEXT_ZONES_MAX
from camtopod.learn.traffic import Departures
from camtopod.topology import SMOOTHING_SD_BINS, LagBins, lag_smoothing_matrix, smooth

SHIFTS_SECONDS = (-30.0, -15.0, 15.0, 30.0)
"""Shifts of the exits that make up the null model, seconds."""
NULL_SD_BINS = SMOOTHING_SD_BINS[-1][1]
"""Standard deviation of the Gaussian that smooths the null model, in bins of offset: as wide as for
the fewest transitions.
"""
NULL_MIN = 0.02
"""Least number of passages that the null model expects in a bin, over all exits."""


class OverlappingViews(NamedTuple):
    """Two overlapping views: an object that leaves the first may be in the second at that time."""

    source: int
    """Index of the camera whose view the object leaves."""
    target: int
    """Index of the camera that may see the object at that moment."""
    same_object: Floats
    """(bins,) mean number, per exit, of open passages of the same object, by offset."""
    other_objects: Floats
    """(bins,) mean number, per exit, of open passages of other objects, by offset."""


def overlap_table(overlaps: list[OverlappingViews], cameras: int) -> NDArray[np.bool_]:
    """Return a table (cameras, cameras) with True for [source, target] of each overlap."""
    table = np.zeros((cameras, cameras), np.bool_)
    for overlap in overlaps:
        table[overlap.source, overlap.target] = True
    return table


def find_overlapping(passages: Departures, cameras: int, bins: LagBins) -> list[OverlappingViews]:
    """Find the overlapping pairs of views; return them sorted by source, then target.

    passages: the departures that end a passage of known entry (`Departures.passages`).
    cameras: number of cameras.
    bins: bins of the offsets (`offset_bins`).
    """
    if len(passages.t) == 0:
        return []
    newest = _newest(passages, EVENT_PAIRS_MAX)
    end = len(passages.t)

    # Select the pairs of cameras with more open passages than under the null model.
    open_seen = _totals(passages, slice(newest, end), 0.0, cameras)
    open_null = _shifted(lambda shift: _totals(passages, slice(newest, end), shift, cameras))
    source, target = _screened(excess_sd(open_seen, open_null))
    if len(source) == 0:
        return []

    # Count by offset, in each half of the exits.
    number = np.full((cameras, cameras), -1)
    number[source, target] = np.arange(len(source))
    middle = (newest + end) // 2
    first, second = (
        _count(passages, half, number, bins) for half in (slice(newest, middle), slice(middle, end))
    )
    exits = [
        np.bincount(passages.camera[half], minlength=cameras)
        for half in (slice(newest, middle), slice(middle, end))
    ]
    ratio = exits[1][source] / np.maximum(exits[0][source], 1)

    # Test each half on the other.
    nats = _predicts(first, second, ratio) + _predicts(second, first, 1.0 / np.maximum(ratio, 1e-9))
    least = np.log(max(cameras * (cameras - 1), 1) / FALSE_PROBABILITY)
    overlap = np.flatnonzero(nats.min(axis=0) > least)

    # Estimate the offsets from both halves.
    same_object, other_objects = _Counted(
        first.counts + second.counts, first.null + second.null
    ).split()
    exits_of_source = np.maximum(exits[0] + exits[1], 1)[source]
    return [
        OverlappingViews(
            int(source[k]),
            int(target[k]),
            same_object[k] / exits_of_source[k],
            other_objects[k] / exits_of_source[k],
        )
        for k in overlap
    ]


class _Counted(NamedTuple):
    """Open passages at the exits of P pairs of cameras, counted by offset.

    counts (P, bins): observed counts.
    null (P, bins): counts under the null model.
    """

    counts: Floats
    null: Floats

    def split(self) -> tuple[Floats, Floats]:
        """Return the parts of the counts of the same and of other objects, (P, bins) each."""
        other_objects = np.maximum(
            self.null @ lag_smoothing_matrix(self.null.shape[1], NULL_SD_BINS).T, NULL_MIN
        )
        same_object = smooth(self.counts)[0] - other_objects - NOISE_SD * np.sqrt(other_objects)
        return np.maximum(same_object, 0.0), other_objects


def _predicts(training_counts: _Counted, test_counts: _Counted, ratio: Floats) -> Floats:
    """Return the log likelihood ratios of counts as predicted from other counts, (2, P), nats.

    training_counts: counts of one half of the exits, from which the prediction is made.
    test_counts: counts of the other half.
    ratio (P,): number of exits of the other half over that of the first.

    The two rows are against the two null models: no overlap, and more open passages than expected
    at the offsets of no overlap.
    """
    same_object, other_objects = training_counts.split()
    weight = np.log1p(same_object / other_objects)
    no_overlap = (test_counts.counts * weight).sum(axis=1) - same_object.sum(axis=1) * ratio
    excess = np.log1p(same_object.sum(axis=1) / other_objects.sum(axis=1))
    null_offsets = (test_counts.counts * (weight - excess[:, None])).sum(axis=1)
    return np.stack([no_overlap, null_offsets])


def _screened(excess: Floats) -> tuple[Rows, Rows]:
    """Return the sources and the targets of the P pairs of cameras to be tested, (P,) each.

    excess (cameras, cameras): excess of open passages over the null model in standard deviations,
        by camera of the exit and camera of the passage.
    """
    largest = np.argsort(-excess, axis=1, kind="stable")[:, :NEXT_ZONES_MAX]
    mask = np.zeros(excess.shape, np.bool_)
    np.put_along_axis(
        mask, largest, np.take_along_axis(excess, largest, axis=1) > CLEAR_NOISE_SD, axis=1
    )
    source, target = np.nonzero(mask)
    return source, target


def _shifted(count: Callable[[float], NDArray[Any]]) -> Floats:
    """Return the mean of a count over `SHIFTS_SECONDS`, which is the null model.

    count: function from a shift in seconds to the counts.
    """
    mean: Floats = np.mean([count(shift) for shift in SHIFTS_SECONDS], axis=0)
    return mean


def _open(passages: Departures, exits: slice, shift: float) -> Iterator[tuple[Rows, Rows]]:
    """Yield pairs of an exit and a passage that is open after it, part by part.

    exits: slice of the passages whose exits are used.
    shift: seconds after the exit at which the passage is open.

    Each part has about `CANDIDATES_AT_ONCE` pairs, as two arrays of rows of ``passages``. A passage
    is open from its entry to its exit.
    """
    exit_times = passages.t[exits]
    first, stop = (np.searchsorted(exit_times, t - shift) for t in (passages.since, passages.t))
    pairs = ranges_in_parts(first, np.maximum(stop - first, 0), CANDIDATES_AT_ONCE)
    for passage, at in pairs:
        yield at + exits.start, passage


def _newest(passages: Departures, pairs_max: int) -> int:
    """Return the row of the oldest exit that is counted.

    From this exit on, the numbers of open passages, added up over the exits, are ``pairs_max`` at
    most.
    """
    starts = np.searchsorted(np.sort(passages.since), passages.t, "right")
    over = np.searchsorted(passages.t, passages.t, "right")
    open_ = np.maximum(starts - over, 0)
    return len(open_) - int(np.searchsorted(np.cumsum(open_[::-1]), pairs_max, "right"))


def _totals(passages: Departures, exits: slice, shift: float, cameras: int) -> Longs:
    """Return the number of passages open ``shift`` seconds after an exit, (cameras, cameras).

    The result is by camera of the exit and camera of the open passage, added up over ``exits``; 0
    for a camera and itself.
    """
    total = np.zeros(cameras * cameras, np.int64)
    for exit_, passage in _open(passages, exits, shift):
        np.add.at(total, passages.camera[exit_] * cameras + passages.camera[passage], 1)
    result = total.reshape(cameras, cameras)
    np.fill_diagonal(result, 0)
    return result


def _count(passages: Departures, exits: slice, number: Longs, bins: LagBins) -> _Counted:
    """Count open passages by offset, for some pairs of cameras.

    exits: slice of the passages whose exits are used.
    number (cameras, cameras): row in the result of each pair (camera of the exit, camera of the
        passage); -1 for pairs that are not counted.
    """
    return _Counted(
        _offsets(passages, exits, 0.0, number, bins),
        _shifted(lambda shift: _offsets(passages, exits, shift, number, bins)),
    )


def _offsets(
    passages: Departures, exits: slice, shift: float, number: Longs, bins: LagBins
) -> Floats:
    """Return the number of passages open ``shift`` seconds after an exit, by offset, (P, bins).

    number (cameras, cameras): as for `_count`.
    """
    pairs = int(number.max()) + 1
    total = np.zeros(pairs * bins.size)
    flat = number.ravel()
    for exit_, passage in _open(passages, exits, shift):
        pair = flat.take(passages.camera[exit_] * len(number) + passages.camera[passage])
        rows = np.flatnonzero(pair >= 0)
        exit_, passage, pair = exit_[rows], passage[rows], pair[rows]
        at = bins.index(passages.since[passage] - shift - passages.since[exit_])
        inside = at >= 0
        total += np.bincount(pair[inside] * bins.size + at[inside], minlength=len(total))
    return total.reshape(pairs, bins.size)
