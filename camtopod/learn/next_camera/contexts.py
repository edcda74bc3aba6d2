"""Contexts of a departure: what else is known of the object, and where such objects appear next.

People and vehicles have a direction. So departures are told apart by the zone where the passage
began, the exact place of the exit and the camera that the object probably came from. Each level of
context counts departures and transitions, and backs off to the level before it where counts are
small: ``p = (f N + k p') / (f n + k)``, the interpolation of the language models of Jelinek and
Mercer (1980). Here n is the number of departures in the context, N that of their transitions to a
zone, p' the probability at the level before, and k is `BACK_OFF_DEPARTURES`. As no object is
identified, n departures carry less information than n tracked ones; ``f`` is the certain share of
their transitions (the mean responsibility of a transition).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.arrays import Floats, Longs, Singles
from camtopod.learn.association import Candidates, slices_by_arrival
from camtopod.learn.limits import context_cells_max
from camtopod.learn.traffic import Arrivals, Departures
from camtopod.topology import BACK_OFF_DEPARTURES, MULTIPLIER_MAX

LEVELS = ("entry", "block", "entry+block", "previous")
"""Levels of context; each backs off to the one before. ``block``: image block of the exit."""
PREVIOUS_RESPONSIBILITY_MIN = 0.02
"""Candidates with a smaller responsibility are ignored when the previous camera is determined."""


class ContextLevel(NamedTuple):
    """One level of context, as it is published."""

    zone: Longs
    """(contexts,) zone of departure."""
    parts: Longs
    """(contexts, 2): zone of entry or previous camera, and image block; -1 for neither."""
    departures: Floats
    """(contexts,) certain departures, f n."""
    first: Longs
    """(contexts + 1,) where the rows of each context begin in ``target`` and ``transitions``."""
    target: Longs
    """(rows,) zones where departures of a context appear next, ascending within the context."""
    transitions: Floats
    """(rows,) certain transitions to that zone, f N."""


class ContextCounts(NamedTuple):
    """Counts of one level of context, in a form for leave-one-out probabilities."""

    keys: Longs
    """(contexts, 3): zone of departure and the two parts, as of `ContextLevel`."""
    departures: Floats
    """(contexts,) certain departures."""
    row: Longs
    """(n,) index of the first column of each departure's context in the flattened ``moved``."""
    mine: Singles
    """(n,) weight of the departure itself in its context, which leave-one-out removes."""
    scale: Singles
    """(n,) probability of the context over its departures, the departure itself left out and
    `BACK_OFF_DEPARTURES` included.
    """
    unsure: Singles
    """(n,) probability that the departure is not in this context."""
    moved: Singles
    """(contexts, columns) certain transitions; `Contexts._columns` gives the columns."""

    def cells_of(
        self, departure: NDArray[np.intp], target: Longs, responsibility: Singles
    ) -> tuple[Longs, Singles]:
        """Return the cells in ``moved`` of some candidates (m,), and their own contributions there.

        departure (m,): row of the departure.
        target (m,): column of the pair of zones.
        responsibility (m,): of the candidate.
        """
        cell = self.row.take(departure)
        cell += target
        own = self.mine.take(departure)
        own *= responsibility
        return cell, own

    def judged(
        self, departure: NDArray[np.intp], cell: Longs, own: Singles, share: Singles
    ) -> Singles:
        """Return the leave-one-out probabilities of some candidates (m,) at this level.

        departure (m,): row of the departure. cell, own (m,): results of `cells_of`; ``cell`` is the
        index in ``moved``, ``own`` is left out. share (m,): probability at the level before, to
        which this one backs off.
        """
        here = self.moved.take(cell)
        here -= own
        here += BACK_OFF_DEPARTURES * share
        np.maximum(here, 0.0, out=here)
        here *= self.scale.take(departure)
        here += self.unsure.take(departure) * share
        return here


class Contexts:
    """Contexts of all departures of a fit, and the counts that responsibilities give them."""

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
    ) -> tuple[list[ContextCounts], Floats]:
        """Count each level of context; return the counts and each probability to leave the site.

        responsibility (M,): of the candidates.
        gone (n,): probability that the object of each departure was not seen again.
        leave (n,): probability of leaving the site without context.

        The second result (n,) is the probability of each departure to leave the site, given its
        context. Each departure is judged by the others in its context (leave one out).
        """
        c = candidates
        sure = self._sureness(c, responsibility)[self._zone]
        column, width = self._columns(c)
        levels = []
        most = max(context_cells_max(self.cameras) // width, 1)

        # Departures of each context, and leaving the site as one of their outcomes.
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
            levels.append(ContextCounts(keys, n, number * width, own, scale, unsure, moved))

        # Transitions of each context.
        for part in slices_by_arrival(c.arrival):
            departure, target = c.departure[part].astype(np.intp), column.take(c.pair[part])
            for level in levels:
                cell, own = level.cells_of(departure, target, responsibility[part])
                np.add.at(level.moved.ravel(), cell, own)
        return levels, leave

    def judged(
        self,
        candidates: Candidates,
        responsibility: Singles,
        share: Floats,
        levels: list[ContextCounts],
    ) -> Singles:
        """Return the leave-one-out probability (M,) of each candidate's transition in its context.

        share (P,): the same probability without context.
        levels: result of `count`.
        """
        c, column = candidates, self._columns(candidates)[0]
        after, without = np.empty(len(c.lag), np.float32), share.astype(np.float32)
        for part in slices_by_arrival(c.arrival):
            departure, pair = c.departure[part].astype(np.intp), c.pair[part].astype(np.intp)
            target, here = column.take(pair), without.take(pair)
            for level in levels:
                here = level.judged(
                    departure, *level.cells_of(departure, target, responsibility[part]), here
                )
            after[part] = here
        return after

    def published_levels(
        self, candidates: Candidates, levels: list[ContextCounts]
    ) -> list[ContextLevel]:
        """Return the levels in the form that is published."""
        first, result = np.searchsorted(candidates.source, np.arange(self.zones)), []
        for level in levels:
            context, at = np.nonzero(level.moved)
            reached = candidates.target[first[level.keys[context, 0]] + at].astype(np.int64)
            rows = np.searchsorted(context, np.arange(len(level.keys) + 1))
            transitions = level.moved[context, at].astype(float)
            result.append(
                ContextLevel(
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
        """Return the column (P,) of each pair of zones in the tables of transitions, and the width.

        Pairs come in order of their source; those of one source have the columns 0, 1, 2, ...
        """
        source = candidates.source
        column = np.arange(len(source)) - np.searchsorted(source, np.arange(self.zones))[source]
        return column, int(column.max(initial=0)) + 1

    def _contexts(
        self, candidates: Candidates, responsibility: Singles
    ) -> list[tuple[tuple[Longs, Longs], Floats]]:
        """Return each departure's context number (n,), the keys and the certainty (n,), by level.

        The certainty is the probability that the departure is in this context.
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
        """Return the most probable previous camera of each departure (n,) and its probability (n,).

        The camera is -1 where it is unknown.
        """
        c, d = candidates, self.departures
        likely = np.flatnonzero(responsibility > PREVIOUS_RESPONSIBILITY_MIN)
        key = c.arrival[likely].astype(np.int64) * self.cameras + d.camera[c.departure[likely]]
        present, number = np.unique(key, return_inverse=True)
        mass = np.bincount(number, responsibility[likely], minlength=len(present))
        arrival, camera = np.divmod(present, self.cameras)

        # For each arrival, the camera with the largest probability.
        best, sure = np.full(len(self.arrivals.t) + 1, -1), np.zeros(len(self.arrivals.t) + 1)
        np.maximum.at(sure, arrival, mass)
        most = np.flatnonzero(mass == sure.take(arrival))
        best[arrival[most]] = camera[most]  # of equally probable cameras the last one
        return best[d.own], np.minimum(sure[d.own], 1.0)

    def _sureness(self, candidates: Candidates, responsibility: Singles) -> Floats:
        """Return the certain share of the transitions from each zone (zones,)."""
        squares, all_of = np.zeros(self.zones), np.zeros(self.zones)
        for part in slices_by_arrival(candidates.arrival):
            zone, r = (
                self._zone.take(candidates.departure[part]),
                responsibility[part].astype(float),
            )
            np.add.at(squares, zone, r * r)
            np.add.at(all_of, zone, r)
        sure: Floats = squares / np.maximum(all_of, 1e-300)
        return sure


def multipliers(before: Floats, after: Floats) -> Floats:
    """Return the factors by which a context raises or lowers probabilities."""
    ratio: Floats = np.clip(
        after / np.maximum(before, 1e-300), 1.0 / MULTIPLIER_MAX, MULTIPLIER_MAX
    )
    return ratio


def _commonest(number: Longs, keys: Longs, told: Floats, most: int) -> tuple[Longs, Longs, Floats]:
    """Keep only the ``most`` contexts with the most departures.

    Returns the context of each departure (n,), the keys and the certainty (n,), which is 0 for
    departures whose context is dropped.
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
    """Return each departure's context number (n,) and the contexts' keys (contexts, 3)."""
    keys, number = np.unique(np.column_stack((zone, first, second)), axis=0, return_inverse=True)
    return number.ravel().astype(np.int64), keys.astype(np.int64)
