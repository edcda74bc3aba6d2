"""Publish ``status/{camera}`` for cameras whose own process cannot: it died, hung or does not
start.
"""

from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING, Any

from camtopod.config import Config
from camtopod.serve.runtime import clock

if TYPE_CHECKING:
    from camtopod.serve.bus import Bus

log = logging.getLogger(__name__)

CLOSE_SECONDS = 2.0
"""Time to wait for the thread at the end."""


class StatusReporter:
    """Publishes statuses from a thread of its own, so that a blocked bus delays no camera.

    It connects only when there is a status to publish.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._statuses: dict[str, dict[str, Any]] = {}
        self._buses: dict[str, Bus] = {}
        """One per camera, which may have a certificate of its own."""
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="statuses", daemon=True)
        self._thread.start()

    def publish(self, statuses: dict[str, dict[str, Any]]) -> None:
        """Publish these statuses from now on, and no others; never blocks."""
        self._statuses = statuses

    def close(self) -> bool:
        """Stop publishing; return False if the bus blocks and is left open."""
        self._closed.set()
        self._thread.join(CLOSE_SECONDS)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while not self._closed.wait(self._config.limits.status_seconds):
            statuses = self._statuses
            for camera in self._buses.keys() - statuses.keys():
                self._buses.pop(camera).close()
            for camera in statuses:
                try:
                    self._publish(camera)
                except OSError as error:
                    # No bus, as the cameras' own processes report, or no readable key.
                    log.debug("the status of camera %s cannot be published: %s", camera, error)
        for bus in self._buses.values():
            bus.close()

    def _publish(self, camera: str) -> None:
        """Publish the status of one camera. Raises `OSError` if there is no bus."""
        from camtopod.serve.bus import dial

        key = f"status/{camera}"
        if camera not in self._buses:
            self._buses[camera] = dial(self._config.certified(camera))
            self._buses[camera].answer_queries(key, lambda key, _: self._status(key), "status")
        self._buses[camera].publish(key, self._status(key), "status")

    def _status(self, key: str) -> dict[str, Any] | None:
        """Return the status on ``key``; None, which sends no reply, if the camera's process answers
        itself.
        """
        status = self._statuses.get(key.removeprefix("status/"))
        return None if status is None else {**status, "t": clock.wall()}
