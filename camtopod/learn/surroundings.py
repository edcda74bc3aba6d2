"""What the context of an exit says about where the object goes, read off a topology version (see `contexts`)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camtopod.learn.contexts import BACK_OFF_DEPARTURES, multipliers
from camtopod.learn.hazards import Outcomes
from camtopod.learn.joint import LEAVE_FLOOR
from camtopod.records import Topology

Floats = NDArray[np.float64]
Key = tuple[int | None, int | None, str | None]


class _Counts(NamedTuple):
    departures: float
    to: dict[int, float]


_NOTHING = _Counts(0.0, {})


class Surroundings:
    """Contexts by zone index (the order of ``topology.zones``), each by (zone of entry, block, camera before)."""

    def __init__(self, topology: Topology) -> None:
        index = {zone.id: k for k, zone in enumerate(topology.zones)}
        self._of_zone: dict[int, dict[Key, _Counts]] = {}
        for row in (topology.model and topology.model.contexts) or []:
            entry = index[row.entry] if row.entry is not None else None
            to = {index[name]: count for name, count in row.to.items()}
            self._of_zone.setdefault(index[row.zone], {})[entry, row.block, row.previous] = _Counts(row.departures, to)

    def multipliers(
        self, zone: int, outcomes: Outcomes, block: int | None, entry: int | None, previous: str | None, sure: float
    ) -> tuple[Floats, float]:
        """By how much each target (targets,) is likelier than for a departure of which nothing is known; and the
        probability of not being seen again. ``sure``: probability that ``previous`` is right.
        """
        known = self._of_zone.get(zone)
        share, leave = outcomes.share, outcomes.leave
        if known is None:
            return np.ones(len(share)), leave
        steps: list[tuple[Key, float]] = []
        if entry is not None:
            steps.append(((entry, None, None), 1.0))
        if block is not None:
            steps.append(((None, block, None), 1.0))
        if entry is not None and block is not None:
            steps.append(((entry, block, None), 1.0))
        if previous is not None:
            steps.append(((None, None, previous), min(sure, 1.0)))
        for key, told in steps:
            counts = known.get(key, _NOTHING)
            below = counts.departures + BACK_OFF_DEPARTURES
            moved = np.array([counts.to.get(target, 0.0) for target in outcomes.targets])
            stays = max(counts.departures - sum(counts.to.values()), 0.0)
            share = told * (moved + BACK_OFF_DEPARTURES * share) / below + (1.0 - told) * share
            leave = told * (stays + BACK_OFF_DEPARTURES * leave) / below + (1.0 - told) * leave
        return multipliers(outcomes.share, share), max(leave, LEAVE_FLOOR)
