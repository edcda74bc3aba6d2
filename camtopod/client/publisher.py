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
from camtopod.serve.bus import guard, note_use
from camtopod.serve.outbox import OWNER, SiteLink, SpoolPublisher, open_spool
from camtopod.serve.storage import StateError

ATTEMPT_SECONDS = 2.0
"""Longest attempt to connect; `Publisher.close` waits until the present one has ended."""
RETRY_SECONDS = 1.0
"""Interval between two attempts to store events that a full disk has delayed."""


class Publisher(contextlib.AbstractContextManager["Publisher"]):
    """Publish the events of one camera: each is on disk until all its sites have stored it.

        with Publisher("lobby") as publisher:
            for t, ids, boxes in tracker:
                publisher.publish(*tracks.update(ids, boxes, t))
            publisher.wait_stored(10.0)

    A daemon that is not there is waited for in the background, and events that it has not stored by
    the end are published when the camera's next publisher starts. All methods may be called from
    any thread, but not in a forked child (`BusError`): start processes by "spawn".

    camera: id of the camera; one program at a time may publish it.
    site, connect, config: as for `camtopod.client.Site.connect`.
    state: directory for the spool; without it that of the configuration.
    sites: all sites to which the camera delivers, its owner, the site above, first; without them
        those of the configuration, which says in ``[sites.NAME]`` where the others are.

    Raises ValueError for an invalid camera, site or endpoint, or sites whose place is not known;
    `StateError` (an OSError) if the directory cannot be written or another program publishes this
    camera from it;
    `camtopod.config.settings.ConfigError` or OSError if the configuration cannot be read.
    """

    def __init__(
        self,
        camera: str,
        site: str | None = None,
        connect: str | Sequence[str] = (),
        config: Settings = None,
        state: str | Path | None = None,
        sites: Sequence[str] = (),
    ) -> None:
        codec.require_camera(camera)
        note_use()
        settings = _delivering(settings_of(site, connect, config), camera, sites)
        directory = settings.state_directory if state is None else Path(state)
        self.camera = camera
        self._spool = open_spool(
            directory, settings.site.name, camera, settings.limits, settings.sites_of
        )
        self._outbox = SpoolPublisher(self._spool)
        self._mutex = threading.Lock()  # of the outbox and the spool
        self._closing = threading.Event()
        seconds = min(settings.bus.connect_seconds, ATTEMPT_SECONDS)
        settings = replace(settings, bus=replace(settings.bus, connect_seconds=seconds))
        self._links = [
            SiteLink(settings, self._outbox, [camera], name)
            for name in (OWNER, *settings.sites_of(camera)[1:])
        ]
        self._thread = threading.Thread(
            target=self._keep_going, name=f"publisher of {camera}", daemon=True
        )
        self._thread.start()
        guard(self)
        atexit.register(self.close)  # a thread inside zenoh must not see the interpreter end

    def publish(self, *events: Event) -> None:
        """Store events in the spool, and publish them if there is a connection.

        Raises ValueError for an event of another camera or with values out of range, before any of
        the events is stored, and if this publisher is closed; TypeError for another type.
        """
        for event in events:
            codec.time_of(event)
            if event.camera != self.camera:
                raise ValueError(f"an event of {event.camera}: this publishes {self.camera} only")
            codec.event_from_msgpack(codec.to_msgpack(event))
        with self._mutex:
            if self._closing.is_set():
                raise ValueError(f"the publisher of {self.camera} is closed")
            self._outbox.publish(*events)

    def wait_stored(self, seconds: float) -> bool:
        """Wait until all sites have stored all events; return False if not within ``seconds``."""
        return self._outbox.wait_stored(seconds)

    @property
    def waiting(self) -> int:
        """Number of events that are not known to be stored by the daemons of all sites."""
        return self._outbox.waiting

    @property
    def dropped(self) -> int:
        """Number of events lost because the spool was full, or could not be written for long.

        An event that is lost to several sites counts for each of them.
        """
        return self._outbox.dropped

    def close(self) -> None:
        """Leave the bus; events that some site has not stored stay in the spool."""
        if self._closing.is_set():
            return
        atexit.unregister(self.close)
        self._closing.set()
        self._thread.join()
        for link in self._links:
            link.closing.set()
        for link in self._links:
            link.close()
        with self._mutex:
            self._outbox.close()
            self._spool.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _keep_going(self) -> None:
        """Store events later that could not be stored at once."""
        while not self._closing.wait(RETRY_SECONDS):
            with self._mutex, contextlib.suppress(StateError):  # the next `publish` raises it
                self._outbox.retry()


def _delivering(config: Config, camera: str, sites: Sequence[str]) -> Config:
    """Return the configuration where ``camera`` delivers to these sites, if there are any.

    Raises `ValueError`.
    """
    if not sites:
        return config
    if sites[0] != config.site.name or not config.sites.keys() >= {*sites[1:]}:
        raise ValueError(
            f"sites {sites!r}: the first one has to be site {config.site.name}, and each other one "
            "needs a table [sites.NAME] that says where it is"
        )
    settings = replace(config.cameras.get(camera, config.new_camera), sites=tuple(sites))
    return replace(config, cameras={**config.cameras, camera: settings})
