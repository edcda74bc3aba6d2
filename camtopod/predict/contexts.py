"""The effect of an exit's context on where the object appears next.

The *context* of an exit consists of three facts beside its zone: the zone where the object entered
the view, the block of the image where it left, and the camera where it was before. The topology
version has counts of departures and transitions by context, which
`camtopod.learn.next_camera.contexts` has learned. `ContextMultipliers.multipliers` turns them into
factors on the odds of each next zone.
"""

from __future__ import annotations

import itertools
from array import array

import numpy as np

from camtopod.arrays import Floats
from camtopod.predict.hazards import model_of
from camtopod.predict.outcomes import Outcomes
from camtopod.records import Context, Topology
from camtopod.topology import BACK_OFF_DEPARTURES, LEAVE_FLOOR, MULTIPLIER_MAX

Key = tuple[int | None, int | None, str | None]
"""A context: zone of entry, block of the image and camera before; None for parts that it lacks."""


class ContextMultipliers:
    """The contexts of a topology version; zones are indices into ``topology.zones``.

    There are thousands of contexts, so their counts are stored as columns.
    """

    def __init__(self, topology: Topology) -> None:
        index = {zone.id: k for k, zone in enumerate(topology.zones)}
        rows: list[Context] = model_of(topology).contexts or []

        # Columns with one element for each context.
        self._departures = array("d", [row.departures for row in rows])
        self._not_seen_again = array(
            "d", [max(row.departures - sum(row.to.values()), 0.0) for row in rows]
        )

        # Transitions of all contexts one after the other; those of context k begin at `_end[k]`.
        # Zones that this version does not have get the number after the last zone.
        self._end = array("l", itertools.accumulate((len(row.to) for row in rows), initial=0))
        self._to = np.array([index.get(to, len(index)) for row in rows for to in row.to], np.int32)
        self._transitions = np.array([number for row in rows for number in row.to.values()])
        self._zones = len(index)

        # Numbers of the contexts of each zone.
        self._numbers: dict[int, dict[Key, int]] = {}
        for number, row in enumerate(rows):
            numbers = self._numbers.setdefault(index[row.zone], {})
            numbers[index.get(row.entry or ""), row.block, row.previous] = number

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
        numbers = self._numbers.get(zone)
        if numbers is None:
            return np.ones(len(outcomes.targets)), outcomes.leave

        # Contexts that apply, each with the probability that it does. What is unknown makes a key
        # that no context has.
        keys: dict[Key, float] = {
            (entry, block, None): 1.0,
            (None, None, previous): min(sure, 1.0),
        }

        # Each context backs off to the one before it; unknown contexts change nothing.
        targets = outcomes.targets
        share = outcomes.share
        leave = outcomes.leave
        for key, probability in keys.items():
            number = numbers.get(key)
            if number is None:
                continue
            total = self._departures[number] + BACK_OFF_DEPARTURES
            of_context = slice(self._end[number], self._end[number + 1])
            transitions = np.zeros(self._zones + 1)
            transitions[self._to[of_context]] = self._transitions[of_context]
            share_here = (transitions[targets] + BACK_OFF_DEPARTURES * share) / total
            leave_here = (self._not_seen_again[number] + BACK_OFF_DEPARTURES * leave) / total
            share = probability * share_here + (1.0 - probability) * share
            leave = probability * leave_here + (1.0 - probability) * leave

        # Ratio to the share without any context, within limits.
        ratio = share / np.maximum(outcomes.share, 1e-300)
        ratio = np.clip(ratio, 1.0 / MULTIPLIER_MAX, MULTIPLIER_MAX)
        return np.where(outcomes.by_path | outcomes.missed, 1.0, ratio), max(leave, LEAVE_FLOOR)
