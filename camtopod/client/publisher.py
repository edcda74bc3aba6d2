"""Publish the events of a camera from another program, with the spool that grabbers have."""

from __future__ import annotations

import atexit
import contextlib
import threading
from collections.abc import Sequence
from pathlib import Path

from msgspec.structs import replace

from camtopod import codec
from camtopod.client.site_view import Settings, settings_of
from camtopod.config import Config
from camtopod.records import Event
from camtopod.serve.bus import Bus, BusError, dial, guard, log_other_sites, note_use, sites_instead
from camtopod.serve.outbox import Publisher as Outbox, open_spool
from camtopod.serve.storage import StateError

ATTEMPT_SECONDS = 2.0
"""Longest attempt to connect; `Publisher.close` waits until the present one has ended."""
RETRY_SECONDS = 1.0
"""Interval between two attempts to connect, and to store events that a full disk has delayed."""


class Publisher(contextlib.AbstractContextManager["Publisher"]):
    """Publish the events of one camera: each is on disk until a daemon has stored it.

        with Publisher("lobby") as publisher:
            for t, ids, boxes in tracker:
                publisher.publish(*tracks.update(ids, boxes, t))
            publisher.wait_stored(10.0)

    A daemon that is not there is waited for in the background, and events that no daemon has stored
    by the end are published when the camera's next publisher starts. All methods may be called from
    any thread, but not in a forked child (`BusError`): start processes by "spawn".

    camera: id of the camera; one program at a time may publish it.
    site, connect, config: as for `camtopod.client.Site.connect`.
    state: directory for the spool; without it that of the configuration.

    Raises ValueError for an invalid camera, site or endpoint; `StateError` (an OSError) if the
    directory cannot be written or another program publishes this camera from it;
    `camtopod.config.settings.ConfigError` or OSError if the configuration cannot be read.
    """

    def __init__(
        self,
        camera: str,
        site: str | None = None,
        connect: str | Sequence[str] = (),
        config: Settings = None,
        state: str | Path | None = None,
    ) -> None:
        codec.require_camera(camera)
        note_use()
        settings = settings_of(site, connect, config)
        directory = settings.state_directory if state is None else Path(state)
        self.camera = camera
        self._spool = open_spool(directory, settings.site.name, camera, settings.limits)
        self._outbox = Outbox(self._spool)
        self._mutex = threading.Lock()  # of the outbox, the bus and the spool
        self._bus: Bus | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(
            target=self._keep_going, args=[settings], name=f"publisher of {camera}", daemon=True
        )
        self._thread.start()
        guard(self)
        atexit.register(self.close)  # a thread inside zenoh must not see the interpreter end

    def publish(self, *events: Event) -> None:
        """Store events in the spool, and publish them if there is a connection.

        Raises ValueError for an event of another camera or with values out of range, before any of
        the events is stored, and if this publisher is closed.
        """
        for event in events:
            if event.camera != self.camera:
                raise ValueError(f"an event of {event.camera}: this publishes {self.camera} only")
            codec.event_from_msgpack(codec.to_msgpack(event))
        with self._mutex:
            if self._closing.is_set():
                raise ValueError(f"the publisher of {self.camera} is closed")
            self._outbox.publish(*events)

    def wait_stored(self, seconds: float) -> bool:
        """Wait until a daemon has stored all events; return False if not within ``seconds``."""
        return self._outbox.wait_stored(seconds)

    @property
    def waiting(self) -> int:
        """Number of events that are not known to be stored by a daemon."""
        return self._outbox.waiting

    @property
    def dropped(self) -> int:
        """Number of events lost because the spool was full, or could not be written for long."""
        return self._outbox.dropped

    def close(self) -> None:
        """Leave the bus; events that no daemon has stored stay in the spool."""
        if self._closing.is_set():
            return
        atexit.unregister(self.close)
        self._closing.set()
        self._thread.join()
        with self._mutex:
            self._outbox.close()
            if self._bus is not None:
                self._bus.close()
            self._spool.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _keep_going(self, settings: Config) -> None:
        """Connect as soon as possible; store events later that could not be stored at once."""
        seconds = min(settings.bus.connect_seconds, ATTEMPT_SECONDS)
        settings = replace(settings, bus=replace(settings.bus, connect_seconds=seconds))
        while not self._closing.is_set():
            if self._bus is None:
                with contextlib.suppress(BusError):  # the daemon is waited for
                    bus = dial(settings)
                    with self._mutex:
                        self._outbox.attach(bus, [self.camera])
                        self._bus = bus
                    log_other_sites(bus, sites_instead(bus, settings))
            with self._mutex, contextlib.suppress(StateError):  # the next `publish` raises it
                self._outbox.retry()
            self._closing.wait(RETRY_SECONDS)
