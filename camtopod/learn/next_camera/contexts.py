"""What else is known of an object that leaves, and what it says about where it goes.

Where it came in, where exactly it left, and which camera it probably came from before: people and
vehicles have a direction. Each level of context counts departures and transitions and backs off to
the level before it where it has seen little: ``p = (f N + k p') / (f n + k)``, interpolated as in
the language models of Jelinek and Mercer (1980). As nobody is identified, n departures say less
than n; ``f`` is the share of their transitions that is sure (the mean responsibility of a
transition).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Longs, Singles
from camtopod.learn.association import Candidates, together
from camtopod.learn.limits import context_cells_max
from camtopod.learn.traffic import Arrivals, Departures
from camtopod.topology import BACK_OFF_DEPARTURES, MULTIPLIER_MAX

LEVELS = ("entry", "block", "entry+block", "previous")
"""In this order: the zone of entry; the block of the image of the exit; both; the camera before."""
PREVIOUS_RESPONSIBILITY_MIN = 0.02
"""Less likely sources of an arrival are not looked at when it is asked which camera an object came
from.
"""


class Level(NamedTuple):
    """One level: context ``k`` belongs to zone ``zone[k]`` and has the parts ``parts[k]`` (-1: no
    such part).
    """

    zone: Longs
    """(contexts,)"""
    parts: Longs
    """(contexts, 2): zone of entry or camera before, and block."""
    departures: Floats
    """(contexts,) sure departures, f n."""
    first: Longs
    """(contexts + 1,) rows of each context among the following."""
    target: Longs
    """(rows,) zones where departures of a context appear next, ascending ..."""
    transitions: Floats
    """... and how many surely do, f N."""


class Counted(NamedTuple):
    """What is counted of the contexts of one level."""

    keys: Longs
    """(contexts, 3)"""
    departures: Floats
    """(contexts,) sure departures."""
    row: Longs
    """(n,) where the row of the context of each departure begins in ``moved``, were that one row
    ...
    """
    mine: Singles
    """... (n,), how sure the departure itself is in it, ..."""
    scale: Singles
    """... (n,), how sure the context is over the departures in it, those backed off to included,
    ...
    """
    unsure: Singles
    """... and (n,), how unsure it is."""
    moved: Singles
    """(contexts, columns) sure transitions."""

    def of(
        self, departure: NDArray[np.intp], target: Longs, responsibility: Singles
    ) -> tuple[Longs, Singles]:
        """Of some candidates (m,): the cell in ``moved`` and what the candidate itself adds
        there.
        """
        cell = self.row.take(departure)
        cell += target
        own = self.mine.take(departure)
        own *= responsibility
        return cell, own

    def judged(
        self, departure: NDArray[np.intp], cell: Longs, own: Singles, share: Singles
    ) -> Singles:
        """The probabilities of some candidates (m,) by the others of their context; ``share`` (m,)
        without it.
        """
        here = self.moved.take(cell)
        here -= own
        here += BACK_OFF_DEPARTURES * share
        np.maximum(here, 0.0, out=here)
        here *= self.scale.take(departure)
        here += self.unsure.take(departure) * share
        return here


class Contexts:
    """The contexts of all departures of a fit and what the responsibilities say of them."""

    def __init__(
        self, departures: Departures, arrivals: Arrivals, zones: int, cameras: int
    ) -> None:
        self.zones, self.cameras = zones, cameras
        self.departures, self.arrivals = departures, arrivals
        zone, block = departures.zone.astype(np.int64), departures.block.astype(np.int64)
        self._zone = zone
        self.entry = np.where(departures.own >= 0, arrivals.zone[departures.own], -1).astype(
            np.int64
        )
        nothing = np.full(len(zone), -1)
        self._fixed = [
            _numbered(zone, first, second)
            for first, second in ((self.entry, nothing), (nothing, block), (self.entry, block))
        ]
        self._known = [self.entry >= 0, block >= 0, (self.entry >= 0) & (block >= 0)]

    def count(
        self, candidates: Candidates, responsibility: Singles, gone: Floats, leave: Floats
    ) -> tuple[list[Counted], Floats]:
        """What is counted level by level, and the probability of each departure (n,) to leave in
        its context.

        ``leave`` (n,): the same without context; ``gone`` (n,): probability of not having been seen
        again. Each is judged by the others (leave one out).
        """
        c = candidates
        sure = self._sureness(c, responsibility)[self._zone]
        column, width = self._columns(c)
        levels = []
        most = max(context_cells_max(self.cameras) // width, 1)
        for (number, keys), told in self._contexts(c, responsibility):
            number, keys, told = _commonest(number, keys, told, most)
            mine = sure * told
            n = np.bincount(number, mine, minlength=len(keys)).astype(float)
            below = n[number] - mine + BACK_OFF_DEPARTURES
            left = np.bincount(number, mine * gone, minlength=len(keys))
            stays = np.maximum(left[number] - mine * gone + BACK_OFF_DEPARTURES * leave, 0.0)
            leave = told * stays / below + (1.0 - told) * leave
            own, scale, unsure = (
                each.astype(np.float32) for each in (mine, told / below, 1.0 - told)
            )
            moved = np.zeros((len(keys), width), np.float32)
            levels.append(Counted(keys, n, number * width, own, scale, unsure, moved))
        for part in together(c.arrival):
            departure, target = c.departure[part].astype(np.intp), column.take(c.pair[part])
            for level in levels:
                cell, own = level.of(departure, target, responsibility[part])
                np.add.at(level.moved.ravel(), cell, own)
        return levels, leave

    def judged(
        self, candidates: Candidates, responsibility: Singles, share: Floats, levels: list[Counted]
    ) -> Singles:
        """Probability of each candidate (M,) in its context, judged by the others; ``share`` (P,):
        without context.
        """
        c, column = candidates, self._columns(candidates)[0]
        after, without = np.empty(len(c.lag), np.float32), share.astype(np.float32)
        for part in together(c.arrival):
            departure, pair = c.departure[part].astype(np.intp), c.pair[part].astype(np.intp)
            target, here = column.take(pair), without.take(pair)
            for level in levels:
                here = level.judged(
                    departure, *level.of(departure, target, responsibility[part]), here
                )
            after[part] = here
        return after

    def named(self, candidates: Candidates, levels: list[Counted]) -> list[Level]:
        """The levels as they are published."""
        first, result = np.searchsorted(candidates.source, np.arange(self.zones)), []
        for level in levels:
            context, at = np.nonzero(level.moved)
            reached = candidates.target[first[level.keys[context, 0]] + at].astype(np.int64)
            rows = np.searchsorted(context, np.arange(len(level.keys) + 1))
            transitions = level.moved[context, at].astype(float)
            result.append(
                Level(
                    level.keys[:, 0],
                    level.keys[:, 1:],
                    level.departures,
                    rows,
                    reached,
                    transitions,
                )
            )
        return result

    def _columns(self, candidates: Candidates) -> tuple[Longs, int]:
        """Of each zone's pairs, which come by source, the first, the second, ... (P,): the columns
        of the tables of transitions; and how many there are.
        """
        source = candidates.source
        column = np.arange(len(source)) - np.searchsorted(source, np.arange(self.zones))[source]
        return column, int(column.max(initial=0)) + 1

    def _contexts(
        self, candidates: Candidates, responsibility: Singles
    ) -> list[tuple[tuple[Longs, Longs], Floats]]:
        """(Context of each departure, keys of the contexts) and how sure the context is (n,), level
        by level.
        """
        told = [known.astype(float) for known in self._known]
        camera, sure = self._previous(candidates, responsibility)
        present, number = np.unique(
            self._zone * self.cameras + np.maximum(camera, 0), return_inverse=True
        )
        keys = np.column_stack(
            (present // self.cameras, present % self.cameras, np.full(len(present), -1))
        )
        previous = (number.astype(np.int64), keys)
        return list(zip([*self._fixed, previous], [*told, sure], strict=True))

    def _previous(self, candidates: Candidates, responsibility: Singles) -> tuple[Longs, Floats]:
        """Camera each object most probably came from (n,), -1: unknown, and the probability of
        that.
        """
        c, d = candidates, self.departures
        likely = np.flatnonzero(responsibility > PREVIOUS_RESPONSIBILITY_MIN)
        key = c.arrival[likely].astype(np.int64) * self.cameras + d.camera[c.departure[likely]]
        present, number = np.unique(key, return_inverse=True)
        mass = np.bincount(number, responsibility[likely], minlength=len(present))
        arrival, camera = np.divmod(present, self.cameras)
        best, sure = np.full(len(self.arrivals.t) + 1, -1), np.zeros(len(self.arrivals.t) + 1)
        np.maximum.at(sure, arrival, mass)
        most = np.flatnonzero(mass == sure.take(arrival))
        best[arrival[most]] = camera[most]  # where there are several the last stays
        return best[d.own], np.minimum(sure[d.own], 1.0)

    def _sureness(self, candidates: Candidates, responsibility: Singles) -> Floats:
        """Share of the transitions from each zone (zones,) that is sure."""
        squares, all_of = np.zeros(self.zones), np.zeros(self.zones)
        for part in together(candidates.arrival):
            zone, r = (
                self._zone.take(candidates.departure[part]),
                responsibility[part].astype(float),
            )
            np.add.at(squares, zone, r * r)
            np.add.at(all_of, zone, r)
        sure: Floats = squares / np.maximum(all_of, 1e-300)
        return sure


def multipliers(before: Floats, after: Floats) -> Floats:
    """By how much a context raises probabilities."""
    ratio: Floats = np.clip(
        after / np.maximum(before, 1e-300), 1.0 / MULTIPLIER_MAX, MULTIPLIER_MAX
    )
    return ratio


def _commonest(number: Longs, keys: Longs, told: Floats, most: int) -> tuple[Longs, Longs, Floats]:
    """Context number of each departure (n,), the keys and how sure each context is (n,) when at
    most so many contexts count: those of the most departures.
    """
    if len(keys) <= most:
        return number, keys, told
    kept = np.sort(
        np.argsort(-np.bincount(number, told, minlength=len(keys)), kind="stable")[:most]
    )
    renamed = np.full(len(keys), -1)
    renamed[kept] = np.arange(most)
    number = renamed[number]
    return np.maximum(number, 0), keys[kept], told * (number >= 0)


def _numbered(zone: Longs, first: Longs, second: Longs) -> tuple[Longs, Longs]:
    """Context number of each departure (n,) and the keys (contexts, 3) of the contexts."""
    keys, number = np.unique(np.column_stack((zone, first, second)), axis=0, return_inverse=True)
    return number.ravel().astype(np.int64), keys.astype(np.int64)
