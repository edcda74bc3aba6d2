"""What became of the events that one run publishes, from the counters in the daemon's acks."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Sequence

from camtopod.records import Ack, Event

KNOWN_SECONDS = 0.6
"""The daemon tells a publisher that appears what it has of its cameras within this time, if it has
anything.
"""
Counts = tuple[int, int, int]
"""Accepted, late, refused."""


class Outcome:
    """Give it every ack, and the events before they are published. Thread-safe."""

    def __init__(self) -> None:
        self._mutex = threading.Lock()
        self._before: dict[tuple[str, str], Counts] = {}
        self._now: dict[tuple[str, str], Counts] = {}
        self._published: Counter[tuple[str, str]] = Counter()
        self._cameras: set[str] = set()
        self.told = False
        """Whether the daemon counts; an older one does not."""

    def new_cameras(self, events: Sequence[Event]) -> set[str]:
        """Cameras of these events of which there were none before."""
        return {event.camera for event in events} - self._cameras

    def publishing(self, events: Sequence[Event], own_boot: str) -> None:
        """These are about to be published; ``own_boot`` is that of events which have none."""
        with self._mutex:
            self._cameras.update(event.camera for event in events)
            self._published.update((event.camera, event.boot or own_boot) for event in events)

    def on_ack(self, ack: Ack) -> None:
        """What is stored of a camera."""
        if ack.accepted is None or ack.late is None or ack.refused is None:
            return
        key, counts = (ack.camera, ack.boot), (ack.accepted, ack.late, ack.refused)
        with self._mutex:
            self.told = True
            (self._now if key in self._published else self._before)[key] = counts

    def counted(self) -> tuple[int, int, int, int]:
        """(accepted, late, refused, duplicate): how many of the published events became what."""
        accepted = late = refused = 0
        with self._mutex:
            for key, now in self._now.items():
                before = self._before.get(key, (0, 0, 0))
                if any(after < earlier for earlier, after in zip(before, now, strict=True)):
                    before = (0, 0, 0)  # the daemon has been started anew
                accepted, late, refused = (
                    total + after - earlier
                    for total, earlier, after in zip(
                        (accepted, late, refused), before, now, strict=True
                    )
                )
            return (
                accepted,
                late,
                refused,
                max(0, self._published.total() - accepted - late - refused),
            )

    def in_words(self) -> str:
        """For example ``10 accepted, 2 late, 1 duplicate``."""
        accepted, late, refused, duplicate = self.counted()
        parts = [f"{accepted} accepted"]
        parts += (
            [f"{late} late (older than what has been learned, so stored and not learned)"]
            if late
            else []
        )
        parts += (
            [f"{refused} refused (their camera floods, or they are from the future)"]
            if refused
            else []
        )
        parts += [f"{duplicate} duplicates, stored before"] if duplicate else []
        return ", ".join(parts)
