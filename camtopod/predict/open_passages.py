"""Open passages: objects that entered a view and have not left it, and passages that just ended."""

from __future__ import annotations

from collections.abc import Collection

import msgspec
from msgspec import Struct

from camtopod.predict.recent_events import RECENT_MAX

OPEN_MAX = RECENT_MAX
"""Number of open passages, and of ended ones, that are remembered."""
OPEN_SECONDS_MAX = 600.0
"""Seconds after which a passage without an exit is forgotten, if its camera's longest dwell time is
not known.
"""


class Passage(Struct):
    """A passage through a view, as far as it is known when it begins. Never changed."""

    t: float
    """Corrected time of the entry, seconds."""
    camera: str
    entry: int
    """Zone of entry."""
    previous: str | None = None
    """Camera where the object most probably was before."""
    sure: float = 0.0
    """Probability that ``previous`` is right."""


class OpenPassages:
    """Passages by camera and track, in the order in which they began."""

    def __init__(self, longest: dict[str, float]) -> None:
        """``longest``: the longest known dwell time of cameras, in seconds."""
        self._longest = longest
        self._passages: dict[tuple[str, str], Passage] = {}
        self._in_view: dict[str, dict[str, tuple[int, Passage]]] = {}
        """The same by camera and track, each with its number in the order of all."""
        self._begun = 0
        """Number of passages that have begun."""
        self._ended: dict[tuple[str, str], tuple[float, Passage | None]] = {}
        """The newest exits, oldest first: their time by the camera's clock, and the passage that
        ended, None if it is not known.
        """
        self._last_exits: dict[str, tuple[float, list[tuple[str, Passage]]]] = {}
        """By camera: the time of its newest exits by its clock, and the passages that ended then,
        with their tracks.
        """

    def begin(self, camera: str, track: str, passage: Passage) -> None:
        """Add a passage. It replaces one of the same track, and takes its place in the order."""
        self._passages[camera, track] = passage
        in_view = self._in_view.setdefault(camera, {})
        self._begun += 1
        number = in_view[track][0] if track in in_view else self._begun
        in_view[track] = number, passage

    def end(self, camera: str, track: str, t: float) -> Passage | None:
        """End a track's passage at ``t`` by the camera's clock, and return it if it was open."""
        passage = self._remove(camera, track)
        self._ended.pop((camera, track), None)  # the newest come last
        self._ended[camera, track] = t, passage
        self._note_last_exit(camera, track, t, passage)
        if len(self._ended) > OPEN_MAX:
            del self._ended[next(iter(self._ended))]
        return passage

    def get(self, camera: str, track: str) -> Passage | None:
        """Return a track's open passage."""
        return self._passages.get((camera, track))

    def left_at(self, camera: str, track: str, t: float) -> Passage | None:
        """Return the passage that ended at ``t`` by the camera's clock, or is about to end."""
        left, passage = self._ended.get((camera, track), (None, None))
        return passage if left == t else self.get(camera, track)

    def in_view(self, camera: str) -> Collection[tuple[int, Passage]]:
        """Return a camera's open passages, each with its number in the order of all."""
        return self._in_view.get(camera, {}).values()

    def was_in_view(self, camera: str, entry: int, began: float, t: float) -> bool:
        """Return True if a passage that began then and there had not ended before ``t``.

        entry: its zone of entry; began: corrected time, seconds; t: seconds by the camera's clock.
        """
        still_open = (passage for _, passage in self.in_view(camera))
        ended = (
            passage
            for (of, _), (left, passage) in self._ended.items()
            if of == camera and passage is not None and left >= t
        )
        return any(one.t == began and one.entry == entry for one in (*still_open, *ended))

    def open_at(self, camera: str, t: float, by_clock: float) -> list[tuple[str, Passage]]:
        """Return the passages of a camera, with their tracks, that are open at the present moment.

        Passages that end at this moment are included, those that begin are not, so the order of
        simultaneous events does not matter.

        t, by_clock: the present moment, as corrected time and by the camera's clock.
        """
        still_open = [(track, one) for track, (_, one) in self._in_view.get(camera, {}).items()]
        last, ended = self._last_exits.get(camera, (None, []))
        just_ended = ended if last == by_clock else []
        return [each for each in [*still_open, *just_ended] if each[1].t < t]

    def forget_stale(self, now: float) -> None:
        """Forget the oldest passages: those that last too long, and those above the limit."""
        while self._passages:
            key, oldest = next(iter(self._passages.items()))
            is_fresh = now - oldest.t <= self._longest.get(oldest.camera, OPEN_SECONDS_MAX)
            if is_fresh and len(self._passages) <= OPEN_MAX:
                return
            self._remove(*key)

    def passages(self) -> list[tuple[str, str, Passage]]:
        """Return (camera, track, passage) of all open passages, oldest first."""
        return [(camera, track, passage) for (camera, track), passage in self._passages.items()]

    def take_over(self, older: OpenPassages, moved: dict[int, int]) -> None:
        """Replace all passages by those of an older version.

        moved: the present number of each zone by its older number; zones that are gone are missing.
        """
        # Open passages, except those whose zone of entry is gone.
        self._passages = {
            key: _with_moved_entry(passage, moved)
            for key, passage in older._passages.items()
            if passage.entry in moved
        }
        self._begun, self._in_view = len(self._passages), {}
        for number, ((camera, track), passage) in enumerate(self._passages.items(), start=1):
            self._in_view.setdefault(camera, {})[track] = number, passage

        # Ended passages.
        self._ended = {
            key: (
                t,
                None if one is None or one.entry not in moved else _with_moved_entry(one, moved),
            )
            for key, (t, one) in older._ended.items()
        }
        for (camera, track), (t, ended) in self._ended.items():
            self._note_last_exit(camera, track, t, ended)

    def _note_last_exit(self, camera: str, track: str, t: float, passage: Passage | None) -> None:
        if camera not in self._last_exits or self._last_exits[camera][0] != t:
            self._last_exits[camera] = t, []
        if passage is not None:
            self._last_exits[camera][1].append((track, passage))

    def _remove(self, camera: str, track: str) -> Passage | None:
        passage = self._passages.pop((camera, track), None)
        if passage is not None:
            in_view = self._in_view[camera]
            del in_view[track]
            if not in_view:
                del self._in_view[camera]
        return passage


def _with_moved_entry(passage: Passage, moved: dict[int, int]) -> Passage:
    """Return the passage with the present number of its zone of entry; most stay the same."""
    entry = moved[passage.entry]
    return passage if entry == passage.entry else msgspec.structs.replace(passage, entry=entry)
