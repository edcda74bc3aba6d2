"""What the context of an exit says about where the object goes, read off a topology version (see
`contexts`).
"""

from __future__ import annotations

from array import array
from typing import NamedTuple

from camtopod.cooperative import Pause, no_pause, unhurried
from camtopod.predict.hazards import Outcomes
from camtopod.records import Context, Topology
from camtopod.topology import BACK_OFF_DEPARTURES, LEAVE_FLOOR, MULTIPLIER_MAX

Key = tuple[int | None, int | None, str | None]


class _Counts(NamedTuple):
    """What a context has counted, beside what it backs off to."""

    below: float
    moved: list[float]
    """(targets,)"""
    stays: float


class _Uncounted:
    """Contexts that nobody has asked about, by number: there are thousands, and as columns they
    take a tenth.
    """

    def __init__(self) -> None:
        self.departures, self.stays, self.ends = array("d"), array("d"), array("l", [0])
        self._to, self._moved = array("l"), array("d")

    def add(self, row: Context, index: dict[str, int]) -> int:
        """Its number."""
        self.departures.append(row.departures)
        self.stays.append(max(row.departures - sum(row.to.values()), 0.0))
        self._to.extend([index.get(name, -1) for name in row.to])
        self._moved.extend(row.to.values())
        self.ends.append(len(self._to))
        return len(self.stays) - 1

    def counts(self, number: int, targets: list[int]) -> _Counts:
        """Of one, on its zone's targets."""
        first, end = self.ends[number], self.ends[number + 1]
        to = dict(zip(self._to[first:end], self._moved[first:end], strict=True))
        below = self.departures[number] + BACK_OFF_DEPARTURES
        return _Counts(below, [to.get(target, 0.0) for target in targets], self.stays[number])


class Surroundings:
    """Contexts by zone index (the order of ``topology.zones``), each by (zone of entry, block,
    camera before).
    """

    def __init__(self, topology: Topology, pause: Pause = no_pause) -> None:
        index = {zone.id: k for k, zone in enumerate(topology.zones)}
        self._uncounted = _Uncounted()
        self._of_zone: dict[int, dict[Key, int | _Counts]] = {}
        for row in unhurried((topology.model and topology.model.contexts) or [], pause):
            entry = index[row.entry] if row.entry is not None else None
            self._of_zone.setdefault(index[row.zone], {})[entry, row.block, row.previous] = (
                self._uncounted.add(row, index)
            )

    def multipliers(
        self,
        zone: int,
        outcomes: Outcomes,
        block: int | None,
        entry: int | None,
        previous: str | None,
        sure: float,
    ) -> tuple[list[float], float]:
        """By how much each target (targets,) is likelier than for a departure of which nothing is
        known; and the probability of not being seen again. ``sure``: probability that ``previous``
        is right.
        """
        known = self._of_zone.get(zone)
        if known is None:
            return [1.0] * len(outcomes.targets), outcomes.leave
        asked: list[Key] = []
        if entry is not None:
            asked.append((entry, None, None))
        if block is not None:
            asked.append((None, block, None))
        if entry is not None and block is not None:
            asked.append((entry, block, None))
        usual: list[float] = outcomes.share.tolist()
        share, leave, few = usual, outcomes.leave, BACK_OFF_DEPARTURES
        for key in asked:
            below, moved, stays = self._counted(known, key, outcomes.targets)
            share = [(more + few * one) / below for more, one in zip(moved, share, strict=True)]
            leave = (stays + few * leave) / below
        if previous is not None:
            below, moved, stays = self._counted(known, (None, None, previous), outcomes.targets)
            told = min(sure, 1.0)
            rest = 1.0 - told
            share = [
                told * (more + few * one) / below + rest * one
                for more, one in zip(moved, share, strict=True)
            ]
            leave = told * (stays + few * leave) / below + rest * leave
        most, least = MULTIPLIER_MAX, 1.0 / MULTIPLIER_MAX
        likelier = [  # as `contexts.multipliers`; `min` and `max` would take most of the time
            least if (more := now / (before or 1e-300)) < least else more if more < most else most
            for now, before in zip(share, usual, strict=True)
        ]
        return likelier, max(leave, LEAVE_FLOOR)

    def _counted(self, known: dict[Key, int | _Counts], key: Key, targets: list[int]) -> _Counts:
        """Of a context of a zone, on the zone's targets; worked out when it is first asked
        about.
        """
        row = known.get(key)
        if row is None:
            return _Counts(BACK_OFF_DEPARTURES, [0.0] * len(targets), 0.0)
        if isinstance(row, int):
            known[key] = row = self._uncounted.counts(row, targets)
        return row
