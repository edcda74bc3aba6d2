"""``status/{camera}`` for those cameras whose own process cannot say it: it died, hung, or does not
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


class Speaker:
    """A thread of its own, so that a bus that is away holds no camera up. It dials when there is
    something to say.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._statuses: dict[str, dict[str, Any]] = {}
        self._something = threading.Event()
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._speak, name="speaker", daemon=True)
        self._thread.start()

    def say(self, statuses: dict[str, dict[str, Any]]) -> None:
        """From now on this, of these cameras and no others. Never blocks."""
        self._statuses = statuses
        if statuses:
            self._something.set()

    def close(self) -> bool:
        """Nothing more; False if the bus blocks and is left as it is."""
        self._closed.set()
        self._something.set()
        self._thread.join(CLOSE_SECONDS)
        return not self._thread.is_alive()

    def _speak(self) -> None:
        self._something.wait()
        if self._closed.is_set():
            return
        from camtopod.serve.bus import Bus, dial

        buses: dict[str, Bus] = {}  # one a camera: each may have a certificate of its own
        while not self._closed.is_set():
            statuses = self._statuses
            for camera in buses.keys() - statuses.keys():
                buses.pop(camera).close()
            for camera in statuses:
                try:
                    if camera not in buses:
                        buses[camera] = bus = dial(self._config.certified(camera))
                        bus.answer(f"status/{camera}", lambda key, _: self._of(key), "status")
                    buses[camera].put(f"status/{camera}", self._of(f"status/{camera}"), "status")
                except (
                    OSError
                ) as error:  # the bus is away, which the cameras' own processes say, or a key is
                    log.debug("the status of camera %s cannot be published: %s", camera, error)
            self._closed.wait(self._config.limits.status_seconds)
        for bus in buses.values():
            bus.close()

    def _of(self, key: str) -> dict[str, Any] | None:
        """The status on ``key``; None, which is no answer, for a camera that speaks for itself."""
        status = self._statuses.get(key.removeprefix("status/"))
        return None if status is None else {**status, "t": clock.wall()}
