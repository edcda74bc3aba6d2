"""A district: a learner of the links into its own cameras.

It hears its own cameras, the *neighbours* from which objects come to them, and the guests of the turn (`dealing`).
What objects do at its neighbours and guests is part of the fit, as it explains arrivals away, but only what belongs to
its own cameras is published (`parts`). As a turn of event time ends, whoever of those heard turned out to send objects
here is a neighbour in the next, and what was heard of the others is forgotten. So what a district costs follows from
its own cameras, its neighbours and the guests, and what it learns from the events of those alone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

import numpy as np
from msgspec import Struct

from camtopod.districts.dealing import Dealing
from camtopod.districts.parts import Part, part_of
from camtopod.learn.intake import MICROSECONDS, microseconds
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.learn.snapshot import LearnerState
from camtopod.records import Event, Topology

NEIGHBOUR_TRANSITIONS_MIN = 2.0
"""A neighbour has sent at least this many objects, those left out that may as well be chance ..."""
NEIGHBOUR_ARRIVALS_SHARE = 0.02
"""... and they are this share of what arrives at one of the cameras here ..."""
NEIGHBOUR_DEPARTURES_SHARE = 0.1
"""... or of what leaves there."""
NEIGHBOURS_PER_CAMERA_MAX = 12
"""Neighbours are at most so many for each camera here, those that send most."""


class Hearing(Struct):
    """What a `District` knows beside what its learner does."""

    turn: int | None = None
    """Up to this one it is decided who is a neighbour."""
    neighbours: list[str] = []
    learned: int = 0
    """Events of own cameras."""
    owner: bool = False
    """Whether an own camera has ever been heard. Until then there is nothing to wait for."""


class DistrictState(Struct):
    """Everything a `District` knows."""

    learner: LearnerState
    hearing: Hearing


class District(Learner):
    """Learns as a `Learner` does, from what it hears, and gives a `Part` for each version."""

    def __init__(self, settings: Settings, site: str, epoch: str, dealing: Dealing, number: int) -> None:
        super().__init__(settings, site, epoch)
        self.number = number
        self.hearing = Hearing()
        self._dealing = dealing
        self._parts: list[Part] = []

    def owns(self, camera: str) -> bool:
        """Whether the camera is one of this district's."""
        return self._dealing.district(camera) == self.number

    def listens(self, camera: str, t: float) -> bool:
        """Whether an event at ``t`` (seconds) of the camera is of use. Until the turn has come those count that may be
        neighbours then: today's neighbours and guests.
        """
        turn = self._turn_of(microseconds(t))
        if self._hears(camera, turn):
            return True
        decided = self.hearing.turn
        return decided is not None and turn > decided and self._dealing.guest(camera, decided)

    def receive(self, event: Event) -> str:
        """As `Learner.receive`; ``unheard`` for one that is of no use."""
        if self.owns(event.camera):
            self.hearing.owner = True
        return super().receive(event) if self.listens(event.camera, event.t) else "unheard"

    @property
    def cameras_own(self) -> int:
        """Own cameras heard so far."""
        return sum(self.owns(camera) for camera in self._window.cameras)

    @property
    def watermark_us(self) -> int | None:
        """Nothing older will be learned any more, in microseconds; None before the first event."""
        return self._intake.watermark_us

    @property
    def held_since_us(self) -> int | None:
        """Everything up to this has been learned and what is later is waiting, in microseconds; None: nothing waits."""
        oldest = self._intake.oldest_held_us
        return None if oldest is None else (oldest - 1) // self._tick_us * self._tick_us

    def parts(self) -> list[Part]:
        """The part of each version made since the last call, oldest first."""
        made, self._parts = self._parts, []
        return made

    def save_all(self) -> DistrictState:
        """Everything `load_all` needs to go on from here. Parts that have not been asked for are not in it."""
        return DistrictState(self.save(), self.hearing)

    def load_all(self, state: DistrictState) -> None:
        """Go on from there; this district must be new."""
        self.load(state.learner)
        self.hearing = state.hearing

    def change(self, change: Callable[[LearnerState], LearnerState]) -> None:
        """Go on with another state, in which event time may have been taken back."""
        state = change(self.save())
        super().__init__(self.settings, self.site, self.epoch)  # only a new learner can be told what it knows
        self.load(state)
        if self._done_us is not None and self.hearing.turn is not None:
            self.hearing.turn = min(self.hearing.turn, self._turn_of(self._done_us))

    def _turn_of(self, t_us: int) -> int:
        """The turn of an event: that of its tick, as what a tick has is learned together."""
        tick = -(-t_us // self._tick_us) * self._tick_us
        return (tick - 1) // self._dealing.turn_us

    def _take(self, until_us: int) -> list[tuple[int, Event]]:
        batch = super()._take(until_us)
        turn = self._turn_of(until_us)
        if self.hearing.turn is not None and turn > self.hearing.turn:
            self._end_turn(turn, until_us)
        self.hearing.turn = turn
        heard = [(t_us, event) for t_us, event in batch if self._hears(event.camera, turn)]
        self.hearing.learned += sum(self.owns(event.camera) for _, event in heard)
        return heard if self.hearing.learned else []  # without cameras of its own it has nothing to learn

    def _hears(self, camera: str, turn: int) -> bool:
        return self.owns(camera) or self._dealing.guest(camera, turn) or camera in self.hearing.neighbours

    def _end_turn(self, following: int, tick_us: int) -> None:
        """Who is a neighbour from now on, and who is forgotten? By a version as of the tick where that is found out:
        the others may have come to any moment before by then.
        """
        foreign = [camera for camera in self._window.cameras if not self.owns(camera)]
        if not foreign:
            return
        if self._since_fit:
            self._refit(tick_us)
        if self.topology is not None:
            self.hearing.neighbours = self._find_neighbours(self.topology)
        gone = {camera for camera in foreign if not self._hears(camera, following)}
        if gone:
            self.forget(gone)

    def _find_neighbours(self, topology: Topology) -> list[str]:
        """Foreign cameras from which objects come here, by how many they send."""
        sent = sent_to(topology)
        came, left = Counter[str](), Counter[str]()
        for zone in topology.zones:
            came[zone.camera] += zone.entries
            left[zone.camera] += zone.exits
        heard, linked = self._heard(), linked_cameras(topology)
        most: dict[str, float] = {}
        for (source, target), number in sent.items():
            if self.owns(source) or not self.owns(target):
                continue
            arrivals = came[target] * heard.get(source, 0.0)
            least = min(NEIGHBOUR_ARRIVALS_SHARE * arrivals, NEIGHBOUR_DEPARTURES_SHARE * left[source])
            if (source, target) in linked or number >= max(least, NEIGHBOUR_TRANSITIONS_MIN):
                most[source] = most.get(source, 0.0) + number / max(heard.get(source, 0.0), 1e-9)
        order = sorted(most, key=lambda camera: (-most[camera], camera))
        return order[: NEIGHBOURS_PER_CAMERA_MAX * self.cameras_own]

    def _heard(self) -> dict[str, float]:
        """Share of the window's time since each camera was heard first in it."""
        t, cameras = self._window.column("t"), self._window.cameras
        present, first = np.unique(self._window.column("camera"), return_index=True)
        span = max(int(t[-1] - t[0]), 1) if len(t) else 1
        return {
            cameras[camera]: float(t[-1] - t[row]) / span
            for camera, row in zip(present.tolist(), first.tolist(), strict=True)
        }

    def _refit(self, tick_us: int) -> None:
        if not len(self._window):
            return
        super()._refit(tick_us)
        self._parts += [self._part(topology) for topology in self.updates()]

    def _part(self, topology: Topology) -> Part:
        t = self._window.column("t")
        span = max(float(t[-1] - t[0]) / MICROSECONDS, 1.0)
        count = np.bincount(self._window.column("camera"), minlength=len(self._window.cameras)) / span
        rates = {name: float(count[k]) for k, name in enumerate(self._window.cameras) if self.owns(name)}
        return part_of(topology, self.number, rates, self.hearing.learned)


def linked_cameras(topology: Topology) -> set[tuple[str, str]]:
    """Pairs of cameras, from and to, that published links join."""
    camera_of = {zone.id: zone.camera for zone in topology.zones}
    return {(camera_of[link.from_], camera_of[link.to]) for link in topology.links}


def sent_to(topology: Topology) -> dict[tuple[str, str], float]:
    """Expected transitions from each camera to each, without what may as well be chance."""
    camera_of = {zone.id: zone.camera for zone in topology.zones}
    model = topology.model
    onward = (model.onward if model else None) or []
    doubt = {(row.zone, outcome.to): outcome.doubt for row in onward for outcome in row.next_}
    sent: dict[tuple[str, str], float] = {}
    for link in [*topology.links, *(topology.weak_links or [])]:
        key = camera_of[link.from_], camera_of[link.to]
        sent[key] = sent.get(key, 0.0) + link.transitions * (1.0 - doubt.get((link.from_, link.to), 1.0))
    return sent
