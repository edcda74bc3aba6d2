"""Views that overlap: who leaves one view, and is seen by another at that moment.

At each exit the passages under way in the views of other cameras are counted, by how much later than this one they
began. Passages of the same object begin after each other by seconds, always alike; those of others come as they come.
What chance gives is counted in the same way with the exits moved by some seconds: rhythms and platoons are the same
then, and nobody meets himself. The rest is the *same object*, as in the cross-correlation of Makris, Ellis and Black
(2004), but of passages that last instead of moments.

Whether two views overlap at all is asked of each half of the time: does what it says foretell the passages of the other
half, both better than chance does and better than the offsets of chance do, however many there are? Platoons alone make
more passages coexist, but not at certain offsets.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.learn.lags import LagBins, smoother
from camtopod.learn.scene import Scene
from camtopod.learn.smoothing import smooth

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]

SHIFTS_SECONDS = (-30.0, -15.0, 15.0, 30.0)
"""The exits are moved by each of these to see what chance gives."""
CHANCE_SD_BINS = 2.8
"""What chance gives is spread over so many bins of offsets."""
CHANCE_MIN = 0.02
"""Least number of passages of others expected in a bin, over all exits."""
NOISE_SD = 0.5
"""What exceeds chance by fewer standard deviations is no passage of the same object."""
STANDS_OUT_SD = 3.0
"""Pairs of cameras whose passages coexist less clearly more often than by chance are not looked at, ..."""
LOOKED_AT_MAX = 16
"""... and of those of a camera no more than so many, the clearest."""
FALSE_PROBABILITY = 0.001
"""Probability that any two cameras of a site are said to overlap though none do, if passages were independent."""
COEXISTING_MAX = 3_000_000
"""Pairs of an exit and a passage under way that are counted: those of the newest exits."""
AT_ONCE = 1 << 18
"""Pairs counted together."""


class Overlapping(NamedTuple):
    """Two views that overlap, by exits from the first. Offsets are how much later a passage began there, in bins."""

    source: int
    """Camera whose view the object leaves ..."""
    target: int
    """... and camera that may see it at that moment."""
    same: Floats
    """(bins,) passages of the same object under way there, for each exit."""
    others: Floats
    """(bins,) passages of others under way there, for each exit."""


class Views(NamedTuple):
    """Passages (n,) of known beginning and end: camera, and both in seconds. In order of ``left``."""

    camera: NDArray[np.int64]
    entered: Floats
    left: Floats


def views_of(scene: Scene) -> Views:
    """The passages of a scene."""
    camera = np.array([zone.camera for zone in scene.zones], np.int64)
    order = np.argsort(scene.passages.left, kind="stable")
    p = scene.passages
    return Views(camera[p.source[order]], p.entered[order], p.left[order])


def find_overlapping(views: Views, cameras: int, bins: LagBins) -> list[Overlapping]:
    """The pairs of cameras whose views overlap, by source and target. ``bins``: of offsets."""
    if len(views.left) == 0:
        return []
    newest = _newest(views, COEXISTING_MAX)

    # Which pairs of cameras have more passages under way at the same time than chance gives?
    everything = np.zeros((cameras, cameras), np.int64)
    seen = _totals(views, newest, 0.0, cameras)
    usual = sum((_totals(views, newest, shift, cameras) for shift in SHIFTS_SECONDS), everything) / len(SHIFTS_SECONDS)
    above = (seen - usual) / np.sqrt(usual + 1.0)
    first = np.argsort(-above, axis=1, kind="stable")[:, :LOOKED_AT_MAX]
    looked = np.zeros_like(above, np.bool_)
    np.put_along_axis(looked, first, np.take_along_axis(above, first, axis=1) > STANDS_OUT_SD, axis=1)
    source, target = np.nonzero(looked)
    if len(source) == 0:
        return []

    # At which offsets do they begin, in each half of the time?
    number = np.full((cameras, cameras), -1)
    number[source, target] = np.arange(len(source))
    middle = (newest + len(views.left)) // 2
    halves = [slice(newest, middle), slice(middle, len(views.left))]
    counted = [_offsets(views, half, 0.0, number, bins) for half in halves]
    by_chance = [
        sum((_offsets(views, half, shift, number, bins) for shift in SHIFTS_SECONDS), np.zeros_like(counted[0]))
        / len(SHIFTS_SECONDS)
        for half in halves
    ]
    exits = [np.bincount(views.camera[half], minlength=cameras)[source][:, None] for half in halves]

    # Does either half foretell the other, better than chance and better than the offsets of chance?
    nats = np.zeros((2, len(source)))
    for here, there in ((0, 1), (1, 0)):
        same, others = _same_and_others(counted[here], by_chance[here])
        expected = same * (exits[there] / np.maximum(exits[here], 1))
        above = np.log1p(same / others)
        more = (others + same).sum(axis=1) / others.sum(axis=1)
        nats[0] += (counted[there] * above).sum(axis=1) - expected.sum(axis=1)
        nats[1] += (counted[there] * (above - np.log(more)[:, None])).sum(axis=1)
    overlap = np.flatnonzero(nats.min(axis=0) > np.log(max(cameras * (cameras - 1), 1) / FALSE_PROBABILITY))

    same, others = _same_and_others(counted[0] + counted[1], by_chance[0] + by_chance[1])
    left = np.maximum(exits[0] + exits[1], 1)
    return [Overlapping(int(source[k]), int(target[k]), same[k] / left[k], others[k] / left[k]) for k in overlap]


def _same_and_others(counted: Floats, by_chance: Floats) -> tuple[Floats, Floats]:
    """Passages (P, bins) of the same object, and of others, of those ``counted`` (P, bins)."""
    others = np.maximum(by_chance @ smoother(by_chance.shape[1], CHANCE_SD_BINS).T, CHANCE_MIN)
    same = smooth(counted)[0] - others - NOISE_SD * np.sqrt(others)
    return np.maximum(same, 0.0), others


def _under_way(views: Views, exits: slice, shift: float) -> Iterator[tuple[Rows, Rows]]:
    """Exits and passages (m,) of other cameras that are under way ``shift`` seconds after them, some at a time."""
    left = views.left[exits]
    first, stop = (np.searchsorted(left, t - shift) for t in (views.entered, views.left))
    reached = np.concatenate(([0], np.cumsum(np.maximum(stop - first, 0))))
    begin = 0
    while begin < len(first):
        end = max(int(np.searchsorted(reached, reached[begin] + AT_ONCE, "right")) - 1, begin + 1)
        n = np.diff(reached[begin : end + 1])
        passage = np.repeat(np.arange(begin, end), n)
        exit_ = np.arange(len(passage)) + np.repeat(first[begin:end] - (np.cumsum(n) - n), n) + exits.start
        other = np.flatnonzero(views.camera[exit_] != views.camera[passage])
        yield exit_[other], passage[other]
        begin = end


def _newest(views: Views, most: int) -> int:
    """The first exit that counts so that at most so many passages are under way at all of them."""
    begun, over = np.sort(views.entered), views.left
    under_way = np.searchsorted(begun, views.left, "right") - np.searchsorted(over, views.left, "right")
    return len(over) - int(np.searchsorted(np.cumsum(np.maximum(under_way, 0)[::-1]), most, "right"))


def _totals(views: Views, newest: int, shift: float, cameras: int) -> NDArray[np.int64]:
    """Pairs (cameras, cameras) of an exit and a passage under way ``shift`` seconds after it."""
    total = np.zeros(cameras * cameras, np.int64)
    for exit_, passage in _under_way(views, slice(newest, len(views.left)), shift):
        total += np.bincount(views.camera[exit_] * cameras + views.camera[passage], minlength=len(total))
    return total.reshape(cameras, cameras)


def _offsets(views: Views, exits: slice, shift: float, number: NDArray[np.int64], bins: LagBins) -> Floats:
    """The same by offset, (P, bins), of the pairs of cameras that have a ``number`` (cameras, cameras), -1: none."""
    pairs = int(number.max()) + 1
    total = np.zeros(pairs * bins.size)
    for exit_, passage in _under_way(views, exits, shift):
        pair = number[views.camera[exit_], views.camera[passage]]
        at = bins.index(views.entered[passage] - shift - views.entered[exit_])
        some = np.flatnonzero((pair >= 0) & (at >= 0))
        total += np.bincount(pair[some] * bins.size + at[some], minlength=len(total))
    return total.reshape(pairs, bins.size)
