"""The newest version of a site's topology and the queries it answers without waiting.

A thread keeps the version up to date by a `camtopod.serve.bus.TopologySubscriber`.
"""

from __future__ import annotations

import atexit
import contextlib
import logging
import math
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from camtopod import codec
from camtopod.client.answer_queue import AnswerQueue
from camtopod.client.errors import NothingLearned
from camtopod.client.gate import Gate
from camtopod.client.wakeup import ChangeSignal
from camtopod.config import Config, config_file, secret_files
from camtopod.predict import Predictor, PreparedVersion
from camtopod.records import Between, DaemonStatus, Event, Prediction, Topology
from camtopod.serve.bus import (
    QUERY_SECONDS,
    Bus,
    BusError,
    QueryError,
    TopologySubscriber,
    dial,
    guard,
    in_words,
    sites_instead,
    take_only_site,
)
from camtopod.serve.runtime import clock
from camtopod.topology import zone_at

log = logging.getLogger(__name__)

FIRST_SECONDS = 3 * QUERY_SECONDS
"""Longest wait for the version of a daemon that is there, several queries' time."""
LOOK_SECONDS = 0.5
"""Longest interval between two checks of the bus, even without a notification."""
Settings = Config | str | Path | None
"""A configuration, or the file that holds one."""
QueueT = TypeVar("QueueT", bound=AnswerQueue[Any])


class SiteView:
    """Current state of a site: common part of both `Site` classes.

    `camtopod.client.Site` and `camtopod.client.aio.Site` add the methods that wait.
    """

    def __init__(
        self, site: str | None = None, connect: str | Sequence[str] = (), config: Settings = None
    ) -> None:
        """Connect; arguments are those of `camtopod.client.Site.connect`."""
        settings = settings_of(site, connect, config)
        self._bus = dial(settings)
        self._news = ChangeSignal()
        # Predictors are not thread-safe, and no subscription is opened once closing has begun.
        self._mutex = threading.Lock()
        self._gate: Gate | None = None
        """Of the newest version; so is the predictor."""
        self._predictor: Predictor | None = None
        self._queues: list[AnswerQueue[Any]] = []
        self.stale_since: float | None = clock.wall()
        """Time since when the daemon is unreachable, seconds since the epoch; None while reachable.

        The version held stays usable. A daemon that ends or is killed is noticed at once; one that
        hangs or loses its connection, within ten seconds.
        """
        self._wake = threading.Event()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._follow, name="topology", daemon=True)

        # Close the session on failure.
        with contextlib.ExitStack() as undo:
            undo.callback(self._bus.close)
            other_sites = sites_instead(self._bus, settings)
            is_taken = site is None and take_only_site(self._bus, settings, other_sites)
            if other_sites and not is_taken:
                raise BusError(
                    f"no daemon of site {self._bus.site} is there{in_words(other_sites)}"
                )
            self._view = TopologySubscriber(self._bus, self._wake.set)
            self._wake.wait(QUERY_SECONDS)  # a running daemon is announced at once
            self._use(self._view.first(FIRST_SECONDS))
            self._thread.start()
            undo.pop_all()
        guard(self)
        atexit.register(self.close)  # a thread inside zenoh must not see the interpreter end

    @property
    def site(self) -> str:
        """Name of the site."""
        return self._bus.site

    @property
    def current(self) -> Topology | None:
        """The newest version known.

        None if nothing has been learned yet, or if the daemon has never been reached.
        """
        return None if self._gate is None else self._gate.topology

    @property
    def version(self) -> int:
        """Number of `current`, 0 for none; grows by one within an epoch (``current.epoch``)."""
        return 0 if self._gate is None else self._gate.topology.version

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
        label: str | None = None,
    ) -> Prediction:
        """Predict where an object that left ``camera`` at ``t`` appears next.

        The version held answers, without a query to the daemon, in about a tenth of a millisecond.

        t: seconds since the epoch by the camera's clock; times in the answer are seconds after it.
        x, y: where the object left (fractions of the image); omit them at a camera without
            positions.
        zone: id of the zone where it left, instead of ``x`` and ``y``.
        track: its track in that view. If the track's entry was passed to `observe`, the passage is
            taken into account, unless ``zone`` is given.
        now: time of the query, if later than the exit, by the same camera's clock. Arrivals that
            would have been seen by then and were not shift the odds to the remaining ones and to
            ``leave``; an entry passed to `observe` since the exit may have been the object's.
        label: class of the object (``person``); if omitted, that of the entry of its track.

        Where views overlap the object may already be visible elsewhere, which needs its entry there
        passed to `observe`, too.

        Raises `NothingLearned`; `UnknownPlace` (a KeyError) for a camera or zone that this version
        does not have; ValueError for an invalid event, for a zone together with a position, or for
        ``now`` before ``t``.
        """
        # Validate the exit as if it had been received.
        fields = {"camera": camera, "kind": "exit", "t": t, "x": x, "y": y, "track": track}
        fields["label"] = label
        values = {name: _plain(value) for name, value in fields.items() if value is not None}
        event = codec.event_from_msgpack(codec.to_msgpack(values))
        if zone is not None and x is not None:
            raise ValueError("give a zone or a position, not both")

        # Query the predictor by zone or by position.
        with self._mutex:
            topology, predictor = self._now().topology, self._predictor
            assert predictor is not None
            if zone is None:
                return predictor.predict(event, now)
            place = zone_at(topology.version, topology.zones, zone, camera)
            return predictor.predict_from(place, event.t, track=track, now=now, label=event.label)

    def observe(self, event: Event) -> None:
        """Record an event for later predictions; an exit only after it was first predicted.

        Pass events of all cameras, or of those that the program sees, in order of time as far as
        possible. The newest 2,000 of each kind count. Events passed before the first version are
        ignored.
        """
        with self._mutex:
            if self._predictor is not None:
                self._predictor.observe(event)

    def gate(
        self,
        from_zone: str,
        t_exit: float,
        to_camera: str,
        t_entry: float,
        to_zone: str | None = None,
    ) -> float:
        """Return `Gate.gate` of the version held; raise `NothingLearned`, `UnknownPlace`."""
        return self._now().gate(from_zone, t_exit, to_camera, t_entry, to_zone)

    def gate_new(self, to_camera: str, to_zone: str | None = None) -> float:
        """Return `Gate.gate_new` of the version held; raise `NothingLearned`, `UnknownPlace`."""
        return self._now().gate_new(to_camera, to_zone)

    def gate_gone(self, from_zone: str, seconds: float = math.inf) -> float:
        """Return `Gate.gate_gone` of the version held; raise `NothingLearned`, `UnknownPlace`."""
        return self._now().gate_gone(from_zone, seconds)

    def affinity(
        self, exits: Sequence[Event], entries: Sequence[Event], now: float | None = None
    ) -> NDArray[np.float64]:
        """Return `Gate.affinity` of the version held; raise as it does, or `NothingLearned`."""
        return self._now().affinity(exits, entries, now)

    def _between(self) -> Between | None:
        """Do what `camtopod.client.Site.between` does."""
        self._require_open()
        with contextlib.suppress(QueryError):
            for _, payload in self._bus.query("status/daemon", {"pairs": "all"}, one=True):
                return codec.read(DaemonStatus, payload, pack=True).between
        return None

    def close(self) -> None:
        """Leave the bus and release all waiters; the version held stays usable.

        May be called repeatedly. At the end of the program it is called by itself.
        """
        atexit.unregister(self.close)
        with self._mutex:
            if self._closing.is_set():
                return
            self._closing.set()
        self._wake.set()
        self._news.close()
        for queue in self._queues:
            queue.close()
        self._thread.join()
        self._bus.close()

    def _opened(self, open_queue: Callable[[Bus], QueueT]) -> QueueT:
        """Open a subscription that `close` closes. Raises `BusError` if this is closed already."""
        with self._mutex:
            self._require_open()
            queue = open_queue(self._bus)
            still_open = [answer_queue for answer_queue in self._queues if not answer_queue.closed]
            self._queues = [*still_open, queue]
        return queue

    def _require_open(self) -> None:
        if self._closing.is_set():
            raise BusError(f"the topology of site {self.site} has been closed: connect again")

    def _now(self) -> Gate:
        if self._gate is None:
            raise NothingLearned
        return self._gate

    def _at_least(self, version: int) -> Topology | None:
        current = self.current
        return None if current is None or current.version < version else current

    def _not_there(self, version: int, seconds: float) -> str:
        presence = "the daemon is there"
        if self.stale_since is not None:
            presence = "no daemon is there: is `camtopod run` running?"
        return (
            f"no version {version} of site {self.site} within {seconds:g} s, "
            f"the newest is {self.version}; {presence}"
        )

    def _newer(self, than: Topology | None) -> Topology | None:
        return None if self.current is than else self.current

    def _follow(self) -> None:
        try:
            while not self._closing.is_set():
                self._wake.wait(LOOK_SECONDS)
                self._wake.clear()
                self._use(self._view.update())
        finally:
            self._say_there(False)

    def _use(self, version: Topology | None) -> None:
        """Answer by a newer version, if there is one."""
        if version is not None:
            prepared_version = PreparedVersion(_with_all_alive(version))
            gate, predictor = Gate(version, prepared_version), Predictor(version, prepared_version)
            with self._mutex:
                if self._predictor is not None:
                    predictor.take_over(self._predictor)
                self._gate, self._predictor = gate, predictor
            self._news.notify()
        self._say_there(self._bus.connected and bool(self._view.daemons))

    def _say_there(self, is_there: bool) -> None:
        if is_there != (self.stale_since is None):
            self.stale_since = None
            if not is_there:
                self.stale_since = clock.wall()
            self._news.notify()


def settings_of(site: str | None, connect: str | Sequence[str], config: Settings) -> Config:
    """Return the configuration with site and endpoints applied.

    Raises `camtopod.config.settings.ConfigError`, OSError, ValueError.
    """
    settings = Config()
    if isinstance(config, Config):
        settings = config
    elif config is not None:
        settings = config_file.load(Path(config))
        for sentence in secret_files.find_exposed(settings.secrets(Path(config))):
            log.warning("%s", sentence)

    return settings.joining(site, [connect] if isinstance(connect, str) else connect)


def _plain(value: Any) -> Any:
    """Return a number as a Python type: trackers keep times and positions in NumPy arrays."""
    return value.item() if isinstance(value, np.generic) else value


def _with_all_alive(version: Topology) -> Topology:
    """Return the version without the cameras' shares of all events.

    The predictor may be given events of some cameras only and must not take the silence of the
    others for a failure.
    """
    if version.model is None:
        return version
    return replace(version, model=replace(version.model, event_share=b""))
