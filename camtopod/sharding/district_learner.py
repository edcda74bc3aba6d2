"""A district: a learner of the links into its own cameras, the cameras that are assigned to it.

All other cameras are *foreign*. A district receives the events of four kinds of cameras: its own;
its *neighbours*, from which objects come to its own; the guests of the turn (`assignment`); and new
cameras. While one of its own cameras is new, it receives every camera of the site.

The joint fit uses the district's own cameras, its neighbours, and the few others that a coarse scan
finds (`neighbour_scan`), whose departures explain arrivals that would otherwise be credited to a
neighbour. The district publishes what belongs to its own cameras (`parts`).

When a turn of event time ends, the newest version decides which cameras are neighbours in the next
turn, and the events of all other foreign cameras are dropped. In the long run the cost of a
district therefore depends on its own cameras, its neighbours and the guests, not on the size of the
site.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Set

import numpy as np
from msgspec import Struct

from camtopod.event_time import MICROSECONDS, microseconds
from camtopod.learn import Learner, LearnerState, Settings
from camtopod.learn.traffic import Scene
from camtopod.records import Event, Topology
from camtopod.sharding.assignment import Assignment
from camtopod.sharding.neighbour_scan import find_nearby, with_cameras
from camtopod.sharding.parts import Part, part_of

NEIGHBOUR_TRANSITIONS_MIN = 2.0
"""Least number of transitions, spurious ones left out, from a neighbour to an own camera."""
NEIGHBOUR_ARRIVALS_SHARE = 0.02
"""Share of the arrivals at an own camera that makes the camera they come from a neighbour."""
NEIGHBOUR_DEPARTURES_SHARE = 0.1
"""Share of a camera's departures, to an own camera, that makes the former a neighbour."""
NEIGHBOURS_PER_CAMERA_MAX = 12
"""Largest number of neighbours, per own camera; of more, those with the most transitions count."""

REGULAR_EVENTS_MIN = 20
"""Least number of events of a camera that is no longer new after a turn.

A camera with fewer events stays new for at most one round of guests. An own camera with fewer
events does not make the district receive all cameras, as names may be invented.
"""
NEWCOMERS_MAX = 8
"""Largest number of foreign cameras with fewer than `REGULAR_EVENTS_MIN` events that may be new at
a time, after a district's first turn.
"""

MET_MAX = 10_000
"""Largest number of cameras that are remembered.

Beyond, the foreign camera that was met first is forgotten; it is new when it is received again.
"""


class NewCamera(Struct):
    """What a district remembers of a camera that it has received.

    The camera is new up to the turn one turn length after its first event, plus ``longer`` turns.
    """

    since_us: int
    """Time of the camera's first event, microseconds."""
    events: int = 0
    """Number of its events that were learned."""
    longer: int = 0
    """Number of additional turns for which it stays new."""


class Membership(Struct):
    """State of a `District` beside the state of its `Learner`."""

    turn: int | None = None
    """Newest turn for which the neighbours have been determined."""
    neighbours: list[str] = []
    """Names of the neighbours, those with the most transitions to the district first."""
    learned: int = 0
    """Number of events of own cameras that were learned."""
    owner: bool = False
    """True once an event of an own camera has been received; before that, no part is made."""
    met: dict[str, NewCamera] = {}
    """Cameras that have been received, in the order of their first events."""


class DistrictState(Struct):
    """Complete state of a `District`."""

    learner: LearnerState
    hearing: Membership


class District(Learner):
    """A `Learner` of the events that concern one district; makes a `Part` with each version.

    dealing: the assignment of cameras to districts.
    number: number of this district.

    hearing: state beside that of the learner.
    """

    def __init__(
        self, settings: Settings, site: str, epoch: str, dealing: Assignment, number: int
    ) -> None:
        super().__init__(settings, site, epoch)
        self.number = number
        self.hearing = Membership()
        self._dealing = dealing
        self._parts: list[Part] = []
        self._new: dict[str, NewCamera] = {}  # the cameras in ``hearing.met`` that may be new

    def owns(self, camera: str) -> bool:
        """Return True if a camera is assigned to this district."""
        return self._dealing.district(camera) == self.number

    def listens(self, camera: str, t: float) -> bool:
        """Return True if an event of a camera at ``t`` (seconds) may be of use.

        If the neighbours in the turn of ``t`` are not determined yet, cameras of use in the last
        determined turn are accepted, too, as they may be neighbours again.
        """
        turn, decided = self._turn_of(microseconds(t)), self.hearing.turn
        searching = any(
            self._is_new(one, turn) for name, one in self._new.items() if self.owns(name)
        )
        if self._uses(camera, turn, searching):
            return True
        return decided is not None and turn > decided and self._uses(camera, decided, searching)

    def receive(self, event: Event) -> str:
        """Receive one event, as `Learner.receive`; return ``unheard`` if it is of no use."""
        if self.owns(event.camera):
            self.hearing.owner = True
            record = self._meet(event.camera, microseconds(event.t))
            record.since_us = min(record.since_us, microseconds(event.t))
        return super().receive(event) if self.listens(event.camera, event.t) else "unheard"

    @property
    def cameras_own(self) -> int:
        """Number of own cameras in the window."""
        return sum(self.owns(camera) for camera in self._window.cameras)

    @property
    def watermark_us(self) -> int | None:
        """The watermark in microseconds: older events are late. None before the first event."""
        return self._intake.watermark_us

    @property
    def held_since_us(self) -> int | None:
        """Last tick before the oldest held event, microseconds; None if no events are held."""
        oldest = self._intake.oldest_held_us
        return None if oldest is None else (oldest - 1) // self._tick_us * self._tick_us

    @property
    def phase(self) -> tuple[int | None, int, bool]:
        """State that `strangers` depends on: turn, number of new cameras, if all are received."""
        regular = any(
            one.events >= REGULAR_EVENTS_MIN and self.owns(name) for name, one in self._new.items()
        )
        return self.hearing.turn, len(self._new), regular

    def strangers(self) -> set[str]:
        """Return the known cameras that are of use as guests only; none while all are received."""
        _, _, searching = self.phase
        return (
            set()
            if searching
            else self.hearing.met.keys() - self._new.keys() - {*self.hearing.neighbours}
        )

    def parts(self) -> list[Part]:
        """Return the parts of the versions made since the last call, oldest first."""
        made, self._parts = self._parts, []
        return made

    def save_all(self) -> DistrictState:
        """Return the state from which `load_all` continues, without parts not fetched yet."""
        return DistrictState(self.save(), self.hearing)

    def load_all(self, state: DistrictState) -> None:
        """Continue from a saved state; this district must be new."""
        self.load(state.learner)
        self.hearing = state.hearing
        turn = self.hearing.turn
        self._new = {
            name: one
            for name, one in self.hearing.met.items()
            if turn is None or self._is_new(one, turn)
        }

    def change(self, change: Callable[[LearnerState], LearnerState]) -> None:
        """Continue with a changed state.

        change: function from the present state of the learner to the new one; it may take event
            time back.
        """
        state = change(self.save())

        # Only a new learner can load a state.
        super().__init__(self.settings, self.site, self.epoch)
        self.load(state)

        if self._done_us is not None and self.hearing.turn is not None:
            self.hearing.turn = min(self.hearing.turn, self._turn_of(self._done_us))

            # Forget cameras that were first met at a later time, by a wrong clock.
            met = self.hearing.met
            for name in [name for name, one in met.items() if one.since_us > self._done_us]:
                del met[name]
                self._new.pop(name, None)

    def forget(self, names: Set[str]) -> None:
        """Forget cameras, as `Learner.forget`."""
        super().forget(names)
        for name in names & self.hearing.met.keys():
            del self.hearing.met[name]
            self._new.pop(name, None)

    def _turn_of(self, t_us: int) -> int:
        """Return the turn of an event at a time: that of its tick, which is learned as a whole."""
        tick = -(-t_us // self._tick_us) * self._tick_us
        return (tick - 1) // self._dealing.turn_us

    def _take(self, until_us: int) -> list[tuple[int, Event]]:
        """Return the held events up to ``until_us`` that are of use, as `Learner._take`."""
        batch = super()._take(until_us)
        turn = self._turn_of(until_us)

        # A new turn: determine the neighbours.
        if self.hearing.turn is not None and turn > self.hearing.turn:
            self._end_turn(self.hearing.turn, turn, until_us)
        self.hearing.turn = turn

        # The events that are of use; none before the first event of an own camera.
        searching = self._searches(until_us, turn)
        useful = [
            (t_us, event)
            for t_us, event in batch
            if self._admit(event.camera, t_us, turn, searching)
        ]
        self.hearing.learned += sum(self.owns(event.camera) for _, event in useful)
        return useful if self.hearing.learned else []

    def _uses(self, camera: str, turn: int, searching: bool) -> bool:
        """Return True if events of a camera are of use in a turn.

        They are if the camera is own, a neighbour, a guest or new.

        searching: True if all cameras are received, because an own camera is new.
        """
        if (
            searching
            or self.owns(camera)
            or camera in self.hearing.neighbours
            or self._dealing.is_guest(camera, turn)
        ):
            return True
        met = self.hearing.met.get(camera)
        return met is None or self._is_new(met, turn)

    def _is_new(self, camera: NewCamera, turn: int) -> bool:
        """Return True if a camera is new in a turn."""
        return turn <= self._turn_of(camera.since_us + self._dealing.turn_us) + camera.longer

    def _searches(self, tick_us: int, turn: int) -> bool:
        """Return True if all cameras are received in a tick, because an own camera is new.

        tick_us, turn: the tick, and the turn that it belongs to.

        The first event of the own camera must lie more than the lateness before the tick: then no
        event of the tick was refused before that camera was known, in whatever order events were
        received.
        """
        before = tick_us - self._tick_us - 2 * self._intake.lateness_us
        return any(
            one.events >= REGULAR_EVENTS_MIN and one.since_us <= before and self._is_new(one, turn)
            for name, one in self._new.items()
            if self.owns(name)
        )

    def _admit(self, camera: str, t_us: int, turn: int, searching: bool) -> bool:
        """Return True if an event is of use, and count it for its camera.

        turn, searching: as for `_uses`.
        """
        if not self._uses(camera, turn, searching):
            return False
        met = self.hearing.met
        if camera not in met and not (
            searching or self.owns(camera) or self._dealing.is_guest(camera, turn)
        ):
            # Refuse a further new foreign camera if there are too many at a time.
            begun = next(iter(met.values())).since_us if met else t_us
            few = sum(
                one.events < REGULAR_EVENTS_MIN and not self.owns(name)
                for name, one in self._new.items()
            )
            if few >= NEWCOMERS_MAX and t_us > begun + self._dealing.turn_us:
                return False
        self._meet(camera, t_us).events += 1
        return True

    def _meet(self, camera: str, t_us: int) -> NewCamera:
        """Return the record of a camera; make one if this event, at ``t_us``, is its first."""
        met = self.hearing.met.get(camera)
        if met is None:
            if len(self.hearing.met) >= MET_MAX:
                first = next((name for name in self.hearing.met if not self.owns(name)), None)
                if first is not None:
                    del self.hearing.met[first]
                    self._new.pop(first, None)
            met = self.hearing.met[camera] = self._new[camera] = NewCamera(t_us)
        return met

    def _end_turn(self, ended: int, following: int, tick_us: int) -> None:
        """Determine the neighbours of the next turn, and forget cameras of no more use.

        ended, following: the turn that ends, and the next one with events.
        tick_us: the tick at which the next turn begins.

        A version is made at this tick first, as the newest one may be as of any earlier moment.
        """
        foreign = [camera for camera in self._window.cameras if not self.owns(camera)]
        if foreign and self._since_fit:
            self._refit(tick_us)
        if foreign and self.topology is not None:
            self.hearing.neighbours = self._find_neighbours(self.topology)

        # Cameras with few events stay new.
        for one in self._new.values():
            if one.events < REGULAR_EVENTS_MIN and not self._is_new(one, following):
                one.longer = min(one.longer + following - ended, self._dealing.sharding.guest_turns)
        self._new = {name: one for name, one in self._new.items() if self._is_new(one, following)}

        searching = self._searches(tick_us, following)
        gone = {camera for camera in foreign if not self._uses(camera, following, searching)}
        if gone:
            super().forget(gone)

    def _find_neighbours(self, topology: Topology) -> list[str]:
        """Return the foreign cameras with enough transitions to own cameras, the most first."""
        # Transitions, arrivals and departures by camera.
        transitions = transitions_between(topology)
        arrivals_of, departures_of = Counter[str](), Counter[str]()
        for zone in topology.zones:
            arrivals_of[zone.camera] += zone.entries
            departures_of[zone.camera] += zone.exits
        time_share, linked = self._heard(), linked_cameras(topology)

        # Transitions of each neighbour, scaled to the whole window.
        scaled: dict[str, float] = {}
        for (source, target), number in transitions.items():
            if self.owns(source) or not self.owns(target):
                continue
            arrivals = arrivals_of[target] * time_share.get(source, 0.0)
            least = min(
                NEIGHBOUR_ARRIVALS_SHARE * arrivals,
                NEIGHBOUR_DEPARTURES_SHARE * departures_of[source],
            )
            if (source, target) in linked or number >= max(least, NEIGHBOUR_TRANSITIONS_MIN):
                scaled[source] = scaled.get(source, 0.0) + number / max(
                    time_share.get(source, 0.0), 1e-9
                )

        order = sorted(scaled, key=lambda camera: (-scaled[camera], camera))
        return order[: NEIGHBOURS_PER_CAMERA_MAX * self.cameras_own]

    def _heard(self) -> dict[str, float]:
        """Return, by camera, the share of the window's duration since the camera's first event."""
        t, cameras = self._window.column("t"), self._window.cameras
        present, first = np.unique(self._window.column("camera"), return_index=True)
        span = max(int(t[-1] - t[0]), 1) if len(t) else 1
        return {
            cameras[camera]: float(t[-1] - t[row]) / span
            for camera, row in zip(present.tolist(), first.tolist(), strict=True)
        }

    def _refit(self, tick_us: int) -> None:
        """Make a version as of ``tick_us`` and its part."""
        if not len(self._window):
            return
        super()._refit(tick_us)
        self._parts += [self._part(topology) for topology in self.updates()]

    def _to_fit(self, scene: Scene) -> Scene:
        """Return the scene with the departures and arrivals of the cameras that are fitted only.

        They are the own cameras, the neighbours, cameras with links into own cameras in the newest
        version, and cameras that `neighbour_scan` finds.
        """
        cameras = self._window.cameras
        own = np.array([self.owns(camera) for camera in cameras], np.bool_)
        known = {*self.hearing.neighbours}
        if self.topology is not None:
            known |= {
                source for source, target in linked_cameras(self.topology) if self.owns(target)
            }

        kept = own | np.array([camera in known for camera in cameras], np.bool_)
        if kept.all() or not own.any():
            return scene
        return with_cameras(scene, kept | find_nearby(scene, own, self.bins))

    def _part(self, topology: Topology) -> Part:
        """Return the part of a version, with the rate of events of each own camera."""
        t = self._window.column("t")
        span = max(float(t[-1] - t[0]) / MICROSECONDS, 1.0)
        count = (
            np.bincount(self._window.column("camera"), minlength=len(self._window.cameras)) / span
        )
        rates = {
            name: float(count[k]) for k, name in enumerate(self._window.cameras) if self.owns(name)
        }
        return part_of(topology, self.number, rates, self.hearing.learned)


def linked_cameras(topology: Topology) -> set[tuple[str, str]]:
    """Return the pairs (from, to) of cameras that published links join."""
    camera_of = {zone.id: zone.camera for zone in topology.zones}
    return {(camera_of[link.from_], camera_of[link.to]) for link in topology.links}


def transitions_between(topology: Topology) -> dict[tuple[str, str], float]:
    """Return the expected transitions from camera to camera, spurious ones left out."""
    camera_of = {zone.id: zone.camera for zone in topology.zones}
    model = topology.model
    onward = (model.onward if model else None) or []
    doubt = {(row.zone, outcome.to): outcome.doubt for row in onward for outcome in row.next_}

    sent: dict[tuple[str, str], float] = {}
    for link in [*topology.links, *(topology.weak_links or [])]:
        key = camera_of[link.from_], camera_of[link.to]
        sent[key] = sent.get(key, 0.0) + link.transitions * (
            1.0 - doubt.get((link.from_, link.to), 1.0)
        )
    return sent
