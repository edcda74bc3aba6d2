"""Overlapping views: which cameras see an object at the moment it leaves the view of another.

At each exit the passages that are open in other views are counted by *offset*: the seconds by which
they began later than the passage that ends. Passages of one object begin at nearly constant
offsets. The null model is the same count with all exits shifted by some seconds, which keeps
rhythms and platoons and breaks identities. What exceeds it is attributed to the same object. This
is the cross-correlation of Makris, Ellis and Black (2004), for intervals instead of instants.

A pair of views overlaps if each half of the exits predicts the offsets of the other half better
than two null models: no overlap at all, and passages that coexist more often than expected but at
the null model's offsets. Platoons alone produce the second.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Longs, Rows
from camtopod.learn.traffic import Scene
from camtopod.topology import LagBins, lag_smoothing_matrix, smooth

SHIFTS_SECONDS = (-30.0, -15.0, 15.0, 30.0)
"""Shifts of the exits that make up the null model, seconds."""
NULL_SD_BINS = 2.8
"""Standard deviation of the Gaussian that smooths the null model, in bins of offset."""
NULL_MIN = 0.02
"""Least number of passages that the null model expects in a bin, over all exits."""
NOISE_SD = 0.5
"""An excess over the null model counts from this many standard deviations on."""
SCREENED_SD = 3.0
"""Pairs of cameras are tested if their open passages exceed the null model by this many standard
deviations.
"""
SCREENED_PER_CAMERA_MAX = 16
"""Pairs tested for each camera that is left: those with the largest excess."""
FALSE_PROBABILITY = 0.001
"""Probability of any false overlap on a site without overlaps, if passages were independent."""
OPEN_PAIRS_MAX = 3_000_000
"""Pairs of an exit and an open passage that are counted, those of the newest exits."""
OPEN_PAIRS_AT_ONCE = 1 << 18
"""Pairs that are in memory at one time."""


class OverlappingViews(NamedTuple):
    """Two overlapping views."""

    source: int
    """Camera whose view the object leaves."""
    target: int
    """Camera that may see the object at that moment."""
    same: Floats
    """(bins,) open passages of the same object for each exit, by offset."""
    others: Floats
    """(bins,) open passages of other objects for each exit, by offset."""


def overlap_table(overlapping: list[OverlappingViews], cameras: int) -> NDArray[np.bool_]:
    """Return whether objects leaving one camera's view are seen by another, (cameras, cameras)."""
    table = np.zeros((cameras, cameras), np.bool_)
    for one in overlapping:
        table[one.source, one.target] = True
    return table


class Views(NamedTuple):
    """Passages (n,) with a known entry and exit, in order of ``left``; times in seconds."""

    camera: Longs
    entered: Floats
    left: Floats


def views_of(scene: Scene) -> Views:
    """Return the passages of a scene in order of their exits."""
    camera = np.array([zone.camera for zone in scene.zones], np.int64)
    order = np.argsort(scene.passages.left, kind="stable")
    p = scene.passages
    return Views(camera[p.source[order]], p.entered[order], p.left[order])


def find_overlapping(views: Views, cameras: int, bins: LagBins) -> list[OverlappingViews]:
    """Return the overlapping pairs of views, sorted by source, then target.

    cameras: number of cameras.
    bins: bins of offsets (`offset_bins`).
    """
    if len(views.left) == 0:
        return []
    newest, end = _newest(views, OPEN_PAIRS_MAX), len(views.left)

    # Screen the pairs of cameras by how many passages are open.
    seen = _totals(views, slice(newest, end), 0.0, cameras)
    null = _shifted(lambda shift: _totals(views, slice(newest, end), shift, cameras))
    source, target = _screened((seen - null) / np.sqrt(null + 1.0))
    if len(source) == 0:
        return []

    # Count by offset, in each half of the exits.
    number = np.full((cameras, cameras), -1)
    number[source, target] = np.arange(len(source))
    middle = (newest + end) // 2
    first, second = (
        _count(views, half, number, bins) for half in (slice(newest, middle), slice(middle, end))
    )
    exits = [
        np.bincount(views.camera[half], minlength=cameras)
        for half in (slice(newest, middle), slice(middle, end))
    ]
    ratio = exits[1][source] / np.maximum(exits[0][source], 1)

    # Test each half on the other.
    nats = _predicts(first, second, ratio) + _predicts(second, first, 1.0 / np.maximum(ratio, 1e-9))
    least = np.log(max(cameras * (cameras - 1), 1) / FALSE_PROBABILITY)
    overlap = np.flatnonzero(nats.min(axis=0) > least)

    # Estimate the offsets from both halves.
    same, others = _Counted(first.seen + second.seen, first.null + second.null).split()
    left = np.maximum(exits[0] + exits[1], 1)[source]
    return [
        OverlappingViews(int(source[k]), int(target[k]), same[k] / left[k], others[k] / left[k])
        for k in overlap
    ]


class _Counted(NamedTuple):
    """Counts (P, bins) of open passages of some pairs of cameras, by offset."""

    seen: Floats
    null: Floats
    """The counts that the null model expects."""

    def split(self) -> tuple[Floats, Floats]:
        """Return the counts of the same object and those of other objects, (P, bins) each."""
        others = np.maximum(
            self.null @ lag_smoothing_matrix(self.null.shape[1], NULL_SD_BINS).T, NULL_MIN
        )
        same = smooth(self.seen)[0] - others - NOISE_SD * np.sqrt(others)
        return np.maximum(same, 0.0), others


def _predicts(known: _Counted, judged: _Counted, ratio: Floats) -> Floats:
    """Return log likelihood ratios (2, P) in nats of ``judged`` as predicted from ``known``.

    The two rows are against the two null models: no overlap, and the null model's offsets.

    ratio (P,): number of judged exits for each known exit.
    """
    same, others = known.split()
    weight = np.log1p(same / others)
    no_overlap = (judged.seen * weight).sum(axis=1) - same.sum(axis=1) * ratio
    excess = np.log1p(same.sum(axis=1) / others.sum(axis=1))
    null_offsets = (judged.seen * (weight - excess[:, None])).sum(axis=1)
    return np.stack([no_overlap, null_offsets])


def _screened(excess: Floats) -> tuple[Rows, Rows]:
    """Return the sources and targets (P,) of the pairs worth a test.

    excess (cameras, cameras): excess over the null model in standard deviations.
    """
    largest = np.argsort(-excess, axis=1, kind="stable")[:, :SCREENED_PER_CAMERA_MAX]
    kept = np.zeros(excess.shape, np.bool_)
    np.put_along_axis(
        kept, largest, np.take_along_axis(excess, largest, axis=1) > SCREENED_SD, axis=1
    )
    source, target = np.nonzero(kept)
    return source, target


def _shifted(count: Callable[[float], NDArray[Any]]) -> Floats:
    """Return the null model of a count: its mean over the shifts."""
    mean: Floats = np.mean([count(shift) for shift in SHIFTS_SECONDS], axis=0)
    return mean


def _open(views: Views, exits: slice, shift: float) -> Iterator[tuple[Rows, Rows]]:
    """Yield exits and the passages (m,) of other cameras that are open ``shift`` seconds later.

    A passage is open from its entry to its exit. Pairs come in parts of `OPEN_PAIRS_AT_ONCE`.
    """
    left = views.left[exits]
    first, stop = (np.searchsorted(left, t - shift) for t in (views.entered, views.left))
    reached = np.concatenate(([0], np.cumsum(np.maximum(stop - first, 0))))

    # As many passages at a time as memory allows.
    begin = 0
    while begin < len(first):
        end = max(
            int(np.searchsorted(reached, reached[begin] + OPEN_PAIRS_AT_ONCE, "right")) - 1,
            begin + 1,
        )
        n = np.diff(reached[begin : end + 1])
        passage = np.repeat(np.arange(begin, end), n)
        exit_ = (
            np.arange(len(passage))
            + np.repeat(first[begin:end] - (np.cumsum(n) - n), n)
            + exits.start
        )
        other = np.flatnonzero(views.camera[exit_] != views.camera[passage])
        yield exit_[other], passage[other]
        begin = end


def _newest(views: Views, most: int) -> int:
    """Return the row of the oldest exit that is counted.

    From there on, at most ``most`` passages are open, added up over the exits.
    """
    begun = np.searchsorted(np.sort(views.entered), views.left, "right")
    over = np.searchsorted(views.left, views.left, "right")
    open_ = np.maximum(begun - over, 0)
    return len(open_) - int(np.searchsorted(np.cumsum(open_[::-1]), most, "right"))


def _totals(views: Views, exits: slice, shift: float, cameras: int) -> Longs:
    """Return the number of open passages by camera of the exit and camera of the passage.

    A passage is counted if it is open ``shift`` seconds after the exit; the result is (cameras,
    cameras).
    """
    total = np.zeros(cameras * cameras, np.int64)
    for exit_, passage in _open(views, exits, shift):
        total += np.bincount(
            views.camera[exit_] * cameras + views.camera[passage], minlength=len(total)
        )
    return total.reshape(cameras, cameras)


def _count(views: Views, exits: slice, number: Longs, bins: LagBins) -> _Counted:
    """Return the counts by offset of the numbered pairs of cameras.

    number (cameras, cameras): row of each pair in the result, -1 for none.
    """
    return _Counted(
        _offsets(views, exits, 0.0, number, bins),
        _shifted(lambda shift: _offsets(views, exits, shift, number, bins)),
    )


def _offsets(views: Views, exits: slice, shift: float, number: Longs, bins: LagBins) -> Floats:
    """Return the passages open ``shift`` seconds after an exit, by pair and offset, (P, bins).

    number (cameras, cameras): row of each pair in the result, -1 for none.
    """
    pairs = int(number.max()) + 1
    total = np.zeros(pairs * bins.size)
    for exit_, passage in _open(views, exits, shift):
        pair = number[views.camera[exit_], views.camera[passage]]
        at = bins.index(views.entered[passage] - shift - views.entered[exit_])
        some = np.flatnonzero((pair >= 0) & (at >= 0))
        total += np.bincount(pair[some] * bins.size + at[some], minlength=len(total))
    return total.reshape(pairs, bins.size)
