"""Contexts of a departure: other known facts about the object, and where such objects appear next.

Departures from one zone are told apart by their *context*: the zone where the passage began with
the block of the image where the object left, and the camera that it probably came from (`LEVELS`).
The probability p of a next zone is smoothed by *back-off* to the level before: ``p = (f N + k p') /
(f n + k)`` (Jelinek and Mercer 1980), with n departures in the context, N of their transitions to
the zone, p' the probability at the level before, and k `BACK_OFF_DEPARTURES`. As objects are
anonymous, the *certain share* ``f`` of transitions (the mean responsibility of a transition) scales
both: ``f n`` are called certain departures, ``f N`` certain transitions.

`Contexts.count` counts, `Contexts.judged` gives the probability of each candidate in its context,
without the candidate's own contribution (leave one out).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from camtopod.arrays import Floats, Longs, Singles
from camtopod.learn.association import LIKELY_MIN, NOTHING, Candidates, Problem
from camtopod.learn.limits import CONTEXT_CELLS_MAX, of_site
from camtopod.topology import BACK_OFF_DEPARTURES, MULTIPLIER_MAX

LEVELS = ("entry+block", "previous")
"""Levels of context; each backs off to the one before. ``entry``: zone of entry. ``block``: block
of the image where the object left. ``previous``: camera that the object came from.
"""


class ContextLevel(NamedTuple):
    """One level of context, as it is published: C contexts."""

    keys: Longs
    """(C, 3) zone of departure; zone of entry or previous camera; image block; -1 where a context
    has none.
    """
    departures: Floats
    """(C,) certain departures, f n."""
    transitions: csr_array
    """(C, columns) certain transitions to each next zone, f N. The columns of a zone of departure
    are its pairs of zones, in their order.
    """


class ContextCounts(NamedTuple):
    """Counts of one level of context, in a form for leave-one-out probabilities.

    There are C contexts and n departures, each in one of the contexts.
    """

    keys: Longs
    """(C, 3) as in `ContextLevel`."""
    departures: Floats
    """(C,) certain departures."""
    row: Longs
    """(n,) index of the first column of each departure's context in ``transitions``, flattened."""
    own_weight: Singles
    """(n,) weight of each departure in its context, which leave-one-out removes."""
    scale: Singles
    """(n,) probability that the departure is in the context, divided by the certain departures of
    the context, without the departure itself and with `BACK_OFF_DEPARTURES` added.
    """
    unsure: Singles
    """(n,) probability that the departure is not in the context."""
    transitions: Singles
    """(C, columns) as in `ContextLevel`; `Contexts._columns` gives the columns."""

    def published(self) -> ContextLevel:
        """Return the counts in the form that is published, which needs little memory."""
        return ContextLevel(self.keys, self.departures, csr_array(self.transitions))

    def cells_of(
        self, departure: NDArray[np.intp], target: Longs, responsibility: Singles
    ) -> tuple[Longs, Singles]:
        """Return the cells of ``transitions`` that m candidates count in, and their parts of these.

        departure (m,): row of each candidate's departure.
        target (m,): column of its pair of zones.
        responsibility (m,): of the candidate.

        Both results are (m,); a cell is an index in the flattened table.
        """
        cell = self.row.take(departure)
        cell += target
        own_weight = self.own_weight.take(departure)
        own_weight *= responsibility
        return cell, own_weight

    def judged(
        self, departure: NDArray[np.intp], cell: Longs, own_weight: Singles, share: Singles
    ) -> Singles:
        """Return the leave-one-out probability of each of m candidates at this level, (m,).

        departure (m,): row of each candidate's departure.
        cell, own_weight (m,): results of `cells_of`; ``own_weight`` is what leave-one-out removes.
        share (m,): probability at the level before, to which this level backs off.
        """
        probability = self.transitions.take(cell)
        probability -= own_weight
        probability += BACK_OFF_DEPARTURES * share
        np.maximum(probability, 0.0, out=probability)
        probability *= self.scale.take(departure)
        probability += self.unsure.take(departure) * share
        return probability


class Contexts:
    """Contexts of all n departures of a fit.

    entry (n,): zone of entry of the passage that ends with each departure; -1 if unknown.
    """

    def __init__(self, problem: Problem, cameras: int) -> None:
        departures, arrivals, _, zones, *_ = problem
        self.zones = zones
        self.cameras = cameras
        self.departures = departures
        self.arrivals = arrivals
        zone = departures.zone.astype(np.int64)
        block = departures.block.astype(np.int64)
        self._zone = zone
        self.entry = np.where(departures.own >= 0, arrivals.zone[departures.own], -1).astype(
            np.int64
        )
        columns = np.column_stack((zone, self.entry, block))
        keys, number = np.unique(columns, axis=0, return_inverse=True)
        self._way = number.ravel().astype(np.int64), keys
        self._way_known = ((self.entry >= 0) & (block >= 0)).astype(float)

    def count(
        self, candidates: Candidates, responsibility: Singles, absence: Floats, leave: Floats
    ) -> tuple[list[ContextCounts], Floats]:
        """Count departures and transitions by context, for each level.

        responsibility (M,): of the candidates.
        absence (n,): probability that the object of each departure does not appear again.
        leave (n,): probability that an object leaves the site after a departure from the same zone,
            whatever the context.

        Return the counts of each level; and the probability (n,) that the object of each departure
        leaves the site, by the other departures in its context (leave one out).
        """
        c = candidates
        sure = self._sureness(c, responsibility)[self._zone]
        column, width = self._columns(c)
        levels = []
        cells = of_site(CONTEXT_CELLS_MAX, self.cameras)
        contexts_max = max(cells // width, 1)

        # Departures of each context, and leaving the site as one of their outcomes.
        for (number, keys), certainty in self._contexts(c, responsibility):
            number, keys, certainty = _commonest(number, keys, certainty, contexts_max)
            weight = sure * certainty
            departures = np.bincount(number, weight, minlength=len(keys)).astype(float)
            other_departures = departures[number] - weight + BACK_OFF_DEPARTURES
            leave_sums = np.bincount(number, weight * absence, minlength=len(keys))
            leaving_others = np.maximum(
                leave_sums[number] - weight * absence + BACK_OFF_DEPARTURES * leave, 0.0
            )
            leave = certainty * leaving_others / other_departures + (1.0 - certainty) * leave
            own_weight, scale, unsure = (
                column.astype(np.float32)
                for column in (weight, certainty / other_departures, 1.0 - certainty)
            )
            transitions = np.zeros((len(keys), width), np.float32)
            levels.append(
                ContextCounts(
                    keys, departures, number * width, own_weight, scale, unsure, transitions
                )
            )

        # Transitions of each context.
        departure = c.departure.astype(np.intp)
        target = column.take(c.pair)
        for level in levels:
            cell, own_weight = level.cells_of(departure, target, responsibility)
            np.add.at(level.transitions.ravel(), cell, own_weight)
        return levels, leave

    def judged(
        self,
        candidates: Candidates,
        responsibility: Singles,
        share: Floats,
        levels: list[ContextCounts],
    ) -> Singles:
        """Return the leave-one-out probability (M,) of each candidate's next zone in its context.

        responsibility (M,): of the candidates.
        share (P,): probability of each pair's second zone after its first, without context.
        levels: counts of each level (`count`).
        """
        c = candidates
        departure = c.departure.astype(np.intp)
        target = self._columns(c)[0].take(c.pair)
        probability = share.astype(np.float32).take(c.pair)
        for level in levels:
            cell, own_weight = level.cells_of(departure, target, responsibility)
            probability = level.judged(departure, cell, own_weight, probability)
        return probability

    def _columns(self, candidates: Candidates) -> tuple[Longs, int]:
        """Return the column (P,) of each pair of zones in tables of transitions, and their width.

        Pairs are in order of their source; the pairs of one source have the columns 0, 1, 2, ...
        """
        source = candidates.source
        column = np.arange(len(source)) - np.searchsorted(source, np.arange(self.zones))[source]
        return column, int(column.max(initial=0)) + 1

    def _contexts(
        self, candidates: Candidates, responsibility: Singles
    ) -> list[tuple[tuple[Longs, Longs], Floats]]:
        """Return the contexts of each level, as ((number (n,), keys (C, 3)), certainty (n,)).

        They are the number of each departure's context, the keys of the C contexts
        (`ContextCounts`), and the probability that the departure is in its context.
        """
        camera, sure = self._previous(candidates, responsibility)
        present, number = np.unique(
            self._zone * self.cameras + np.maximum(camera, 0), return_inverse=True
        )
        keys = np.column_stack(
            (present // self.cameras, present % self.cameras, np.full(len(present), -1))
        )
        previous = (number.astype(np.int64), keys)
        return [(self._way, self._way_known), (previous, sure)]

    def _previous(self, candidates: Candidates, responsibility: Singles) -> tuple[Longs, Floats]:
        """Return the most probable previous camera of each departure and its probability, (n,).

        It is the camera from which the object came into the view that it now leaves, by the
        responsibilities (M,) of the arrival that began the passage; -1 where it is unknown.
        """
        c = candidates
        d = self.departures
        likely = np.flatnonzero(responsibility > LIKELY_MIN)
        key = c.arrival[likely].astype(np.int64) * self.cameras + d.camera[c.departure[likely]]
        present, number = np.unique(key, return_inverse=True)
        mass = np.bincount(number, responsibility[likely], minlength=len(present))
        arrival, camera = np.divmod(present, self.cameras)

        # For each arrival, the camera with the largest probability.
        best = np.full(len(self.arrivals.t) + 1, -1)
        sure = np.zeros(len(self.arrivals.t) + 1)
        np.maximum.at(sure, arrival, mass)
        best_rows = np.flatnonzero(mass == sure.take(arrival))
        best[arrival[best_rows]] = camera[best_rows]  # of equally probable cameras the last one
        return best[d.own], np.minimum(sure[d.own], 1.0)

    def _sureness(self, candidates: Candidates, responsibility: Singles) -> Floats:
        """Return the certain share of the transitions from each zone, (zones,).

        It is the mean responsibility of a transition, the candidates weighted by responsibility.
        """
        zone = self._zone.take(candidates.departure)
        squares = np.bincount(zone, responsibility * responsibility, minlength=self.zones)
        all_of = np.bincount(zone, responsibility, minlength=self.zones)
        sure: Floats = squares / np.maximum(all_of, 1e-300)
        return sure


def multipliers(before: Singles, after: Singles) -> Singles:
    """Return the factors (n,) by which a context changes probabilities, within `MULTIPLIER_MAX`.

    before, after (n,): probabilities without and with the context.
    """
    ratio: Singles = np.clip(
        after / np.maximum(before, NOTHING), 1.0 / MULTIPLIER_MAX, MULTIPLIER_MAX
    )
    return ratio


def _commonest(
    number: Longs, keys: Longs, certainty: Floats, contexts_max: int
) -> tuple[Longs, Longs, Floats]:
    """Drop all contexts but the ``contexts_max`` frequent ones.

    number (n,), keys (C, 3), certainty (n,): context of each departure, keys, and certainty, as
        returned by `Contexts._contexts`.

    Return the same three after the change; the certainty is 0 for departures whose context is
    dropped.
    """
    if len(keys) <= contexts_max:
        return number, keys, certainty
    common_contexts = np.sort(
        np.argsort(-np.bincount(number, certainty, minlength=len(keys)), kind="stable")[
            :contexts_max
        ]
    )
    new_number = np.full(len(keys), -1)
    new_number[common_contexts] = np.arange(contexts_max)
    number = new_number[number]
    return np.maximum(number, 0), keys[common_contexts], certainty * (number >= 0)
