"""Follow a site's bus for the page: newest map, health, live news; forward changes to open pages.

Two threads besides the bus's own: *versions* follows the topology and makes its map once a version;
*messages* processes predictions, events and status from a bounded queue. The bus's threads only
fill that queue.
"""

from __future__ import annotations

import contextlib
import logging
import math
import queue
import re
import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import msgspec

from camtopod import codec
from camtopod.predict import seen_now
from camtopod.publishers import is_gone
from camtopod.records import (
    CAMERA_PATTERN,
    CameraFigures,
    CatchingUp,
    DaemonStatus,
    Event,
    Look,
    NextCamera,
    Prediction,
    Topology,
)
from camtopod.serve.bus import Bus, TopologySubscriber
from camtopod.serve.runtime import Beat, Clock, no_beat
from camtopod.web.explanations import Explanations
from camtopod.web.hourly_events import HourlyEvents
from camtopod.web.map_data import Map, change, draw
from camtopod.web.outbox import PageQueues
from camtopod.web.versions import VersionSummary, summary

log = logging.getLogger(__name__)

INBOX_MAX = 10_000
"""Messages from the bus that wait to be processed; beyond it they are dropped and counted."""
CAMERAS_MAX = 5_000
"""Cameras whose status is kept."""
PREDICTIONS_PER_SECOND_MAX = 25
"""Predictions forwarded per second, of all cameras together; people cannot follow more."""
PREDICTIONS_HELD = 20
"""Predictions kept for pages that connect later."""
VERSIONS_MAX = 500
"""Versions on the time line; beyond it the oldest are forgotten."""
NEXT_SHOWN = 3
"""Next cameras of a prediction that the page receives."""
SILENT_STATUSES = 6
"""Status intervals without a status after which a daemon is not live and a grabber is silent."""
_TICK_SECONDS = 0.2
DAEMON = "daemon"
WAITING = "waiting for the daemon"
"""Reason while no status of the daemon has been received yet."""
GONE = "gone"
"""State of a camera that is gone."""
ENDED = "ended"
"""State of a camera whose recording has ended, so that its silence is expected."""


class ShownPrediction(msgspec.Struct, frozen=True, rename={"next_": "next"}):
    """A prediction for the page, without a track."""

    camera: str
    zone: str | None
    t: float
    version: int
    leave: float
    look: list[Look]
    """Where views overlap: cameras that probably see the object at ``t``, or else see it next."""
    now: list[Look]
    """Cameras that probably see the object at ``t``, when it has left the view of ``camera``."""
    next_: list[NextCamera]


def shown(prediction: Prediction) -> ShownPrediction:
    """Return the prediction in the form for the page."""
    return ShownPrediction(
        prediction.camera,
        prediction.zone,
        prediction.t,
        prediction.version,
        prediction.leave,
        [one for one in prediction.look or [] if one.camera != prediction.camera][:NEXT_SHOWN],
        seen_now(prediction.in_view or []),
        prediction.next_[:NEXT_SHOWN],
    )


class Feed:
    """Follower of one site's bus; run `follow_versions` and `follow_messages` in a thread
    each.

    status_seconds: interval in which the daemon publishes its status.
    """

    def __init__(
        self, bus: Bus, page_queues: PageQueues, clock: Clock, status_seconds: float
    ) -> None:
        self._bus = bus
        self._page_queues = page_queues
        self._clock = clock
        self._silent_seconds = SILENT_STATUSES * status_seconds
        self._inbox: queue.Queue[tuple[str, bytes]] = queue.Queue(INBOX_MAX)
        self._mutex = threading.Lock()
        self._status: dict[str, dict[str, Any]] = {}
        self._daemon: DaemonStatus | None = None
        self._heard: dict[str, float] = {}
        self._silent: set[str] = set()
        self._forgotten: set[str] = set()
        self._looked_at_cameras = -1e18
        self._unheard_since = clock()  # no status can arrive while the bus is unreachable
        self._live: dict[str, Any] = {
            "live": False,
            "reason": WAITING,
            "since": clock(),
            "catching_up": None,
        }
        self._predictions: deque[bytes] = deque(maxlen=PREDICTIONS_HELD)
        self._second = 0
        self._this_second = 0
        self._watched: dict[str, tuple[int, Callable[[], None]]] = {}
        self._view = TopologySubscriber(bus)
        self._hourly = HourlyEvents()
        self.topology: Topology | None = None
        """The newest version."""
        self.explanations: Explanations | None = None
        """Details of the newest version."""
        self.versions: list[VersionSummary] = []
        """Versions of the newest epoch since this server began, oldest first; never changed."""
        self.map: Map | None = None
        self.map_json = b"null"
        self.dropped = 0
        """Messages dropped because the queue was full."""
        bus.subscribe("status/*", self._put)
        bus.subscribe("prediction/*", self._put)

    def follow_versions(self, stop: threading.Event, beat: Beat = no_beat) -> None:
        """Follow the topology until ``stop`` is set."""
        while not stop.wait(_TICK_SECONDS):
            beat()
            if (newest := self._view.update()) is not None:
                self.show(newest)

    def show(self, topology: Topology) -> None:
        """Show a version from now on."""
        # The version before, unless a new epoch has begun.
        before = self.topology
        if before is not None and before.epoch != topology.epoch:
            before = None
            self.versions = []
            with self._mutex:
                self._predictions.clear()

        # Everything that the page asks for.
        old_map = self.map
        new_map = draw(topology, old_map)
        self.topology = topology
        self.explanations = Explanations(topology)
        self.versions = [*self.versions, summary(topology, before)][-VERSIONS_MAX:]
        self.map = new_map
        self.map_json = codec.to_json(new_map)

        # Open pages need what has changed only.
        if before is not None and old_map is not None:
            self._page_queues.send("map", codec.to_json(change(old_map, new_map)))
        else:
            self._page_queues.send("resync", b"{}")

    def follow_messages(self, stop: threading.Event, beat: Beat = no_beat) -> None:
        """Process queued messages, and notice when the daemon falls silent, until ``stop``."""
        for key, payload in self._bus.query("status/*"):
            self._on_status(key.removeprefix("status/"), payload)
        while not stop.is_set():
            beat()
            with contextlib.suppress(queue.Empty):
                key, payload = self._inbox.get(timeout=_TICK_SECONDS)
                kind, _, name = key.partition("/")
                {
                    "status": self._on_status,
                    "prediction": self._on_prediction,
                    "event": self._on_event,
                }[kind](name, payload)
            self._look()

    def hello(self) -> bytes:
        """Return the first messages for a page that has just connected: server-sent events."""
        with self._mutex:
            live = msgspec.json.encode(self._live)
            predictions = list(self._predictions)
        version = self.map and [self.map.epoch, self.map.version]
        lines = [
            b"event: live\ndata: " + live,
            b"event: version\ndata: " + msgspec.json.encode(version),
            *(b"event: past\ndata: " + one for one in predictions),
        ]
        return b"".join(line + b"\n\n" for line in lines)

    def beat(self) -> bytes:
        """Return the message that keeps an idle connection alive."""
        return b'event: beat\ndata: {"now":%.3f}\n\n' % self._clock()

    def health(self) -> dict[str, Any]:
        """Return the status of the daemon and of every camera, and whether they are live."""
        now = self._clock()  # taken first, so that the data are at least as new
        with self._mutex:
            ended = self._forgotten & self._silent
            status = {name: one for name, one in self._status.items() if name not in ended}
            live = dict(self._live)
            daemon = self._daemon
        figures = daemon or DaemonStatus()
        known = figures.cameras
        drawn = self.map.cameras if self.map else {}
        learned = self.explanations.last_events if self.explanations else {}
        rows = [
            _row(name, self._word(name, status.get(name)), known.get(name), learned.get(name))
            for name in sorted({*status, *known, *drawn})
        ]
        _mark_gone(rows, self.map.as_of if self.map is not None else 0.0)
        return {
            "now": now,
            "live": live,
            "dropped": self.dropped,
            "daemon": {
                name: value
                for name, value in ({} if daemon is None else msgspec.to_builtins(daemon)).items()
                if name not in ("cameras", "reject_samples", "alarms")
            },
            "cameras": rows,
        }

    def hours_of(self, camera: str) -> dict[str, object] | None:
        """Return a camera's events by the hour, since this server has followed the daemon."""
        return self._hourly.of(camera, self._clock())

    @contextlib.contextmanager
    def watching(self, camera: str) -> Iterator[None]:
        """Forward the events of ``camera`` while the block runs.

        Several pages may watch the same camera.
        """
        with self._mutex:
            count, end = self._watched.get(camera) or (
                0,
                self._bus.subscribe(f"event/{camera}", self._put),
            )
            self._watched[camera] = (count + 1, end)
        try:
            yield
        finally:
            with self._mutex:
                count, end = self._watched.pop(camera)
                if count > 1:
                    self._watched[camera] = (count - 1, end)
                else:
                    end()

    def _put(self, key: str, payload: bytes) -> None:
        try:
            self._inbox.put_nowait((key, payload))
        except queue.Full:
            self.dropped += 1

    def _on_status(self, name: str, payload: bytes) -> None:
        """Store the status of a camera or the daemon; forward it if it has changed."""
        if name == DAEMON:
            self._on_daemon_status(payload)
            return
        try:
            status = msgspec.msgpack.decode(payload, type=dict[str, Any])
        except (msgspec.MsgspecError, UnicodeDecodeError):
            return
        if not re.match(CAMERA_PATTERN, name):
            return

        with self._mutex:
            before = self._status.get(name)
            if before is None and len(self._status) >= CAMERAS_MAX:
                return
            self._status[name] = status
            self._heard[name] = self._clock()
            again = name in self._silent
            self._silent.discard(name)

        if (
            before is None
            or again
            or any(before.get(k) != status.get(k) for k in ("state", "reason"))
        ):
            self._tell_health(name, status)

    def _on_daemon_status(self, payload: bytes) -> None:
        """Store the daemon's status; forward those of cameras that it has forgotten."""
        try:
            daemon = codec.read(DaemonStatus, payload, pack=True)
        except codec.Rejected:
            return
        events = {name: figures.events for name, figures in daemon.cameras.items()}
        self._hourly.note(self._clock(), events)
        with self._mutex:
            self._daemon = daemon
            self._heard[DAEMON] = self._clock()
            forgotten = set(daemon.names.forgotten)
            changed = (forgotten ^ self._forgotten) & self._status.keys()
            self._forgotten = forgotten
            statuses = {name: self._status[name] for name in changed}
        for name, status in statuses.items():
            self._tell_health(name, status)

    def _tell_health(self, name: str, status: dict[str, Any]) -> None:
        """Send a camera's health to all pages."""
        row = _row(name, self._word(name, status), None)
        self._page_queues.send("health", msgspec.json.encode({**row, "at": self._clock()}))

    def _word(self, name: str, status: dict[str, Any] | None) -> dict[str, Any] | None:
        """Return a camera's status, with the state ``silent`` if it has stopped publishing."""
        if status is not None and name in self._forgotten:
            reason = f"its events are refused until `camtopod forget --take-back {name}`"
            return {**status, "state": "forgotten", "reason": reason}
        if status is None or name not in self._silent:
            return status
        reason = f"no status from its grabber for more than {self._silent_seconds:.0f} s"
        return {**status, "state": "silent", "reason": reason}

    def _on_prediction(self, name: str, payload: bytes) -> None:
        """Forward a prediction, unless there are too many this second."""
        second = int(self._clock())
        if second != self._second:
            self._second = second
            self._this_second = 0
        self._this_second += 1
        if self._this_second > PREDICTIONS_PER_SECOND_MAX:
            return
        try:
            prediction = codec.read(Prediction, payload, pack=True)
        except codec.Rejected:
            return
        content = codec.to_json(shown(prediction))
        with self._mutex:
            self._predictions.append(content)
        self._page_queues.send("prediction", content, passing=True)

    def _on_event(self, name: str, payload: bytes) -> None:
        """Forward an event, without its track, to the pages that watch its camera."""
        try:
            event = codec.event_from_bytes(payload)
        except codec.Rejected:
            return
        shown = Event(event.camera, event.kind, event.t, event.x, event.y)
        self._page_queues.send("event", codec.to_json(shown), camera=name, passing=True)

    def _look(self) -> None:
        """Notice when the daemon becomes live or silent, and which cameras have fallen silent."""
        now = self._clock()
        if not self._bus.connected:
            self._unheard_since = now

        # Cameras once a second, not for every message: there may be thousands.
        if abs(now - self._looked_at_cameras) >= 1.0:
            self._looked_at_cameras = now
            self._look_at_cameras(now)

        # Reason why the daemon is not live.
        heard = self._heard.get(DAEMON)
        if not self._bus.connected:
            reason = f"the bus at {self._bus.endpoint} cannot be reached"
        elif heard is None:
            reason = WAITING
            if now - self._unheard_since >= self._silent_seconds:
                reason = "no daemon has published its status yet"
        elif not abs(now - heard) < self._silent_seconds:
            reason = f"no status from the daemon for {self._silent_seconds:.0f} s"
        else:
            reason = ""

        # Tell the pages if it has changed.
        with self._mutex:
            behind = _whole_percent(None if self._daemon is None else self._daemon.catching_up)
            if (self._live["reason"], self._live["catching_up"]) == (reason, behind):
                return
            # Another reason for the same silence does not change its beginning.
            if reason != self._live["reason"] and (not reason or self._live["live"]):
                silent_since = max(heard or 0.0, now - self._silent_seconds)
                self._live["since"] = silent_since if reason else now
            self._live = {
                **self._live,
                "live": not reason,
                "reason": reason,
                "catching_up": behind,
            }
            message = msgspec.json.encode(self._live)
        self._page_queues.send("live", message)

    def _look_at_cameras(self, now: float) -> None:
        """Mark and report cameras whose grabbers have stopped publishing."""
        with self._mutex:
            gone = {
                name: status
                for name, status in self._status.items()
                if name not in self._silent
                and status.get("state") != ENDED
                and abs(now - max(self._heard[name], self._unheard_since)) > self._silent_seconds
            }
            self._silent.update(gone)
        for name, status in gone.items():
            self._tell_health(name, status)


def _whole_percent(catching_up: CatchingUp | None) -> int | None:
    """Return the share of stored events that are learned, in percent; None if all are."""
    return None if catching_up is None else math.floor(100 * catching_up.share)


def _mark_gone(rows: list[dict[str, Any]], as_of: float) -> None:
    """Give the state ``gone`` to cameras without a grabber, and without events for long.

    as_of: event time of the newest version, Unix seconds.
    """
    newest = max([as_of, *(row["newest"] or 0.0 for row in rows)])
    for row in rows:
        last, state = row["newest"], row["state"]
        if is_gone(state, last, newest) or (last is None and state == "no grabber"):
            row["state"], row["reason"] = GONE, ""


def _row(
    name: str,
    status: dict[str, Any] | None,
    counted: CameraFigures | None,
    learned: float | None = None,
) -> dict[str, Any]:
    """Return a camera's row on the health page.

    status: of its grabber.
    counted: the daemon's figures of it.
    learned: time of its last learned event, Unix seconds.
    """
    said = status or {}
    usual = "unknown" if counted is not None and counted.alive else "no grabber"
    return {
        "id": name,
        "state": str(said.get("state") or usual)[:500],
        "reason": str(said.get("reason") or "")[:500],
        "events": None if counted is None else counted.events,
        "newest": learned if counted is None else counted.newest,
        "ahead": None if counted is None else counted.ahead,
    }
