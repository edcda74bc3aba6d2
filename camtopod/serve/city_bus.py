"""The daemons of several sites as one, for programs that show them: a session with each.

Messages about a camera are taken from its owner, one of the sites, and from no other site that
hears it. A site that cannot be reached is tried again, and the other sites go on.
"""

from __future__ import annotations

import contextlib
import functools
import logging
import threading
import time
from collections.abc import Mapping

from msgspec.structs import replace

from camtopod import codec
from camtopod.config import Config
from camtopod.keys.rules import STATUS
from camtopod.records import (
    DaemonStatus,
    EventCounts,
    EventHours,
    LearnerCounts,
    NamesStatus,
    Recent,
    Topology,
)
from camtopod.serve.bus import JSON, Bus, BusError, OnMessage, QueryError, TopologySubscriber, dial
from camtopod.topology import camera_of
from camtopod.words import silent_after

log = logging.getLogger(__name__)

RETRY_SECONDS = 2.0
"""Interval between two attempts to reach a site."""
TICK_SECONDS = 0.2
"""Interval at which it is looked for a new version of a site."""
FIRST_SECONDS = 2.0
"""Longest wait for the first version of a daemon that is there."""
STATUS_SECONDS = 0.5
"""Shortest time between two statuses of all daemons together."""
JOIN_SECONDS = 0.01
"""Shortest time between two maps of all sites together, a camera: pages fetch each one whole."""
NAMED_MAX = 4
"""Sites that are named in the name of all together."""
HOUR_SECONDS = 3600.0


class _Site:
    """A site: its session, once there is one, and the newest status and map of its daemon.

    ready: set after the first attempt to reach it.
    """

    def __init__(self, config: Config) -> None:
        self.config = config
        self.bus: Bus | None = None
        self.topology: Topology | None = None
        self.cameras: frozenset[str] = frozenset()
        self.status = DaemonStatus()
        self.heard_at = time.monotonic()
        self.ready = threading.Event()

    @property
    def state(self) -> str:
        """State of the daemon, or that nothing can be heard of it."""
        if self.bus is None or not self.bus.connected:
            return "cannot be reached"
        silent = time.monotonic() - self.heard_at > silent_after(self.status, self.status)
        return "is silent" if silent else self.status.state or "says nothing yet"


class CityBus(contextlib.AbstractContextManager["CityBus"]):
    """Sessions with the daemons of several sites, used like the `Bus` of one.

    It is its own `TopologySubscriber`, of the map that `camtopod.city.joined_map` makes of the
    newest versions: its epoch is another when a daemon begins anew, its version the sum of theirs.

    configs: configurations of a client of each site, by name.
    owners: by camera, the site that owns it. A camera that is not listed, or whose owner is not
        among the sites, belongs to the first site that has learned of it.
    """

    def __init__(self, configs: Mapping[str, Config], owners: Mapping[str, str]) -> None:
        self.site = ", ".join(configs) if len(configs) <= NAMED_MAX else f"{len(configs)} sites"
        self.endpoint = ", ".join(config.dials[0] for config in configs.values())
        self.topology: Topology | None = None
        """The newest map of all sites."""
        self._sites = {name: _Site(config) for name, config in configs.items()}
        self._owners = owners
        self._subscriptions: list[tuple[str, OnMessage]] = []
        self._closing = threading.Event()
        self._status_after = self._join_after = 0.0
        self._parts: list[Topology] = []
        """Of the newest map."""
        self._left_out = (0, 0)
        """Zones and links that are not on it."""
        self._threads = [
            threading.Thread(target=self._follow, args=[name], name="site", daemon=True)
            for name in self._sites
        ]
        for thread in self._threads:
            thread.start()
        for site in self._sites.values():
            site.ready.wait(site.config.bus.connect_seconds + 2 * FIRST_SECONDS)

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        for thread in self._threads:
            thread.join()

    @property
    def connected(self) -> bool:
        """True if any of the sites is connected now."""
        return bool(self._sessions())

    def _sessions(self) -> dict[str, Bus]:
        """Return the sessions that are connected now, by site."""
        sites = self._sites.items()
        return {name: site.bus for name, site in sites if site.bus and site.bus.connected}

    def owner(self, camera: str) -> str | None:
        """Return the site that owns a camera; None if no site has learned of it."""
        if (owner := self._owners.get(camera)) in self._sites:
            return owner
        return next((name for name, site in self._sites.items() if camera in site.cameras), None)

    def subscribe(self, key: str, on_message: OnMessage) -> None:
        """Call ``on_message`` for publications on ``key`` of the cameras' owners.

        All daemons have one status; it is for one subscriber.
        """
        self._subscriptions.append((key, on_message))

    def query(
        self, key: str, parameters: Mapping[str, object] | None = None, one: bool = False
    ) -> list[tuple[str, bytes]]:
        """Return the answers to a query, those about a camera by its owner.

        Raises `QueryError`, also for older maps, which are not kept.
        """
        kind, _, camera = key.partition("/")
        if kind == "predict":
            bus = self._sessions().get(self.owner(camera) or next(iter(self._sites)))
            return bus.query(key, parameters, one=one) if bus else []
        if kind == "recent":
            return self._recent(parameters or {})
        if kind != "status":
            raise QueryError("of several sites together older maps are not kept")
        answers: list[tuple[str, bytes]] = []
        for name, bus in self._sessions().items():
            for answer in bus.query(key):
                self._receive(name, lambda *message: answers.append(message), *answer)
        return [*answers, (STATUS, codec.to_msgpack(self._status()))]

    def update(self) -> Topology | None:
        """Return the newest map of all sites, or None if it is not new."""
        parts = [site.topology for site in self._sites.values() if site.topology is not None]
        if parts == self._parts or time.monotonic() < self._join_after:
            return None
        from camtopod.city.joined_map import joined_map  # takes memory, and is seldom needed
        from camtopod.city.merge import EPOCH_DIGITS, digest_of

        self._parts = parts
        owners = {
            camera.id: self.owner(camera.id) or part.site
            for part in parts
            for camera in part.cameras
        }
        self._join_after = time.monotonic() + JOIN_SECONDS * len(owners)
        city_map = joined_map(parts, owners)
        if city_map[1:] != self._left_out:
            self._left_out = city_map[1:]
            text = "%d zones match none of their camera's owner; %d links to them are left out"
            log.info(text, *self._left_out)
        heads = [replace(part, version=0, digest="") for part in parts]
        self.topology = replace(
            city_map.topology,
            site=self.site,
            epoch=digest_of(heads, {}).removeprefix("sha256:")[:EPOCH_DIGITS],
            version=sum(part.version for part in parts),
            digest=digest_of(parts, owners),
            alarms=[
                alarm
                for part in parts
                for alarm in part.alarms or []
                if owners.get(camera_of(alarm.subject)) == part.site
            ],
        )
        return self.topology

    def _receive(self, name: str, on_message: OnMessage, key: str, payload: bytes) -> None:
        """Pass on a message of a site: of its own cameras, or with the status of all daemons."""
        site = self._sites[name]
        if key != STATUS:
            if self.owner(key.partition("/")[2]) in (name, None):
                on_message(key, payload)
            return
        with contextlib.suppress(codec.Rejected):
            site.status = codec.read(DaemonStatus, payload, pack=True)
            site.heard_at = time.monotonic()
        if time.monotonic() >= self._status_after:
            self._status_after = time.monotonic() + STATUS_SECONDS
            on_message(key, codec.to_msgpack(self._status()))

    def _status(self) -> DaemonStatus:
        """Return one status of all daemons, in which those that do not run are named."""
        statuses = {name: site.status for name, site in self._sites.items()}
        states = [(name, site.state) for name, site in self._sites.items()]
        words = ["running" for _, state in states if state == "running"][:1]
        words += [f"{name} {state}" for name, state in states if state != "running"]
        daemons = [*statuses.values()]
        return DaemonStatus(
            state=", ".join(words),
            reason="; ".join(f"{name}: {s.reason}" for name, s in statuses.items() if s.reason),
            t=max(status.t for status in daemons),
            status_seconds=max(status.status_seconds or 0.0 for status in daemons),
            site=self.site,
            events=EventCounts(
                stored=sum(status.events.stored for status in daemons),
                waiting=sum(status.events.waiting for status in daemons),
            ),
            rejects={
                f"{name}, {reason}": number
                for name, status in statuses.items()
                for reason, number in status.rejects.items()
            },
            learner=LearnerCounts(
                late=sum(status.learner.late for status in daemons),
                learned=sum(status.learner.learned for status in daemons),
            ),
            catching_up=max(
                (status.catching_up for status in daemons if status.catching_up),
                key=lambda behind: behind.seconds,
                default=None,
            ),
            predictions=sum(status.predictions for status in daemons),
            names=NamesStatus(
                {name: n for status in daemons for name, n in status.names.forgotten.items()},
                {old: name for status in daemons for old, name in status.names.renamed.items()},
            ),
            cameras={
                camera: figures
                for name, status in statuses.items()
                for camera, figures in status.cameras.items()
                if self.owner(camera) in (name, None)
            },
            warnings=[f"{name}: {text}" for name, s in statuses.items() for text in s.warnings],
        )

    def _recent(self, parameters: Mapping[str, object]) -> list[tuple[str, bytes]]:
        """Return one answer with the events of all sites' own cameras."""
        question = {key: value for key, value in parameters.items() if key != "format"}
        recents: dict[str, Recent] = {}
        for name, bus in self._sessions().items():
            with contextlib.suppress(QueryError, codec.Rejected):
                for _, payload in bus.query("recent", question, one=True):
                    recents[name] = codec.read(Recent, payload, pack=True)
        if not recents:
            return []
        events = [
            event
            for name, recent in recents.items()
            for event in recent.events
            if self.owner(event.camera) in (name, None)
        ]
        answer = Recent(
            max(recent.t for recent in recents.values()),
            sorted(events, key=lambda event: event.t),
            self._hours({name: recent.hours for name, recent in recents.items() if recent.hours}),
        )
        encode = codec.to_json if parameters.get("format") == JSON else codec.to_msgpack
        return [("recent", encode(answer))]

    def _hours(self, hours: Mapping[str, EventHours]) -> EventHours | None:
        """Return the hours of all sites from the earliest on; None without any."""
        if not hours:
            return None
        first = min(counts.first for counts in hours.values())
        cameras = {
            camera: [[0, 0]] * round((counts.first - first) / HOUR_SECONDS) + camera_counts
            for name, counts in hours.items()
            for camera, camera_counts in counts.cameras.items()
            if self.owner(camera) in (name, None)
        }
        return EventHours(max(counts.since for counts in hours.values()), first, cameras)

    def _follow(self, name: str) -> None:
        """Reach a site, and follow its topology; in a thread of its own."""
        site = self._sites[name]
        while site.bus is None and not self._closing.is_set():
            try:
                site.bus = dial(site.config)
            except BusError as error:
                level = logging.DEBUG if site.ready.is_set() else logging.WARNING
                log.log(level, "site %s: %s; it is tried again", name, error)
                site.ready.set()
                self._closing.wait(RETRY_SECONDS)
        if site.bus is None:
            return
        with site.bus as bus:
            subscriber = TopologySubscriber(bus)
            newest = subscriber.first(FIRST_SECONDS)
            count = 0
            while not self._closing.is_set():
                if newest is not None:
                    site.cameras = frozenset(camera.id for camera in newest.cameras)
                    site.topology = replace(newest, site=name)
                site.ready.set()
                for key, on_message in self._subscriptions[count:]:
                    bus.subscribe(key, functools.partial(self._receive, name, on_message))
                    count += 1
                self._closing.wait(TICK_SECONDS)
                newest = subscriber.update()
