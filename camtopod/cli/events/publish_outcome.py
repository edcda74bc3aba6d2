"""Outcome of the events that one run publishes, from counters in the daemon's acknowledgements."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Sequence

from camtopod.records import Ack, Event

KNOWN_SECONDS = 0.6
"""Time within which the daemon tells a new publisher what it has stored of its cameras, if
anything.
"""
Counts = tuple[int, int, int]
"""Numbers of accepted, late and refused events."""


class Outcome:
    """Counts what became of published events; needs every acknowledgement and every event.
    Thread-safe.
    """

    def __init__(self) -> None:
        self._mutex = threading.Lock()
        self._before: dict[tuple[str, str], Counts] = {}
        self._now: dict[tuple[str, str], Counts] = {}
        self._published: Counter[tuple[str, str]] = Counter()
        self._cameras: set[str] = set()
        self.told = False
        """True if the daemon sends counts; older daemons do not."""

    def new_cameras(self, events: Sequence[Event]) -> set[str]:
        """Return the cameras of these events that have not been published before."""
        return {event.camera for event in events} - self._cameras

    def publishing(self, events: Sequence[Event], own_boot: str) -> None:
        """Register events that are about to be published; ``own_boot`` is the boot of those without
        one.
        """
        with self._mutex:
            self._cameras.update(event.camera for event in events)
            self._published.update((event.camera, event.boot or own_boot) for event in events)

    def on_ack(self, ack: Ack) -> None:
        """Store the counts of an acknowledgement."""
        if ack.accepted is None or ack.late is None or ack.refused is None:
            return
        key, counts = (ack.camera, ack.boot), (ack.accepted, ack.late, ack.refused)
        with self._mutex:
            self.told = True
            (self._now if key in self._published else self._before)[key] = counts

    def counted(self) -> tuple[int, int, int, int]:
        """Return how many of the published events were (accepted, late, refused, duplicates)."""
        accepted = late = refused = 0
        with self._mutex:
            for key, now in self._now.items():
                before = self._before.get(key, (0, 0, 0))
                if any(after < earlier for earlier, after in zip(before, now, strict=True)):
                    before = (0, 0, 0)  # the daemon has restarted
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
        """Return the counts in words, such as ``10 accepted, 1 duplicates (stored before)``."""
        accepted, late, refused, duplicate = self.counted()
        parts = [f"{accepted} accepted"]
        parts += (
            [f"{late} late (older than the events learned last: stored but not learned)"]
            if late
            else []
        )
        parts += (
            [f"{refused} refused (too many of one camera, or event times in the future)"]
            if refused
            else []
        )
        parts += [f"{duplicate} duplicates (stored before)"] if duplicate else []
        return ", ".join(parts)
