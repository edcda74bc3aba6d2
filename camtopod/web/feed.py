"""Follow a site's bus for the page: newest map, health, live news; forward news to open pages.

The bus's own threads process predictions, matches, events and status; another follows the topology
and makes its map once a version.
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections import deque
from collections.abc import Collection
from typing import Any

import msgspec
from msgspec.structs import replace

from camtopod import codec
from camtopod.records import Look, Match, Prediction, Recent, Topology
from camtopod.serve.bus import Bus, QueryError, TopologySubscriber
from camtopod.serve.city_bus import CityBus
from camtopod.serve.runtime import Beat, Clock, no_beat
from camtopod.statuses import Statuses
from camtopod.web.explanations import Explanations
from camtopod.web.map_data import NO_MAP, draw
from camtopod.web.outbox import PageQueues, message
from camtopod.web.recent_matches import RecentMatches
from camtopod.web.versions import summary
from camtopod.words import SHARE_SAID_MIN, headline, seen_now

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
_TICK_SECONDS = 0.2
NOT_SHOWN = ("cameras", "reject_samples", "alarms")
"""Fields of the daemon's status that the page does not receive."""


def shown(prediction: Prediction) -> dict[str, Any]:
    """Return the prediction in the form for the page, without a track.

    ``place``, ``words``: what is said of it (`camtopod.words.Headline`).
    ``seconds``: after ``t``, when the last camera that is named can no longer be the next.
    ``now``: those that probably see it at ``t``, when it has left the view of ``camera``.
    """
    answer = headline(prediction)
    ends = [
        row.q90 for row in prediction.next if row.probability >= SHARE_SAID_MIN and not row.prior
    ]
    return {
        **{name: getattr(prediction, name) for name in ("camera", "zone", "t", "version")},
        "place": answer.place,
        "words": answer.words,
        "seconds": max(ends, default=0.0),
        "now": [Look(*item) for item in seen_now(prediction).items()],
        "next": prediction.next[:NEXT_SHOWN],
    }


def shown_match(match: Match) -> dict[str, Any]:
    """Return the match in the form for the page, without tracks.

    ``passage``: differs between entries of one picture; it says nothing of the track.
    """
    return {
        **{name: getattr(match, name) for name in ("camera", "t", "walk", "new")},
        "passage": hash(match.track),
        "from": [
            {"camera": passage.camera, "t": passage.t, "probability": passage.probability}
            for passage in match.from_[:NEXT_SHOWN]
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
    """Follower of one site's bus, or of several sites'; run `follow` in a thread.

    camera_ids: those that are on the map from the beginning.
    """

    def __init__(
        self,
        bus: Bus | CityBus,
        page_queues: PageQueues,
        clock: Clock,
        camera_ids: Collection[str] = (),
    ) -> None:
        self._bus = bus
        self._camera_ids = set(camera_ids)
        self._page_queues = page_queues
        self._clock = clock
        self._statuses = Statuses(clock)
        self._predictions: deque[bytes] = deque(maxlen=PREDICTIONS_HELD)
        self._limits = {"prediction": PerSecond(), "match": PerSecond()}
        self._matches = RecentMatches()
        """Those since this server began."""
        self._view = bus if isinstance(bus, CityBus) else TopologySubscriber(bus)
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
        self.map = replace(NO_MAP, site=bus.site)
        self.map_json = b"null"
        if camera_ids:
            self._draw(None)
        for key in ("status/*", "prediction/*", "match/*"):
            bus.subscribe(key, self._on_message)

    def follow(self, stop: threading.Event, beat: Beat = no_beat) -> None:
        """Follow the topology until ``stop`` is set."""
        for key, payload in self._bus.query("status/*"):
            self._on_message(key, payload)
        while not stop.wait(_TICK_SECONDS):
            beat()
            if not self._bus.connected:
                self._statuses.note_unreachable()
            self.ask_recent()
            if (newest := self._view.update()) is not None:
                self.show(newest)
            elif self._present() - self.map.cameras.keys():
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

    def _draw(self, topology: Topology | None) -> None:
        """Draw the map of a version, if there is one, with the cameras that it does not know."""
        self.map = draw(topology, self.map, self._present())
        self.map_json = codec.to_json(self.map)

    def _present(self) -> set[str]:
        """Return the cameras whose events can come, and those of the configuration."""
        alive = {camera.id for camera in self._statuses.cameras(None) if camera.alive}
        return alive | self._camera_ids - self._statuses.daemon.names.forgotten.keys()

    def hello(self) -> bytes:
        """Return the first messages for a page that has just connected: server-sent events."""
        past = [message("past", content) for content in self._predictions.copy()]
        return message("version", self._version()) + b"".join(past)

    def beat(self) -> bytes:
        """Return the message that keeps an idle connection alive."""
        return message("beat", b'{"now":%.3f}' % self._clock())

    def health(self) -> dict[str, Any]:
        """Return the state of the daemon and of every camera, with the daemon's status.

        ``live``: the state of the daemon, and since when (Unix seconds) it has not been heard of.
        """
        now = self._clock()  # taken first, so that the data are at least as new
        statuses = self._statuses
        away = "" if self._bus.connected else f"the bus at {self._bus.endpoint} cannot be reached"
        live = msgspec.to_builtins(statuses.daemon_state(self.topology, away))
        live["since"] = statuses.heard_at
        daemon: dict[str, Any] = {}
        if statuses.daemon.state:
            daemon = msgspec.to_builtins(statuses.daemon)
            daemon = {name: daemon[name] for name in daemon if name not in NOT_SHOWN}
        cameras = msgspec.to_builtins(statuses.cameras(self.topology))
        return {"now": now, "live": live, "daemon": daemon, "cameras": cameras}

    def walks(self, since: float) -> list[Match]:
        """Return the newest match of each entry later than ``since``, at most an hour ago."""
        return self._matches.later(since, self._clock())

    def names(self) -> set[str]:
        """Return the cameras that are learned of or that the daemon counts."""
        return {*self.map.cameras, *self._statuses.daemon.cameras}

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
                self._page_queues.send("seen", codec.to_json(recent.events), is_optional=True)

    def recent(self, count: int = REPORT_EVENTS_MAX, **parameters: float) -> Recent | None:
        """Return the newest events of the last hour, at most ``count``; None without an answer."""
        with contextlib.suppress(QueryError, codec.Rejected):
            for _, payload in self._bus.query("recent", parameters, one=True):
                recent = codec.read(Recent, payload, pack=True)
                return Recent(recent.t, recent.events[-count:])
        return None

    def _version(self) -> bytes:
        """Return epoch and number of the newest version as JSON, null if there is none."""
        return msgspec.json.encode(self.topology and [self.topology.epoch, self.topology.version])

    # --- messages of the bus ---

    def _on_message(self, key: str, payload: bytes) -> None:
        """Process a message; one that cannot be read is ignored."""
        kind = key.partition("/")[0]
        with contextlib.suppress(codec.Rejected):
            if kind == "status":
                self._statuses.on_status(key, payload)
                if key == "status/daemon":
                    self._matches.forget(self._statuses.daemon.names.forgotten)
            elif kind == "match":
                self._on_match(codec.read(Match, payload, pack=True))
            else:
                self._on_prediction(codec.read(Prediction, payload, pack=True))

    def _on_prediction(self, prediction: Prediction) -> None:
        """Forward a prediction, unless there are too many this second."""
        if self._limits["prediction"].take(self._clock()):
            content = codec.to_json(shown(prediction))
            self._predictions.append(content)
            self._page_queues.send("prediction", content, is_optional=True)

    def _on_match(self, match: Match) -> None:
        """Keep a match; forward it, unless there are too many this second."""
        now = self._clock()
        self._matches.add(match, now)
        if self._limits["match"].take(now):
            self._page_queues.send("match", codec.to_json(shown_match(match)), is_optional=True)
