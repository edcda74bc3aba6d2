"""What a program holds of a site: the newest version of its topology, and what can be said by it at
once.

A thread keeps it up to date: `camtopod.serve.bus.topology_subscriber.TopologyView` applies each
delta to the version before it, checks that the digest comes out, and fetches the whole where a
version is missing or the daemon has begun anew.
"""

from __future__ import annotations

import contextlib
import logging
import math
import re
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from camtopod import codec
from camtopod.client.errors import NothingLearned, zone_at, zones_of
from camtopod.client.gate import Gate
from camtopod.client.prediction_queue import Inbox
from camtopod.client.wakeup import News
from camtopod.config import DEFAULT_ENDPOINT, is_endpoint, secret_files
from camtopod.config import settings as configs
from camtopod.predict import Predictor
from camtopod.records import CAMERA_PATTERN, Event, Prediction
from camtopod.records import Topology as Version
from camtopod.serve.bus import Bus, BusError, TopologyView, dial
from camtopod.serve.runtime import clock

log = logging.getLogger(__name__)

LOOK_SECONDS = 0.5
"""How often the bus is looked at without being told of anything."""
Settings = configs.Config | str | Path | None
"""A configuration, or the file it is in."""
InboxT = TypeVar("InboxT", bound=Inbox)


class _Held(NamedTuple):
    version: Version
    predictor: Predictor
    gate: Gate


class View:
    """A site as it is known now; `camtopod.client.Topology` and `camtopod.client.aio` add what
    waits for something.
    """

    def __init__(
        self, site: str | None = None, connect: str | Sequence[str] = (), config: Settings = None
    ) -> None:
        """See `camtopod.client.Topology.connect`."""
        settings = _settings(site, connect, config)
        self._bus = dial(settings)
        self._news = News()
        self._mutex = threading.Lock()  # a predictor is asked by one thread at a time
        self._held: _Held | None = None
        self._opening = threading.Lock()  # nothing is opened once it closes
        self._inboxes: list[Inbox] = []
        self._daemons: set[str] = set()
        self._stale_since: float | None = clock.wall()
        self._wake, self._closing = threading.Event(), threading.Event()
        self._thread = threading.Thread(
            target=self._follow, name=f"topology of {self.site}", daemon=True
        )
        with contextlib.ExitStack() as undo:  # a program with an open session does not end
            undo.callback(self._bus.close)
            self._view = TopologyView(self._bus)
            self._bus.subscribe("topology/delta", lambda key, payload: self._wake.set())
            self._bus.watch_alive("daemon", self._on_daemon)
            self._wake.wait(settings.bus.query_seconds)  # a daemon that is there says so at once
            self._refresh()
            self._thread.start()
            undo.pop_all()

    @property
    def site(self) -> str:
        """The site's name."""
        return self._bus.site

    @property
    def current(self) -> Version | None:
        """The newest version known; None where nothing has been learned yet, or the daemon has not
        been there.
        """
        return None if self._held is None else self._held.version

    @property
    def version(self) -> int:
        """The number of `current`, 0 for none. It goes up by one within an epoch
        (``current.epoch``).
        """
        return 0 if self._held is None else self._held.version.version

    @property
    def stale_since(self) -> float | None:
        """None while the daemon is there; else since when it is not, seconds since the epoch. What
        is held stays usable. A daemon that ends or is killed is noticed at once, one that hangs or
        is cut off in ten seconds.
        """
        return self._stale_since

    def predict(
        self,
        camera: str,
        t: float,
        *,
        x: float | None = None,
        y: float | None = None,
        zone: str | None = None,
        track: str | None = None,
        now: float | None = None,
    ) -> Prediction:
        """Where an object that left ``camera`` at ``t`` appears next, by the version held: no
        question to the daemon, about a tenth of a millisecond.

        ``t``: seconds since the epoch by the camera's clock. ``x``, ``y``: where it left, fractions
        of the image; or ``zone``, a zone's id; or neither, at a camera without positions.
        ``track``: its track there; where the track's entry was told by `observe`, what that says is
        used, unless the zone is given. Times in the answer are seconds after ``t``. Where views
        overlap an object may have appeared already: without its entry there having been told, it is
        taken not to have.

        ``now``: to ask again later, by the same camera's clock. What would have shown by then and
        has not shifts the odds to the rest and to ``leave``; an entry told by `observe` since may
        have been the object's, and a window before ``now`` says so. Without `observe` nothing has
        appeared; the newest 2,000 entries count. Whether the exit has been told by then makes no
        difference.

        Raises `NothingLearned`; `UnknownPlace`, a KeyError, for a camera or zone this version does
        not have; ValueError for what is no event, a zone with a position beside it or a ``now``
        before ``t``.
        """
        asked = {"camera": camera, "kind": "exit", "t": t, "x": x, "y": y, "track": track}
        event = codec.event_from_pack(
            codec.to_pack(
                {name: _plain(value) for name, value in asked.items() if value is not None}
            )
        )
        if zone is not None and x is not None:
            raise ValueError("give a zone or a position, not both")
        with self._mutex:
            version, predictor, _ = self._now()
            if zone is not None:
                return predictor.predict_from(
                    zone_at(version, zone, camera), event.t, track=track, now=now
                )
            zones_of(version, camera)
            return predictor.predict(event, now)

    def observe(self, event: Event) -> None:
        """Take note of an event for predictions to come; an exit after it has been predicted for
        the first time.

        Events of all cameras of the site, or of those that the program sees, by time as far as that
        is possible. The newest 2,000 of each kind count. Those told before there is a version do
        not.
        """
        with self._mutex:
            if self._held is not None:
                self._held.predictor.observe(event)

    def gate(
        self,
        from_zone: str,
        t_exit: float,
        to_camera: str,
        t_entry: float,
        to_zone: str | None = None,
    ) -> float:
        """ln of the density, in 1/s, with which who left ``from_zone`` at ``t_exit`` appears next
        at ``to_camera`` at ``t_entry``: see `Gate.gate`. Raises `NothingLearned`, `UnknownPlace` (a
        KeyError).
        """
        return self._now().gate.gate(from_zone, t_exit, to_camera, t_entry, to_zone)

    def gate_new(self, to_camera: str, to_zone: str | None = None) -> float:
        """ln of the rate, in 1/s, of objects from outside: see `Gate.gate_new`. Raises the same."""
        return self._now().gate.gate_new(to_camera, to_zone)

    def gate_gone(self, from_zone: str, seconds: float = math.inf) -> float:
        """ln of the probability of not having been seen ``seconds`` after the exit: see
        `Gate.gate_gone`. Raises the same.
        """
        return self._now().gate.gate_gone(from_zone, seconds)

    def affinity(
        self, exits: Sequence[Event], entries: Sequence[Event], now: float | None = None
    ) -> NDArray[np.float64]:
        """Log odds (exits, entries) of being one object's events, in nats: see `Gate.affinity`.
        Raises `NothingLearned`, ValueError.
        """
        return self._now().gate.affinity(exits, entries, now)

    def close(self) -> None:
        """Leave the bus; whoever waits is let go. May be called twice. What is held stays usable.

        To be called before the program ends (or use ``with``): one with an open session does not
        end.
        """
        with self._opening:
            if self._closing.is_set():
                return
            self._closing.set()
        self._wake.set()
        self._news.close()
        for inbox in self._inboxes:
            inbox.close()
        self._thread.join()
        self._bus.close()

    def _opened(self, opened: Callable[[Bus], InboxT]) -> InboxT:
        """Open it, and close it with the rest. Raises `BusError` where these are closed already."""
        with self._opening:
            if self._closing.is_set():
                raise BusError(f"the topology of site {self.site} has been closed: connect again")
            inbox = opened(self._bus)
            self._inboxes = [*(one for one in self._inboxes if not one.closed), inbox]
        return inbox

    def _now(self) -> _Held:
        if self._held is None:
            raise NothingLearned
        return self._held

    def _at_least(self, version: int) -> Version | None:
        return self.current if self.version >= version else None

    def _not_there(self, version: int, seconds: float) -> str:
        if self._news.closed:
            return f"closed while (or before) waiting for version {version} of site {self.site}"
        there = (
            "the daemon is there"
            if self.stale_since is None
            else "no daemon is there: is `camtopod run` running?"
        )
        return f"no version {version} of site {self.site} within {seconds:g} s, the newest is {self.version}; {there}"

    def _newer(self, than: Version | None) -> Version | None:
        return None if self.current is than else self.current

    def _follow(self) -> None:
        try:
            while not self._closing.is_set():
                self._wake.wait(LOOK_SECONDS)
                self._wake.clear()
                self._refresh()
        finally:
            self._say_there(False)

    def _refresh(self) -> None:
        version = self._view.update()
        if version is not None:
            predictor = Predictor(_with_all_alive(version))
            gate = Gate(version, predictor)
            with self._mutex:
                if self._held is not None:
                    predictor.take_over(self._held.predictor)
                self._held = _Held(version, predictor, gate)
            self._news.tell()
        self._say_there(self._bus.connected and any(map(_leads, self._daemons.copy())))

    def _say_there(self, there: bool) -> None:
        if there != (self._stale_since is None):
            self._stale_since = None if there else clock.wall()
            self._news.tell()

    def _on_daemon(self, name: str, alive: bool) -> None:
        (self._daemons.add if alive else self._daemons.discard)(name)
        self._wake.set()


def _settings(site: str | None, connect: str | Sequence[str], config: Settings) -> configs.Config:
    """The configuration with site and endpoints on top. Raises
    `camtopod.config.settings.ConfigError`, OSError, ValueError.
    """
    settings = config if isinstance(config, configs.Config) else configs.Config()
    if isinstance(config, str | Path):
        settings = configs.load(Path(config))
        for sentence in secret_files.exposed(settings.secrets(Path(config))):
            log.warning("%s", sentence)
    if site is not None:
        if not re.match(CAMERA_PATTERN, site):
            raise ValueError(f"site {site!r}: 1 to 64 of the characters A-Z a-z 0-9 _ . -")
        settings = replace(settings, site=configs.SiteSettings(site))
    endpoints = (connect,) if isinstance(connect, str) else tuple(connect)
    for endpoint in endpoints:
        if not is_endpoint(endpoint):
            raise ValueError(f"connect {endpoint!r}: write it like {DEFAULT_ENDPOINT}")
        if settings.bus.tls.ca and not endpoint.startswith("tls/"):
            raise ValueError(f"connect {endpoint!r}: write tls/..., as [bus.tls] is set")
    return (
        replace(settings, bus=replace(settings.bus, connect=endpoints, listen=()))
        if endpoints
        else settings
    )


def _plain(value: Any) -> Any:
    """A number as Python has it: trackers keep times and places in arrays."""
    return value.item() if isinstance(value, np.generic) else value


def _with_all_alive(version: Version) -> Version:
    """For a predictor that is told of some cameras only: it must not take the silence of the others
    for their end.
    """
    model = version.model
    return version if model is None else replace(version, model=replace(model, cameras=[]))


def _leads(daemon: str) -> bool:
    """Whether a daemon, by its name, is the one that publishes the topology: of shards
    (``2of8-...``) the first.
    """
    number, of, _ = daemon.partition("of")
    return not (of and number.isdigit()) or number == "0"
