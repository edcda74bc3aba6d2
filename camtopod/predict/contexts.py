"""The effect of an exit's context on where the object appears next.

The *context* of an exit consists of three facts beside its zone: the zone where the object entered
the view, the block of the image where it left, and the camera where it was before. The topology
version has counts of departures and transitions by context, which
`camtopod.learn.next_camera.contexts` has learned. `ContextMultipliers.multipliers` turns them into
factors on the odds of each next zone.
"""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats
from camtopod.columns import numbers
from camtopod.predict.hazards import model_of
from camtopod.predict.outcomes import Outcomes
from camtopod.records import ContextColumns, Topology
from camtopod.topology import BACK_OFF_DEPARTURES, LEAVE_FLOOR, MULTIPLIER_MAX

Key = tuple[int, int, int]
"""A context: zone of entry, block of the image and camera before; -1 for parts that it lacks."""


class ContextMultipliers:
    """The contexts of a topology version; zones are indices into ``topology.zones``.

    There are thousands of contexts, so their counts are stored as columns.
    """

    def __init__(self, topology: Topology) -> None:
        self._zones = len(topology.zones)
        self._camera = {camera.id: k for k, camera in enumerate(topology.cameras)}
        self._numbers: dict[int, dict[Key, int]] = {}
        """By zone that was asked for: number of each of its contexts."""
        columns = model_of(topology).contexts or ContextColumns(*[b""] * 8)

        # Columns with one element for each context; those of a zone begin at `_first`.
        number = numbers(columns.number, np.int32, self._zones)
        self._first = np.append(0, number.cumsum())
        rows = int(number.sum())
        self._key = [
            numbers(raw, np.int32, rows) for raw in (columns.entry, columns.block, columns.previous)
        ]
        self._departures = numbers(columns.departures, np.float32, rows).astype(float)

        # Transitions of all contexts one after the other; those of context k begin at `_begin[k]`.
        target_counts = numbers(columns.followed, np.int16, rows)
        self._begin = np.append(0, target_counts.cumsum(dtype=int))
        self._to = numbers(columns.to, np.int32, int(target_counts.sum()))
        self._transitions = numbers(columns.transitions, np.float32, len(self._to)).astype(float)

    def multipliers(
        self,
        zone: int,
        outcomes: Outcomes,
        block: int | None,
        entry: int | None,
        previous: str | None,
        sure: float,
    ) -> tuple[Floats, float]:
        """Return the factor on each target's odds by an exit's context, and the odds of leaving.

        zone: zone of the exit.
        outcomes: its targets, and shares without context.
        block, entry: block of the image where the object left, and its zone of entry; None if
            unknown.
        previous: camera where the object probably was before; None if unknown.
        sure: probability that ``previous`` is right.

        The factors (rows,) are relative to an exit of which only the zone is known; those of paths
        and of missed detections are 1. The second result is the share of such exits after which
        objects leave the site.
        """
        contexts = self._of_zone(zone)
        if not contexts:
            return np.ones(len(outcomes.targets)), outcomes.leave

        # Contexts that apply, each with the probability that it does. What is unknown makes a key
        # that no context has.
        blank = -1
        camera = self._camera.get(previous or "", blank)
        keys: dict[Key, float] = {
            (blank if entry is None else entry, blank if block is None else block, blank): 1.0,
            (blank, blank, camera): min(sure, 1.0),
        }

        # Each context backs off to the one before it; unknown contexts change nothing.
        targets = outcomes.targets
        share = outcomes.share
        leave = outcomes.leave
        for key, probability in keys.items():
            number = contexts.get(key)
            if number is None:
                continue
            departures = float(self._departures[number])
            total = departures + BACK_OFF_DEPARTURES
            of_context = slice(self._begin[number], self._begin[number + 1])
            transitions = np.zeros(self._zones)
            transitions[self._to[of_context]] = self._transitions[of_context]
            not_seen_again = max(departures - float(transitions.sum()), 0.0)
            share_here = (transitions[targets] + BACK_OFF_DEPARTURES * share) / total
            leave_here = (not_seen_again + BACK_OFF_DEPARTURES * leave) / total
            share = probability * share_here + (1.0 - probability) * share
            leave = probability * leave_here + (1.0 - probability) * leave

        # Ratio to the share without any context, within limits.
        ratio = share / np.maximum(outcomes.share, 1e-300)
        ratio = np.clip(ratio, 1.0 / MULTIPLIER_MAX, MULTIPLIER_MAX)
        return np.where(outcomes.by_path | outcomes.is_missed, 1.0, ratio), max(leave, LEAVE_FLOOR)

    def _of_zone(self, zone: int) -> dict[Key, int]:
        """Return the numbers of the contexts of a zone."""
        if zone not in self._numbers:
            rows = range(*self._first[zone : zone + 2].tolist())
            key = zip(
                *(column[rows.start : rows.stop].tolist() for column in self._key), strict=True
            )
            self._numbers[zone] = dict(zip(key, rows, strict=True))
        return self._numbers[zone]
