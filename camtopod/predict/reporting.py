"""Which cameras still report: one that is silent while the others have events is probably dead."""

from __future__ import annotations

import numpy as np

from camtopod.arrays import Floats

DEAD_PRIOR = 1e-3
"""Prior probability that a camera has stopped reporting for good."""
SILENCE_NATS_MAX = 50.0
"""Largest evidence (nats) of a camera's silence that counts."""


class Reporting:
    """Counts events, to tell the cameras that still report.

    cameras: names of the cameras that have zones.
    share (cameras,): share of each in all events of the site.

    events: number of observed events.
    """

    def __init__(self, cameras: list[str], share: Floats) -> None:
        self._cameras = cameras
        self._share = share
        self.events = 0
        self._last = np.zeros(len(cameras), np.int64)
        """(cameras,) number of each camera's last event in the order of all events."""

    def note(self, camera: int | None) -> None:
        """Note one event; ``camera`` is the number of its camera, None if it has no zone."""
        self.events += 1
        if camera is not None:
            self._last[camera] = self.events

    def is_alive(self) -> Floats:
        """Return the probability (cameras,) that each camera still reports, if it did at first.

        It is computed from the number of other cameras' events since the camera's last event.
        """
        nats = (self.events - self._last) * self._share
        dead = DEAD_PRIOR * np.expm1(np.minimum(nats, SILENCE_NATS_MAX))
        is_alive: Floats = 1.0 / (1.0 + dead)
        return is_alive

    def last_events(self) -> dict[str, int]:
        """Return the number of each camera's last event in the order of all events."""
        return dict(zip(self._cameras, self._last.tolist(), strict=True))

    def load(self, events: int, last_events: dict[str, int]) -> None:
        """Go on from earlier counts; a new camera counts as if it just had an event."""
        self.events = events
        self._last = np.array(
            [last_events.get(camera, events) for camera in self._cameras], np.int64
        )
