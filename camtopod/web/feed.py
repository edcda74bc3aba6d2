"""Follow a site's bus for the page: newest map, health, live news; forward news to open pages.

The bus's own threads process predictions, matches, events and status; another follows the topology
and makes its map once a version.
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections import deque
from typing import Any

import msgspec

from camtopod import codec
from camtopod.predict import seen_now
from camtopod.publishers import ELSEWHERE, is_gone
from camtopod.records import DaemonStatus, Match, Prediction, Recent, Status, Topology
from camtopod.serve.bus import Bus, QueryError, TopologySubscriber
from camtopod.serve.runtime import Beat, Clock, no_beat
from camtopod.web.explanations import Explanations
from camtopod.web.map_data import NO_MAP, draw
from camtopod.web.outbox import PageQueues, message
from camtopod.web.recent_matches import RecentMatches
from camtopod.web.versions import summary

CAMERAS_MAX = 5_000
"""Cameras whose status is kept."""
PER_SECOND_MAX = 25
"""Predictions, and matches, forwarded per second, of all cameras together; people cannot follow
more.
"""
SEEN_PER_SECOND_MAX = 300
"""Entries and exits forwarded per second."""
REPORT_EVENTS_MAX = 20_000
"""Events of the last hour in a file, the newest ones."""
PREDICTIONS_HELD = 20
"""Predictions kept for pages that connect later."""
MATCHES_SHOWN = 500
"""Newest matches that a page receives when it connects."""
VERSIONS_MAX = 500
"""Versions on the time line; beyond it the oldest are forgotten."""
NEXT_SHOWN = 3
"""Next cameras of a prediction, and earlier passages of a match, that the page receives."""
SILENT_STATUSES = 6
"""Status intervals without a status after which a daemon is not live and a grabber is silent."""
_TICK_SECONDS = 0.2
REASON_CHARACTERS_MAX = 500
"""Longest state or reason that is shown."""
NOT_SHOWN = ("cameras", "reject_samples", "alarms")
"""Fields of the daemon's status that the page does not receive."""


class Live(msgspec.Struct, frozen=True):
    """Whether the daemon is live.

    since (Unix seconds): when it was heard of last, if it is not.
    catching_up: share of stored events that are learned, in percent; None if all are.
    """

    live: bool
    reason: str
    since: float
    catching_up: int | None


def shown(prediction: Prediction) -> dict[str, Any]:
    """Return the prediction in the form for the page, without a track.

    ``look``: where views overlap, cameras that probably see the object at ``t``, or else next.
    ``now``: those that probably see it at ``t``, when it has left the view of ``camera``.
    """
    look = [one for one in prediction.look or [] if one.camera != prediction.camera]
    return {
        **{name: getattr(prediction, name) for name in ("camera", "zone", "t", "version", "leave")},
        "look": look[:NEXT_SHOWN],
        "now": seen_now(prediction.in_view or []),
        "next": prediction.candidates[:NEXT_SHOWN],
    }


def shown_match(match: Match) -> dict[str, Any]:
    """Return the match in the form for the page, without tracks."""
    return {
        **{name: getattr(match, name) for name in ("camera", "t", "walk", "new")},
        "from": [
            {"camera": one.camera, "t": one.t, "probability": one.probability}
            for one in match.from_[:NEXT_SHOWN]
        ],
    }


class PerSecond:
    """Which of the messages are forwarded: `PER_SECOND_MAX` in each second."""

    def __init__(self) -> None:
        self._second = 0
        self._count = 0

    def take(self, now: float) -> bool:
        """Count a message at ``now`` (Unix seconds); return True if it is forwarded."""
        if int(now) != self._second:
            self._second = int(now)
            self._count = 0
        self._count += 1
        return self._count <= PER_SECOND_MAX


class Feed:
    """Follower of one site's bus; run `follow` in a thread.

    status_seconds: interval in which the daemon publishes its status.
    """

    def __init__(
        self, bus: Bus, page_queues: PageQueues, clock: Clock, status_seconds: float
    ) -> None:
        self._bus = bus
        self._page_queues = page_queues
        self._clock = clock
        self._silent_seconds = SILENT_STATUSES * status_seconds
        self._began = clock()
        self._connected_since = self._began  # no status can arrive while the bus is unreachable
        self._daemon = DaemonStatus()
        """Newest status of the daemon."""
        self._heard: float | None = None
        """When it was received."""
        self._grabbers: dict[str, tuple[Status, float]] = {}
        """Newest status of each camera's grabber, and when it was received."""
        self._predictions: deque[bytes] = deque(maxlen=PREDICTIONS_HELD)
        self._limits = {"prediction": PerSecond(), "match": PerSecond()}
        self._matches = RecentMatches()
        """Those since this server began."""
        self._view = TopologySubscriber(bus)
        self._asked_at = 0.0
        """When the daemon was asked for its newest events."""
        self._answered_at = math.inf
        """Time of its answer, by its clock; infinite while no page is open."""
        self.topology: Topology | None = None
        """The newest version."""
        self.explanations: Explanations | None = None
        """Details of the newest version."""
        self.versions: list[dict[str, Any]] = []
        """Versions of the newest epoch since this server began, oldest first; never changed."""
        self.map = NO_MAP
        self.map_json = b"null"
        for key in ("status/*", "prediction/*", "match/*"):
            bus.subscribe(key, self._on_message)

    def follow(self, stop: threading.Event, beat: Beat = no_beat) -> None:
        """Follow the topology until ``stop`` is set."""
        for key, payload in self._bus.query("status/*"):
            self._on_message(key, payload)
        while not stop.wait(_TICK_SECONDS):
            beat()
            if not self._bus.connected:
                self._connected_since = self._clock()
            self.ask_recent()
            if (newest := self._view.update()) is not None:
                self.show(newest)
            elif self.topology is not None and self._present() - self.map.cameras.keys():
                self._draw(self.topology)
                self._page_queues.send("cameras", b"null")

    def show(self, topology: Topology) -> None:
        """Show a version from now on."""
        # The version before, unless a new epoch has begun.
        before = self.topology
        if before is not None and before.epoch != topology.epoch:
            before = None
            self.versions = []
            self._predictions.clear()
            self._matches.clear()

        # Everything that the page asks for; then open pages ask.
        self._draw(topology)
        self.topology = topology
        self.explanations = Explanations(topology)
        self.versions = [*self.versions, summary(topology, before)][-VERSIONS_MAX:]
        self._page_queues.send("version", self._version())

    def _draw(self, topology: Topology) -> None:
        """Draw the map of a version, with the cameras that it does not know yet."""
        self.map = draw(topology, self.map, self._present())
        self.map_json = codec.to_json(self.map)

    def _present(self) -> set[str]:
        """Return the cameras with a publisher."""
        figures = self._daemon.cameras
        grabbers = dict(self._grabbers)
        names = {*grabbers, *(name for name, one in figures.items() if one.alive)}
        now = self._clock()
        absent = ("", "silent", "forgotten")
        return {
            name for name in names if self._state(name, grabbers.get(name), now)[0] not in absent
        }

    def hello(self) -> bytes:
        """Return the first messages for a page that has just connected: server-sent events."""
        past = [message("past", one) for one in self._predictions.copy()]
        return message("version", self._version()) + b"".join(past)

    def beat(self) -> bytes:
        """Return the message that keeps an idle connection alive."""
        return message("beat", b'{"now":%.3f}' % self._clock())

    def health(self) -> dict[str, Any]:
        """Return the status of the daemon and of every camera, and whether they are live."""
        now = self._clock()  # taken first, so that the data are at least as new
        daemon: dict[str, Any] = {}
        if self._heard is not None:
            told = msgspec.to_builtins(self._daemon)
            daemon = {name: told[name] for name in told if name not in NOT_SHOWN}
        live = self._live(now)
        return {"now": now, "live": live, "daemon": daemon, "cameras": self._cameras(now)}

    def walks(self, since: float) -> list[Match]:
        """Return the newest match of each entry later than ``since``, at most an hour ago."""
        return self._matches.later(since, self._clock())

    def names(self) -> set[str]:
        """Return the cameras that are learned of or that the daemon counts."""
        return {*self.map.cameras, *self._daemon.cameras}

    def ask_recent(self) -> None:
        """Ask the daemon for its newest events, once a second, and send them to open pages."""
        if not self._page_queues.is_any_open:
            self._answered_at = math.inf
        if not self._page_queues.is_any_open or abs(self._clock() - self._asked_at) < 1.0:
            return
        self._asked_at = self._clock()
        if (recent := self.recent(SEEN_PER_SECOND_MAX, since=self._answered_at)) is not None:
            self._answered_at = recent.t
            if recent.events:
                self._page_queues.send("seen", codec.to_json(recent.events), passing=True)

    def recent(self, most: int = REPORT_EVENTS_MAX, **asked: float) -> Recent | None:
        """Return the newest events of the last hour, at most ``most``; None without an answer."""
        with contextlib.suppress(QueryError, codec.Rejected):
            for _, payload in self._bus.query("recent", asked, one=True):
                recent = codec.read(Recent, payload, pack=True)
                return Recent(recent.t, recent.events[-most:])
        return None

    def _version(self) -> bytes:
        """Return epoch and number of the newest version as JSON, null if there is none."""
        return msgspec.json.encode(self.topology and [self.topology.epoch, self.topology.version])

    # --- health ---

    def _live(self, now: float) -> Live:
        """Return whether the daemon is live, and why not."""
        heard = self._heard
        if heard is None:
            return Live(False, "no status of the daemon has been received yet", self._began, None)
        reason = ""
        if not self._bus.connected:
            reason = f"the bus at {self._bus.endpoint} cannot be reached"
        elif abs(now - heard) >= self._silent_seconds:
            reason = f"no status from the daemon for {self._silent_seconds:.0f} s"
        behind = None
        if self._daemon.catching_up is not None:
            behind = math.floor(100 * min(max(0.0, self._daemon.catching_up.share), 1.0))
        return Live(not reason, reason, heard, behind)

    def _cameras(self, now: float) -> list[dict[str, Any]]:
        """Return the health of every camera that anybody knows.

        ``state``: of its grabber; or ``forgotten``, ``silent``, ``gone``, ``no grabber``,
        `ELSEWHERE`. ``newest``: time of its newest event, Unix seconds. ``ahead``: by how many
        seconds its last event was ahead of the daemon's clock.
        """
        figures = self._daemon.cameras
        learned = self.explanations.last_events if self.explanations else {}
        grabbers = dict(self._grabbers)
        newest = {name: learned.get(name) for name in (*grabbers, *self.map.cameras)}
        newest |= {name: one.newest for name, one in figures.items()}
        last = max([self.map.as_of, *(t for t in newest.values() if t)])

        rows = []
        for name in sorted(newest):
            state, reason = self._state(name, grabbers.get(name), now)
            counted = figures.get(name)
            t = newest[name]
            if state == "no grabber" and counted and counted.alive:
                state = ELSEWHERE
            elif is_gone(state, t, last) or (t is None and state == "no grabber"):
                state = "gone"
                reason = ""
            elif state == "no grabber" and counted and counted.events:
                state = ELSEWHERE
            if state:
                row: dict[str, Any] = {"id": name, "state": state, "reason": reason, "newest": t}
                row |= {key: counted and getattr(counted, key) for key in ("events", "ahead")}
                rows.append(row)
        return rows

    def _state(
        self, name: str, grabber: tuple[Status, float] | None, now: float
    ) -> tuple[str, str]:
        """Return state and reason of a camera; the state is "" if it is not to be shown.

        grabber: its status, and when it was received.
        """
        if grabber is None:
            return "no grabber", ""
        status, heard = grabber
        quiet = abs(now - max(heard, self._connected_since))
        is_silent = status.state != "ended" and quiet > self._silent_seconds
        if name in self._daemon.names.forgotten:
            reason = f"its events are refused until `camtopod forget --take-back {name}`"
            return "" if is_silent else "forgotten", reason
        if is_silent:
            reason = f"no status from its grabber for more than {self._silent_seconds:.0f} s"
            return "silent", reason
        state = status.state or "unknown"
        return state[:REASON_CHARACTERS_MAX], status.reason[:REASON_CHARACTERS_MAX]

    # --- messages of the bus ---

    def _on_message(self, key: str, payload: bytes) -> None:
        """Process a message; one that cannot be read is ignored."""
        kind, _, name = key.partition("/")
        with contextlib.suppress(codec.Rejected):
            if key == "status/daemon":
                self._daemon = codec.read(DaemonStatus, payload, pack=True)
                self._heard = self._clock()
                self._matches.forget(self._daemon.names.forgotten)
            elif kind == "status":
                self._on_status(name, codec.read(Status, payload, pack=True))
            elif kind == "match":
                self._on_match(codec.read(Match, payload, pack=True))
            else:
                self._on_prediction(codec.read(Prediction, payload, pack=True))

    def _on_status(self, name: str, status: Status) -> None:
        known = name in self._grabbers or len(self._grabbers) < CAMERAS_MAX
        if known and codec.is_camera(name):
            self._grabbers[name] = (status, self._clock())

    def _on_prediction(self, prediction: Prediction) -> None:
        """Forward a prediction, unless there are too many this second."""
        if self._limits["prediction"].take(self._clock()):
            content = codec.to_json(shown(prediction))
            self._predictions.append(content)
            self._page_queues.send("prediction", content, passing=True)

    def _on_match(self, match: Match) -> None:
        """Keep a match; forward it, unless there are too many this second."""
        now = self._clock()
        self._matches.add(match, now)
        if self._limits["match"].take(now):
            self._page_queues.send("match", codec.to_json(shown_match(match)), passing=True)
