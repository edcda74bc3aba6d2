"""Memory of passages: of objects that are in a view (open passages), and of those that just left.

A passage is known by the track of its object: it begins with the entry and ends with the exit of
the same track at the same camera, whichever of the two is heard first. Predictions and walks
remember their open passages in the same way, `OpenPassages`, each in its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Generic, TypeVar

import msgspec
from msgspec import Struct

from camtopod.predict.recent_events import RECENT_MAX

OPEN_MAX = RECENT_MAX
"""Largest number of open passages, and of ended passages, that are remembered."""
OPEN_SECONDS_MAX = 600.0
"""Seconds for which a passage without an exit counts as open, if its camera's longest dwell time is
not known.
"""


class Passage(Struct):
    """A passage through a view, as recorded at its entry; it is never changed."""

    t: float
    """Corrected time of the entry, seconds."""
    camera: str
    """Name of the camera."""
    entry: int
    """Index of the zone of entry."""
    label: int = -1
    """Number of the object's label (`camtopod.predict.labels`)."""


UNKNOWN = Passage(-math.inf, "", -1)
"""In place of a passage of which only the exit is known."""


AnyPassage = TypeVar("AnyPassage")


class OpenPassages(Generic[AnyPassage]):
    """The open passages by camera and track, in the order in which they began."""

    def __init__(self) -> None:
        self._passages: dict[tuple[str, str], AnyPassage] = {}
        """By (camera, track), in the order in which they began."""
        self._tracks: dict[str, dict[str, AnyPassage]] = {}
        """The same by camera, then track."""

    def __len__(self) -> int:
        return len(self._passages)

    def begin(self, camera: str, track: str, passage: AnyPassage) -> None:
        """Add a passage; it takes the place of an open passage of the same track, if any."""
        self._passages[camera, track] = passage
        self._tracks.setdefault(camera, {})[track] = passage

    def end(self, camera: str, track: str) -> AnyPassage | None:
        """Remove the passage of a track and return it; None if there is none."""
        passage = self._passages.pop((camera, track), None)
        if passage is not None:
            tracks = self._tracks[camera]
            del tracks[track]
            if not tracks:
                del self._tracks[camera]
        return passage

    def of(self, camera: str) -> Mapping[str, AnyPassage]:
        """Return a camera's open passages by track."""
        return self._tracks.get(camera, {})

    def passages(self) -> Iterable[tuple[tuple[str, str], AnyPassage]]:
        """Return all open passages, oldest first, each as ((camera, track), passage)."""
        return self._passages.items()


class RecentPassages:
    """The passages that predictions need: those that are open, and the newest that ended.

    longest (seconds): longest known dwell time by camera, after which a passage without an exit is
        forgotten.
    """

    def __init__(self, longest: dict[str, float]) -> None:
        self._longest = longest
        self.open: OpenPassages[Passage] = OpenPassages()
        """The open passages."""
        self._ended_passages: dict[tuple[str, str], tuple[float, Passage | None]] = {}
        """The newest exits by (camera, track), oldest first.

        Each is the time by the camera's clock, and the passage that ended; None if unknown.
        """
        self._last_exits: dict[str, tuple[float, list[tuple[str, Passage]]]] = {}
        """By camera: time of its newest exits by its clock, and (track, passage) of the passages
        that ended then.
        """

    def longest(self, camera: str) -> float:
        """Return how long a passage without an exit counts as open, seconds."""
        return self._longest.get(camera, OPEN_SECONDS_MAX)

    def begin(self, camera: str, track: str, t: float, passage: Passage) -> float | None:
        """Begin a passage at ``t`` by the camera's clock.

        Return the time of its exit by that clock, if it was heard before; else None.
        """
        ended_at, ended_passage = self._ended_passages.get((camera, track), (-math.inf, None))
        if ended_at > t or (ended_at == t and ended_passage is None):
            self._ended_passages[camera, track] = ended_at, passage
            self._note_last_exit(camera, track, ended_at, passage)
            return ended_at
        self.open.begin(camera, track, passage)
        return None

    def end(self, camera: str, track: str, t: float) -> Passage | None:
        """End the passage of a track at ``t`` by the camera's clock; return it if it was open."""
        passage = self.open.end(camera, track)
        self._ended_passages.pop((camera, track), None)  # the newest come last
        self._ended_passages[camera, track] = t, passage
        self._note_last_exit(camera, track, t, passage)
        if len(self._ended_passages) > OPEN_MAX:
            del self._ended_passages[next(iter(self._ended_passages))]
        return passage

    def left_at(self, camera: str, track: str, t: float) -> Passage | None:
        """Return the passage that ended at ``t`` by the camera's clock, or that is still open."""
        ended_at, passage = self._ended_passages.get((camera, track), (None, None))
        return passage if ended_at == t else self.open.of(camera).get(track)

    def open_at(self, camera: str, t: float, by_clock: float) -> list[tuple[str, Passage]]:
        """Return the passages of a camera that are open at the present moment, as (track, passage).

        t, by_clock: the present moment, as corrected time and by the camera's clock, seconds.

        Passages that end at this moment are included and those that begin are not, so the order of
        simultaneous events does not matter.
        """
        first = t - self.longest(camera)
        still_open = [item for item in self.open.of(camera).items() if item[1].t >= first]
        last, ended_passages = self._last_exits.get(camera, (None, []))
        just_ended = ended_passages if last == by_clock else []
        return [item for item in [*still_open, *just_ended] if item[1].t < t]

    def forget_stale(self, now: float) -> None:
        """Forget the oldest open passages as long as they last too long or are too many.

        now (seconds): corrected time.

        They are remembered for twice as long as they count as open: arrivals are asked about later.
        """
        while self.open:
            (camera, track), oldest = next(iter(self.open.passages()))
            is_fresh = now - oldest.t <= 2 * self.longest(camera)
            if is_fresh and len(self.open) <= OPEN_MAX:
                return
            self.open.end(camera, track)

    def take_over(
        self, older: RecentPassages, new_zones: dict[int, int], labels: dict[int, int]
    ) -> None:
        """Take over the passages stored for an older version; this must be new.

        new_zones: new index of each zone by its old index, without zones that are gone.
        labels: new number of each label by its old number.
        """
        # Open passages, except those whose zone of entry is gone.
        for key, passage in older.open.passages():
            if passage.entry in new_zones:
                self.open.begin(*key, _moved(passage, new_zones, labels))

        # Ended passages.
        self._ended_passages = {
            key: (
                t,
                None
                if ended_passage is None or ended_passage.entry not in new_zones
                else _moved(ended_passage, new_zones, labels),
            )
            for key, (t, ended_passage) in older._ended_passages.items()
        }
        for (camera, track), (t, ended_passage) in self._ended_passages.items():
            self._note_last_exit(camera, track, t, ended_passage)

    def _note_last_exit(self, camera: str, track: str, t: float, passage: Passage | None) -> None:
        """Add an exit to the newest exits of its camera, or let it replace earlier ones."""
        newest, ended_passages = self._last_exits.get(camera, (-math.inf, []))
        if t > newest:
            ended_passages = []
            self._last_exits[camera] = t, ended_passages
        if t >= newest and passage is not None:
            ended_passages.append((track, passage))


def _moved(passage: Passage, new_zones: dict[int, int], labels: dict[int, int]) -> Passage:
    """Return the passage with the new index of its zone of entry, and number of its label.

    new_zones, labels: new index of each zone, and number of each label, by the old one.
    """
    entry, label = new_zones[passage.entry], labels.get(passage.label, -1)
    if (entry, label) == (passage.entry, passage.label):
        return passage
    return msgspec.structs.replace(passage, entry=entry, label=label)
