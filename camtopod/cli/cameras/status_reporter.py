"""Publish ``status/{camera}`` for cameras whose own process cannot: it died, hung or does not
start.
"""

from __future__ import annotations

import logging
import threading
from typing import Any

from camtopod.config import Config
from camtopod.serve.runtime import clock

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
        self._something = threading.Event()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._speak, name="speaker", daemon=True)
        self._thread.start()

    def say(self, statuses: dict[str, dict[str, Any]]) -> None:
        """Publish these statuses from now on, and no others; never blocks."""
        self._statuses = statuses
        if statuses:
            self._something.set()

    def close(self) -> bool:
        """Stop publishing; return False if the bus blocks and is left open."""
        self._closed.set()
        self._something.set()
        self._thread.join(CLOSE_SECONDS)
        return not self._thread.is_alive()

    def _speak(self) -> None:
        """Connect for each camera, and publish its status until the end."""
        self._something.wait()
        if self._closed.is_set():
            return
        from camtopod.serve.bus import Bus, dial

        buses: dict[str, Bus] = {}  # one per camera, which may have a certificate of its own
        while not self._closed.is_set():
            statuses = self._statuses
            for camera in buses.keys() - statuses.keys():
                buses.pop(camera).close()
            for camera in statuses:
                try:
                    if camera not in buses:
                        buses[camera] = bus = dial(self._config.certified(camera))
                        bus.answer_queries(
                            f"status/{camera}", lambda key, _: self._of(key), "status"
                        )
                    buses[camera].publish(
                        f"status/{camera}", self._of(f"status/{camera}"), "status"
                    )
                except OSError as error:
                    # No bus, as the cameras' own processes report, or no readable key.
                    log.debug("the status of camera %s cannot be published: %s", camera, error)
            self._closed.wait(self._config.limits.status_seconds)
        for bus in buses.values():
            bus.close()

    def _of(self, key: str) -> dict[str, Any] | None:
        """Return the status on ``key``; None, which sends no reply, if the camera's process answers
        itself.
        """
        status = self._statuses.get(key.removeprefix("status/"))
        return None if status is None else {**status, "t": clock.wall()}
