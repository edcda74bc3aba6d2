"""The learner: events and time go in, versions of the topology come out. Deterministic, whatever
the order of arrival.

Theory of operation. `receive` puts an event into the reorder buffer. Event time is cut into ticks
of ``version_seconds``; when the watermark passes a tick, everything up to it moves into the window,
what is too old is taken back out, and if enough has changed the zones, the joint fit and the links
are refreshed and a version is made. What a version says therefore depends on the events up to its
tick and on nothing else: not on how they were ordered within the lateness, nor on how fast or when
the program ran.

Of a recording often the last version alone is wanted. With ``only_last`` the events are followed as
usual, but the zones alone are learned again when a version is due; `flush` makes the one version.
It is not the one that the versions on the way lead to: it has the number 1, looks at every zone of
a large site at once instead of at a part in each fit, and says nothing of what would have been said
between versions (its own marks, clocks that changed).
"""

from __future__ import annotations

from collections.abc import Callable, Set

import numpy as np
from msgspec.structs import replace

from camtopod.event_time import MICROSECONDS, EventTimeState, microseconds
from camtopod.learn import refit as refits
from camtopod.learn.assemble import assemble, link_records, zone_id
from camtopod.learn.association import FollowedSources
from camtopod.learn.changes import AlarmLog, Move, find_move
from camtopod.learn.clocks import ClockTracker
from camtopod.learn.links import zone_pairs_of
from camtopod.learn.refit import Known, Refit, dwell_bins, lag_bins, refit
from camtopod.learn.retired_cameras import (
    LEFT_CAMERAS_MAX,
    camera_to_replace,
    cameras_to_retire,
    renumber_followed,
)
from camtopod.learn.self_score import Scorer
from camtopod.learn.settings import Settings
from camtopod.learn.snapshot import CameraState, LearnerState, RetiredCamera
from camtopod.learn.traffic import Scene, label_events
from camtopod.learn.window import FORGOTTEN, ReorderBuffer, Window, cells_of
from camtopod.learn.zones import ZoneMap, ZoneShape, find_zones, refresh_zones
from camtopod.predict import Predictor
from camtopod.publishers import RETURNS_MIN, Publisher
from camtopod.records import Event, Topology
from camtopod.topology import with_digest

REFIT_EVENTS_MIN = 10
"""No new version for fewer new events, unless they have waited ``refit_hours``."""
GONE_ZONES_MAX = 32
"""Vanished zones of a camera whose places are remembered, so that one that returns has its number
back.
"""
MOVE_EVENTS = 25
"""After so many events of a camera it is asked again whether it has been turned."""
ZONES_REFRESH_SHARE = 0.1
"""A camera's zones are learned again when this share of its events is new."""
STEPS = ("zones", "clocks", *refits.STEPS)
"""What a version takes, in this order."""


class Learner:
    """The whole chain of the thesis, incremental over a sliding window of event time."""

    def __init__(
        self,
        settings: Settings | None = None,
        site: str = "default",
        epoch: str = "0",
        only_last: bool = False,
    ) -> None:
        self.settings = settings or Settings()
        self.site, self.epoch = site, epoch
        self.only_last = only_last
        """Whether only `flush` makes a version."""
        self.topology: Topology | None = None
        self.on_step: Callable[[str], None] = lambda step: None
        """Called with each of `STEPS` as it begins: what the one before took is free again."""
        self.bins = lag_bins(self.settings)
        self.stay_bins = dwell_bins(self.settings)
        self._intake = ReorderBuffer(
            self.settings.lateness_seconds,
            self.settings.cameras_max,
            self.settings.ahead_seconds_max,
            self.settings.version_seconds,
        )
        self._window = Window(
            self.settings.window_events_max,
            self.settings.window_events,
            self.settings.window_camera_events,
        )
        self._followed: dict[
            int, FollowedSources
        ] = {}  # zones screened in as sources of each, by `place`
        self._keeper = ClockTracker()
        self._alarms = AlarmLog()
        self._scorer = Scorer()
        self._maps: list[ZoneMap] = []
        self._zoned: list[int] = []  # events of the camera when its zones were last learned
        self._gone: list[
            tuple[ZoneShape, ...]
        ] = []  # zones that have vanished, latest first, for when they come back
        self._looked: list[
            int
        ] = []  # events of the camera when it was last asked whether it has been turned
        self._left: dict[str, RetiredCamera] = {}  # the one that left last comes last
        self._moved: list[
            tuple[int, float, Move]
        ] = []  # cameras turned since the last version, and since when
        self._publishers: dict[str, Publisher] = {}
        self._doubled: list[str] = []  # cameras found to have two publishers since the last version
        self._tick_us = microseconds(self.settings.version_seconds)
        self._done_us: int | None = None  # the last tick worked off
        self._fitted_us: int | None = None  # the tick of the newest version
        self._learned = 0
        self._since_fit = 0
        self._updates: list[Topology] = []

    def receive(self, event: Event) -> str:
        """Take one event: ``accepted``, ``duplicate``, ``late`` or ``refused``."""
        if (
            not self._intake.has_room_for(event.camera)
            and (other := camera_to_replace(self._intake, self._window)) is not None
        ):
            self._leave({other})
        verdict = self._intake.receive(event)
        self._work()
        return verdict

    def advance(self, now: float) -> None:
        """Event time has come to ``now`` (seconds) although no event says so."""
        self._intake.advance(microseconds(now))
        self._work()

    def flush(self) -> None:
        """The end of a recording: learn what is still held, whatever the watermark says, and make a
        last version.
        """
        newest = self._intake.newest_us
        if newest is None:
            return
        self._learn(newest)
        self._done_us = newest
        if self._since_fit or self.topology is None:
            self._refit(newest)

    def updates(self) -> list[Topology]:
        """Versions made since the last call, oldest first."""
        made, self._updates = self._updates, []
        return made

    def save(self) -> LearnerState:
        """Everything `load` needs to go on from here. Updates that have not been asked for are not
        in it.
        """
        places = zip(self._maps, self._zoned, self._gone, self._looked, strict=True)
        return LearnerState(
            self.settings,
            self.site,
            self.epoch,
            self.topology,
            self._intake.save(),
            self._window.save(),
            self._keeper.save(),
            self._alarms.save(),
            self._scorer.save(),
            [CameraState(*place) for place in places],
            self._moved,
            self._done_us,
            self._fitted_us,
            self._learned,
            self._since_fit,
            self._followed,
            self._publishers,
            self._doubled,
            self._left,
        )

    def load(self, state: LearnerState) -> None:
        """Go on from there; this learner must be new. With the same settings, site and epoch the
        versions to come are those that the saved one would have made.
        """
        self.topology = state.topology
        self._intake.load(state.intake)
        self._window.load(state.window)
        self._keeper.load(state.clocks)
        self._alarms.load(state.alarms)
        self._scorer.load(state.scorer, state.topology)
        self._maps = [camera.zones for camera in state.cameras]
        self._zoned = [camera.zoned for camera in state.cameras]
        self._gone = [camera.gone for camera in state.cameras]
        self._looked = [camera.looked for camera in state.cameras]
        self._moved, self._done_us, self._fitted_us = state.moved, state.done_us, state.fitted_us
        self._learned, self._since_fit = state.learned, state.since_fit
        self._publishers, self._doubled = state.publishers, state.doubled
        self._followed, self._left = state.followed, state.left

    def forget(self, names: Set[str]) -> None:
        """Forget cameras as if they had never been heard, but for their events that wait for the
        watermark; what was learned of others through them stays. The next version is without them.
        """
        self._forget(names)
        self._alarms.forget(names)
        for name in names & self._left.keys():
            del self._left[name]

    def begin_epoch(self, epoch: str) -> None:
        """What is known stays; versions count from 1 again."""
        self.epoch, self.topology, self._fitted_us = epoch, None, None
        self._alarms.newest = []

    def refresh(self) -> None:
        """Make the first version of the epoch of what is known already, if anything is."""
        if self.topology is None and self._done_us is not None and len(self._window):
            self._refit(self._done_us)

    def next_deadline(self) -> float | None:
        """Event time (seconds) to which `advance` would have to go for something to happen; None:
        nothing waits.
        """
        oldest = self._intake.oldest_held_us
        if oldest is None:
            return None
        tick = -(-oldest // self._tick_us) * self._tick_us
        return (tick + self._intake.lateness_us + 1) / MICROSECONDS

    def event_time(self) -> EventTimeState:
        """How far event time has come."""
        return self._intake.time.save()

    def predictor(self) -> Predictor:
        """Prediction over the newest version. Raises RuntimeError before the first."""
        if self.topology is None:
            raise RuntimeError("no version has been learned yet")
        return Predictor(self.topology)

    def statistics(self) -> dict[str, int | float]:
        """Counts and sizes, for people and for health checks."""
        watermark = self._intake.watermark_us
        return {
            **self._intake.counts,
            "surplus": self._intake.surplus,
            "held": self._intake.held_count,
            "learned": self._learned,
            "window": len(self._window),
            "cameras": len(self._window.cameras),
            "watermark": 0.0 if watermark is None else watermark / MICROSECONDS,
            "version": 0 if self.topology is None else self.topology.version,
        }

    def _work(self) -> None:
        """Work off every tick the watermark has passed that has something to do."""
        watermark = self._intake.watermark_us
        if watermark is None:
            return
        reached = (
            (watermark - 1) // self._tick_us * self._tick_us
        )  # an event at the watermark may still come
        if self._done_us is not None and reached <= self._done_us:
            return
        while (oldest := self._intake.oldest_held_us) is not None:
            tick = -(-oldest // self._tick_us) * self._tick_us
            if tick > reached:
                break
            self._learn(tick)
            if not self._due(tick):
                continue
            if self.only_last:
                self._refresh_zones()
                self._fitted_us, self._since_fit = tick, 0
            else:
                self._refit(tick)
        self._done_us = reached

    def _learn(self, until_us: int) -> None:
        """Move the events up to ``until_us`` into the window and forget what is too old."""
        batch = self._take(until_us)
        if not self.only_last:
            self._scorer.watch(batch)
        self._window.append(batch)
        window_us = microseconds(self.settings.window_hours * 3600.0)
        self._window.forget_old(until_us - window_us)
        if left := cameras_to_retire(self._intake, self._window, until_us, window_us):
            self._leave(left)
        self._look_for_moves()
        self._look_for_doubles(batch)
        self._learned += len(batch)
        self._since_fit += len(batch)

    def _take(self, until_us: int) -> list[tuple[int, Event]]:
        """The events up to ``until_us``, in canonical order."""
        return self._intake.take_until(until_us)

    def _leave(self, names: Set[str]) -> None:
        """Forget cameras, but for what gives their zones their numbers back, and that they fell
        silent.
        """
        for name, zones, gone in zip(self._window.cameras, self._maps, self._gone, strict=False):
            if name in names:
                self._left[name] = RetiredCamera(
                    (zones.zones + gone)[:GONE_ZONES_MAX], zones.next_number
                )
        self._forget(names)
        while len(self._left) > LEFT_CAMERAS_MAX:
            first = next(iter(self._left))
            del self._left[first]
            self._alarms.forget({first})

    def _forget(self, names: Set[str]) -> None:
        number = self._window.forget_cameras(names)
        kept = number != FORGOTTEN
        self._intake.forget(names)
        self._scorer.forget(names)
        self._keeper.keep_cameras(kept)
        stay = np.flatnonzero(kept[: len(self._maps)])
        self._maps, self._zoned = [self._maps[k] for k in stay], [self._zoned[k] for k in stay]
        self._gone, self._looked = [self._gone[k] for k in stay], [self._looked[k] for k in stay]
        self._moved = [
            (int(number[camera]), since, move)
            for camera, since, move in self._moved
            if kept[camera]
        ]
        self._publishers = {
            name: one for name, one in self._publishers.items() if name not in names
        }
        self._doubled = [name for name in self._doubled if name not in names]
        self._followed = renumber_followed(self._followed, number)

    def _due(self, tick_us: int) -> bool:
        """Whether enough has changed for a new version."""
        if self._since_fit == 0:
            return False
        if self._fitted_us is None or self._since_fit >= self._enough():
            return True
        if (self._moved or self._doubled) and not self.only_last:
            return True
        return tick_us - self._fitted_us >= microseconds(self.settings.refit_hours * 3600.0)

    def _enough(self) -> float:
        """New events that make a new version due."""
        return max(REFIT_EVENTS_MIN, self.settings.refit_share * len(self._window))

    def _refit(self, tick_us: int) -> None:
        """Make one version as of ``tick_us``: refresh the zones, refit, publish."""
        self.on_step("zones")
        self._refresh_zones()
        self.on_step("clocks")
        scene = self._to_fit(self._corrected(label_events(self._window, self._maps)))

        known = Known(self._followed, self._learned, self.only_last, self._scorer.waiting)
        clocks = self._keeper.clocks
        found = refit(scene, self._window, clocks, known, self.settings, self.on_step)
        self._followed = found.followed
        self._scorer.mark(found.happened)

        self.topology = self._version_of(found, tick_us)
        self._scorer.use(self.topology, self._enough())
        self._updates.append(self.topology)
        self._fitted_us, self._since_fit = tick_us, 0

    def _version_of(self, found: Refit, tick_us: int) -> Topology:
        """Return the next version: what a refit has found, and what has happened since the last."""
        cameras, scene, bins = self._window.cameras, found.scene, self.bins
        between = link_records(cameras, scene, found.published, bins)
        visible = link_records(cameras, scene, found.visible, self.stay_bins, "visible")
        weak = link_records(cameras, scene, found.weak, bins, histograms=False, lacks=found.lacks)
        topology = assemble(
            self.settings,
            self._window,
            scene,
            found.model,
            self._keeper.clocks,
            links=between + visible,
            weak_links=weak,
        )

        version = 1 if self.topology is None else self.topology.version + 1
        now = tick_us / MICROSECONDS
        self._report(found, topology, version, now)
        return with_digest(
            replace(
                topology,
                site=self.site,
                epoch=self.epoch,
                version=version,
                as_of=now,
                events=self._learned,
                alarms=self._alarms.newest or None,
                score=self._scorer.score(),
            )
        )

    def _report(self, found: Refit, topology: Topology, version: int, now: float) -> None:
        """Raise an alarm for each change that this version is the first to show."""
        cameras, scene = self._window.cameras, found.scene
        ids = [zone_id(cameras, zone) for zone in scene.zones]
        if self.only_last:  # no earlier version has published the links that have closed
            self._alarms.join(ids, zone_pairs_of(found.found))
        self._alarms.report(
            version,
            now,
            scene,
            ids,
            cameras,
            found.silences,
            found.changes,
            zone_pairs_of(found.published),
            self.settings.publish_probability_min,
        )
        self._alarms.clocks(version, now, topology.cameras)

        for camera, since, move in self._moved:
            detail = (
                f"{move.outside:.2f} of {move.events} events outside its zones since {since:.0f}"
            )
            self._alarms.add(version, now, "camera_moved", cameras[camera], detail)
        for name in self._doubled:
            publisher = self._publishers[name]
            detail = (
                "two programs publish it at the same time, "
                f"boots {publisher.before} and {publisher.boot}"
            )
            self._alarms.add(version, now, "camera_doubled", name, detail)
        self._moved, self._doubled = [], []

    def _look_for_moves(self) -> None:
        """What a camera saw before it was turned is forgotten, and its zones get new numbers."""
        window = self._window
        due = [
            camera
            for camera in range(len(self._maps))
            if window.seen[camera] - self._looked[camera] >= MOVE_EVENTS
        ]
        rows_of_camera = window.rows_of_cameras() if due else []
        for camera in due:
            seen = self._looked[camera] = window.seen[camera]
            rows = rows_of_camera[camera]
            rows = rows[window.column("px")[rows] >= 0]
            px, py = (window.column(name)[rows].astype(np.int64) for name in ("px", "py"))
            move = find_move(cells_of(px, py), self._maps[camera].cells)
            if move:
                since = float(window.column("t")[rows[move.first]] / MICROSECONDS)
                window.forget_camera(camera, window.base + int(rows[move.first]))
                self._maps[camera] = find_zones(
                    window.cell_sums(camera), (), self._maps[camera].next_number
                )
                self._zoned[camera], self._gone[camera] = seen, ()
                self._moved.append((camera, since, move))
                rows_of_camera = window.rows_of_cameras()

    def _look_for_doubles(self, batch: list[tuple[int, Event]]) -> None:
        """Cameras that two programs publish at the same time are said once for each two."""
        for _, event in batch:
            if event.boot is None:
                continue
            publisher = self._publishers.setdefault(event.camera, Publisher(event.boot))
            if publisher.note_boot(event.boot) and publisher.returns == RETURNS_MIN:
                self._doubled.append(event.camera)

    def _refresh_zones(self) -> None:
        """Learn the zones of every camera again whose events have changed enough."""
        for camera in range(len(self._window.cameras)):
            seen = self._window.seen[camera]
            if camera == len(self._maps):
                left = self._left.pop(self._window.cameras[camera], RetiredCamera())
                self._maps.append(
                    find_zones(self._window.cell_sums(camera), left.zones, left.next_number)
                )
                self._zoned.append(seen)
                self._looked.append(seen)
                self._gone.append(_vanished(left.zones, self._maps[camera]))
            elif seen - self._zoned[
                camera
            ] >= ZONES_REFRESH_SHARE * self._window.count_with_position(camera):
                old = self._maps[camera]
                known = old.zones + self._gone[camera]
                new = refresh_zones(self._window.cell_sums(camera), old, self._gone[camera])
                self._maps[camera], self._zoned[camera], self._gone[camera] = (
                    new,
                    seen,
                    _vanished(known, new),
                )

    def _corrected(self, scene: Scene) -> Scene:
        """Estimate the clock offsets, and return the scene with its times corrected by them."""
        self._keeper.update(scene, len(self._window.cameras), self._learned)
        offset = self._keeper.clocks.offset
        return label_events(self._window, self._maps, offset) if offset.any() else scene

    def _to_fit(self, scene: Scene) -> Scene:
        """Return the part of the scene that is fitted. A `District` leaves cameras out."""
        return scene


def _vanished(known: tuple[ZoneShape, ...], now: ZoneMap) -> tuple[ZoneShape, ...]:
    """The zones that are not in the map now."""
    numbers = {zone.number for zone in now.zones}
    return tuple(zone for zone in known if zone.number not in numbers)[:GONE_ZONES_MAX]
