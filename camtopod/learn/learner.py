"""The learner: takes entry and exit events, makes versions of the camera network topology.

`Learner.receive` puts an event into the reorder buffer. Event time is cut into ticks of
``version_seconds``, shorter ones before the first version. When the watermark passes a tick, the
events up to it move from the buffer into the sliding window, events that are too old leave the
window, and if enough events are new, a version is made: the zones are learned again, `refit`
estimates links and the prediction model, and `assemble` builds the `Topology`. So a version depends
only on the events up to its tick, not on the order in which they were received (within the
lateness), nor on when or how fast the program runs.
No event is too late: one that comes after its tick enters the window at its time, with the next
tick, and counts from the next version on.

From a recording, often only the last version is wanted. With ``only_last``, no version is made
before `Learner.flush`; only the zones, which tell turned cameras, are learned again now and then.
The single version has number 1. It differs from the last version of a usual run: on a large site,
all zones are screened for links at once instead of a part in each fit, and scores of past
predictions and alarms of changed clocks are missing, as both come from earlier versions.
"""

from __future__ import annotations

from collections.abc import Callable, Set
from copy import deepcopy

from msgspec.structs import replace

from camtopod.codec import require_event
from camtopod.event_time import MICROSECONDS, EventTimeState, microseconds
from camtopod.learn import refit as refits
from camtopod.learn.assemble import (
    assemble,
    empty_topology,
    link_records,
    with_provisional,
    zone_id,
)
from camtopod.learn.camera_zones import find_moved_cameras, moved_news, refresh_camera_zones
from camtopod.learn.changes import AlarmLog, News
from camtopod.learn.declarations import declared_by
from camtopod.learn.doubled_cameras import doubled_news, find_doubled_cameras
from camtopod.learn.due_versions import (
    are_zones_due,
    events_for_version,
    is_version_due,
    last_tick_before,
    tick_length,
    tick_of,
)
from camtopod.learn.lag_range import shortest_bins
from camtopod.learn.limits import ZONES_PER_CAMERA_MAX
from camtopod.learn.links import zone_pairs_of
from camtopod.learn.refit import Known, Refit, refit
from camtopod.learn.retired_cameras import camera_to_replace, cameras_to_retire, forget_cameras
from camtopod.learn.self_score import Scorer
from camtopod.learn.settings import Settings
from camtopod.learn.snapshot import LearnerState, RetiredCamera
from camtopod.learn.traffic import label_events
from camtopod.learn.window import ReorderBuffer, Window
from camtopod.predict import Predictor
from camtopod.records import Event, Topology
from camtopod.topology import dwell_bins, evidence_for_links, with_digest

STEPS = ("zones", "clocks", *refits.STEPS)
"""Names of the steps that make a version, in order."""


class Learner:
    """Learns a topology from events, version by version, over a sliding window of event time.

        >>> from camtopod import Event, Learner
        >>> learner = Learner()
        >>> learner.receive(Event("lobby", "exit", 1_700_000_000.0))
        'accepted'
        >>> learner.flush()  # at the end of a recording
        >>> [topology.version for topology in learner.updates()]
        [1]

    settings: None for the defaults.
    site, epoch: written into each version.
    only_last: make one version only, in `flush`.
    """

    def __init__(
        self,
        settings: Settings | None = None,
        site: str = "default",
        epoch: str = "0",
        only_last: bool = False,
    ) -> None:
        self.only_last = only_last
        """True if only `flush` makes a version."""
        self.pauses = False
        """True to stop behind each version until `resume`; ask `is_paused`."""
        self.on_step: Callable[[str], None] = lambda step: None
        """Called with the name of each of `STEPS` as the step begins.

        The memory of the step before is free again at that moment.
        """
        self._updates: list[Topology] = []
        self._use(LearnerState(settings or Settings(), site, epoch))

    def _use(self, state: LearnerState) -> None:
        """Go on from a state."""
        settings = state.settings
        self.state = state
        self._intake = ReorderBuffer(
            settings.lateness_seconds, settings.cameras_max, settings.ahead_seconds_max
        )
        self._intake.load(state.intake)
        self._window = Window(
            settings.window_events,
            settings.window_camera_events,
            settings.window_events_max,
            state.window,
        )
        self._alarms = AlarmLog(state.alarms)
        self._scorer = Scorer(state.scorer, state.topology)

    @property
    def settings(self) -> Settings:
        """The settings."""
        return self.state.settings

    @property
    def site(self) -> str:
        """Name of the site."""
        return self.state.site

    @property
    def epoch(self) -> str:
        """The epoch of the versions."""
        return self.state.epoch

    @property
    def topology(self) -> Topology | None:
        """The newest version; None before the first one of the epoch."""
        return self.state.topology

    def receive(self, event: Event) -> str:
        """Receive one event, process the ticks that it completes, and return the verdict.

        It is accepted, late, duplicate or refused (too many cameras). Late events are learned, too.
        Raises as `require_event`.
        """
        require_event(event)
        if (
            not self._intake.has_room_for(event.camera)
            and (camera := camera_to_replace(self._intake, self._window)) is not None
        ):
            self._retire({camera})
        verdict = self._intake.receive(event)
        self.resume()
        return verdict

    def advance(self, now: float) -> None:
        """Advance event time to ``now`` (seconds) without an event, and process passed ticks."""
        self._intake.time.advance(microseconds(now))
        self.resume()

    def wait_for(self, cameras: Set[str]) -> None:
        """Wait for these cameras, which deliver a backlog, and no others (`EventTime.wait_for`)."""
        self._intake.time.wait_for(cameras)
        self.resume()

    def flush(self) -> None:
        """End a recording: learn the held events without waiting for the watermark, make a version.

        No version is made if no event is new since the last one.
        """
        newest = self._intake.time.state.newest_us
        if newest is None:
            return
        self._learn(newest)
        self.state.done_us = newest
        if self.state.since_fit or self.topology is None:
            self._refit(newest, is_last=True)

    def updates(self) -> list[Topology]:
        """Return the versions made since the last call, oldest first."""
        versions, self._updates = self._updates, []
        return versions

    def save(self) -> LearnerState:
        """Return a copy of the state, from which `load` continues; fetch the `updates` before."""
        state = deepcopy(replace(self.state, topology=None))
        state.topology = self.state.topology
        state.scorer.predictor = self._scorer.predictor_state()
        return state

    def load(self, state: LearnerState) -> None:
        """Continue from a saved state, with this learner's settings, site and epoch.

        If they are the same, later versions are those that the saved learner would have made.
        """
        self._use(replace(state, settings=self.settings, site=self.site, epoch=self.epoch))

    def erase(self, names: Set[str]) -> bool:
        """Forget cameras with their alarms and held events; return False if unknown.

        The evidence of their events about other cameras is kept. `camtopod.learn.rename` renames a
        camera.
        """
        cameras = names & {*self._window.cameras, *self._intake.state.newest, *self.state.retired}
        self._intake.drop_held(names)
        self._forget(names)
        self._alarms.erase(names)
        for name in names & self.state.retired.keys():
            del self.state.retired[name]
        return bool(cameras)

    def make_version(self) -> None:
        """Make a version at once from the present window; do nothing before the first event."""
        if self.state.done_us is not None and (self.topology is not None or len(self._window)):
            self._refit(self.state.done_us)

    def begin_empty(self, t: float, after: Topology | None) -> None:
        """Make a version without cameras, as of ``t`` (Unix seconds).

        This learner must be new. Events before ``t`` must not be passed to it.

        after: the version before it in this epoch; None if it is the first.
        """
        self.state.topology = after
        tick_us = tick_length(self.state, self.only_last)
        self.state.done_us = microseconds(t) // tick_us * tick_us
        self._refit(self.state.done_us)
        self.state.fitted_us = None  # the next version is due with the first events

    def begin_epoch(self, epoch: str) -> None:
        """Begin an epoch: the learned state stays, versions count from 1 again."""
        self.state.epoch = epoch
        self.state.topology = self.state.fitted_us = None
        self.state.alarms.newest = []
        self._scorer = Scorer(self.state.scorer, None)

    def next_deadline(self) -> float | None:
        """Return the event time (seconds) at which the oldest held event is learned, if any."""
        oldest = self._intake.oldest_held_us
        if oldest is None:
            return None
        learned_us = tick_of(oldest, self.state, self.only_last) + self._intake.time.lateness_us
        return (learned_us + 1) / MICROSECONDS

    def event_time(self) -> EventTimeState:
        """Return the state of event time and watermark."""
        return self._intake.time.state

    def predictor(self) -> Predictor:
        """Return a predictor with the newest version; raise RuntimeError before the first."""
        if self.topology is None:
            raise RuntimeError("no version has been learned yet")
        return Predictor(self.topology)

    def statistics(self) -> dict[str, int | float | None]:
        """Return counts and sizes by name, for people and for health checks."""
        watermark = self._intake.time.state.watermark_us
        return {
            **self._intake.state.counts,
            "held": len(self._intake.state.held),
            "learned": self.state.learned,
            "window": len(self._window),
            "cameras": len(self._window.cameras),
            "watermark": watermark and watermark / MICROSECONDS,
            "version": self._next_version - 1,
            "labels_left_out": self._window.labels_left_out,
        }

    def resume(self) -> None:
        """Learn every tick with events that the watermark has passed; make the versions due."""
        # An event at the watermark may still be received.
        watermark, done_us = self._intake.time.state.watermark_us, self.state.done_us
        if watermark is None or last_tick_before(watermark, self.state, self.only_last) == done_us:
            return
        while (oldest := self._intake.oldest_held_us) is not None:
            tick = tick_of(oldest, self.state, self.only_last)
            if tick >= watermark:
                break
            self._learn(tick)
            self.state.done_us = tick
            if self.only_last:
                if are_zones_due(self.state, self._window):
                    refresh_camera_zones(self.state, self._window)
                    self.state.since_fit = 0
            elif is_version_due(self.state, self._window, tick):
                self._refit(tick)
                if self.pauses:
                    return
        self.state.done_us = last_tick_before(watermark, self.state, self.only_last)

    @property
    def is_paused(self) -> bool:
        """True if there are ticks to learn."""
        watermark, oldest = self._intake.time.state.watermark_us, self._intake.oldest_held_us
        if watermark is None or oldest is None:
            return False
        return tick_of(oldest, self.state, self.only_last) < watermark

    def _learn(self, until_us: int) -> None:
        """Move the held events up to ``until_us`` into the window, and remove old ones from it."""
        # Predict the next camera of some exits, to be scored once the outcome is known.
        events = self._intake.take_until(until_us)
        batch = self._window.without_repeats(events)
        self._intake.note_repeats(len(events) - len(batch))
        if not self.only_last:
            self._scorer.watch(batch)

        # Move the window.
        self._window.append(batch)
        window_us = microseconds(self.settings.window_hours * 3600.0)
        self._window.forget_old(until_us - window_us)

        # Retire silent cameras; find turned cameras and those that two programs publish.
        if silent := cameras_to_retire(self._intake, self._window, until_us, window_us):
            self._retire(silent)
        find_moved_cameras(self.state, self._window)
        find_doubled_cameras(self.state, batch)
        self.state.learned += len(batch)
        self.state.since_fit += len(batch)

    def _retire(self, names: Set[str]) -> None:
        """Forget cameras that no longer report, but remember their zones and their silence.

        Their zones get their numbers back, and `AlarmLog` reports their return, if they report
        again.
        """
        # Remember the zones.
        for name, camera in zip(self._window.cameras, self.state.cameras, strict=False):
            if name in names:
                zones = (camera.zones.zones + camera.vanished)[:ZONES_PER_CAMERA_MAX]
                self.state.retired[name] = RetiredCamera(zones, camera.zones.next_number)

        # Forget the rest, and the cameras retired first if there are too many.
        self._forget(names)
        while len(self.state.retired) > self.settings.cameras_max:
            first = next(iter(self.state.retired))
            del self.state.retired[first]
            self._alarms.erase({first})

    def _forget(self, names: Set[str]) -> None:
        """Forget cameras in every part of the learner that numbers or names cameras."""
        number = self._window.forget_cameras(names)
        self._intake.forget(names)
        self._scorer.forget(names)
        forget_cameras(self.state, names, number)

    def _refit(self, tick_us: int, is_last: bool = False) -> None:
        """Make a version as of ``tick_us``: refresh the zones, estimate the clocks, refit.

        is_last: True to learn zones and clocks from the window alone, as no version will follow.
        """
        if not len(self._window):  # all cameras were forgotten
            self._publish(empty_topology(self.settings, shortest_bins()), tick_us)
            return
        self.on_step("zones")
        refresh_camera_zones(self.state, self._window, anew=is_last)

        # Label the events by their zones, in time corrected by the clock offsets.
        self.on_step("clocks")
        maps = [camera.zones for camera in self.state.cameras]
        scene = label_events(self._window, maps)
        self.state.clocks.update(scene, len(self._window.cameras), self.state.learned, is_last)
        clocks = self.state.clocks.clocks
        if clocks.offset.any():
            scene = label_events(self._window, maps, clocks.offset)
        state = self.state
        pairs = declared_by(self.settings.topology, state.names or {}, self._window.cameras)
        facts = Known(state.followed, state.learned, self.only_last, state.scorer.waiting, pairs)
        result = refit(scene, self._window, clocks, facts, self.settings, self.on_step)
        self.state.followed = result.sources_by_place
        self._scorer.mark(result.outcomes)

        self._publish(self._topology_of(result, tick_us), tick_us)

    def _topology_of(self, result: Refit, tick_us: int) -> Topology:
        """Return the topology that follows from a refit; raise the alarms of its changes."""
        cameras = self._window.cameras
        now = tick_us / MICROSECONDS
        oldest = float(self._window.column("t")[0]) / MICROSECONDS
        news = self._alarms.repeats(now, oldest, cameras, result.repeats)
        repeats = self.state.alarms.repeats
        scene = result.scene
        bins = result.bins
        between = link_records(cameras, scene, result.published_links, bins)
        visible = link_records(cameras, scene, result.visible, dwell_bins(), "visible")
        weak = link_records(cameras, scene, result.weak, bins, histograms=False, lacks=result.lacks)
        topology = assemble(
            self.settings,
            self._window,
            scene,
            result.model,
            self.state.clocks.clocks,
            links=with_provisional(between + visible, repeats),
            weak_links=with_provisional(weak, repeats),
        )

        self._report(result, topology, now, news)
        return topology

    @property
    def _next_version(self) -> int:
        return 1 if self.topology is None else self.topology.version + 1

    def _publish(self, topology: Topology, tick_us: int) -> None:
        """Hand out a version: a topology with the fields that only the learner knows.

        From here on the learner predicts with it.
        """
        version = with_digest(
            replace(
                topology,
                site=self.site,
                epoch=self.epoch,
                version=self._next_version,
                as_of=tick_us / MICROSECONDS,
                events=self.state.learned,
                alarms=self.state.alarms.newest or None,
                score=self._scorer.score(),
                evidence=evidence_for_links(topology, self.topology),
            )
        )
        self.state.topology = version
        self.state.fitted_us = tick_us
        self.state.since_fit = 0
        if not self.only_last:
            self._scorer.use(version, events_for_version(self.state, self._window))
        self._updates.append(version)

    def _report(self, result: Refit, topology: Topology, now: float, news: list[News]) -> None:
        """Raise alarms for ``news`` and for each change that this version is the first to show."""
        cameras = self._window.cameras
        ids = [zone_id(cameras, zone) for zone in result.scene.zones]
        if self.only_last:  # no earlier version has published the links that have closed
            self._alarms.join(ids, zone_pairs_of(result.significant_links))
        news = [
            *news,
            *self._alarms.changes(
                now,
                result.scene,
                ids,
                cameras,
                result.silences,
                result.changes,
                zone_pairs_of(result.published_links),
                self.settings.publish_probability_min,
            ),
            *self._alarms.clocks(topology.cameras, self.settings.overlap_tolerance_seconds),
        ]
        news += moved_news(self.state, cameras) + doubled_news(self.state)
        self._alarms.add(self._next_version, now, news)
        self.state.moved, self.state.doubled = [], []
