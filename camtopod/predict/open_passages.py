"""Passages under way, who came into a view and has not left it; and of the newest who have, the
passages they ended.
"""

from __future__ import annotations

from collections.abc import Collection

import msgspec
from msgspec import Struct

from camtopod.predict.recent_events import RECENT_MAX

UNDER_WAY_MAX = RECENT_MAX
"""Passages under way that are remembered; of those that have ended as many."""
UNDER_WAY_SECONDS_MAX = 600.0
"""A passage without an exit is forgotten after this, or after the longest known at its camera."""


class Passage(Struct):
    """A stay in a view, as far as it is known when it begins; ``t`` in right time."""

    t: float
    camera: str
    entry: int
    """Zone of entry."""
    previous: str | None = None
    """Camera it most probably came from, and the probability of that."""
    sure: float = 0.0


class UnderWay:
    """Passages by camera and track, in the order they began. ``stay_max``: the longest known by
    camera, seconds.
    """

    def __init__(self, stay_max: dict[str, float]) -> None:
        self._stay_max = stay_max
        self._passages: dict[tuple[str, str], Passage] = {}
        self._in_view: dict[str, dict[str, tuple[int, Passage]]] = {}
        """The same by camera and track, each with its place among all."""
        self._begun = 0
        self._ended: dict[tuple[str, str], tuple[float, Passage | None]] = {}
        """When the newest left, by their cameras' clocks, and after which passage."""
        self._left_last: dict[str, tuple[float, list[tuple[str, Passage]]]] = {}
        """By camera, the newest time of an exit by its clock, and the passages that ended then,
        with their tracks.
        """

    def begin(self, camera: str, track: str, passage: Passage) -> None:
        """One whose track is under way already keeps its place."""
        self._passages[camera, track] = passage
        in_view = self._in_view.setdefault(camera, {})
        self._begun += 1
        in_view[track] = (in_view[track][0] if track in in_view else self._begun, passage)

    def end(self, camera: str, track: str, t: float) -> Passage | None:
        """Not under way any more since ``t`` by the camera's clock; what was."""
        passage = self._leaves(camera, track)
        self._ended.pop((camera, track), None)  # the newest come last
        self._ended[camera, track] = t, passage
        self._note_last(camera, track, t, passage)
        if len(self._ended) > UNDER_WAY_MAX:
            del self._ended[next(iter(self._ended))]
        return passage

    def get(self, camera: str, track: str) -> Passage | None:
        """The passage under way."""
        return self._passages.get((camera, track))

    def left_at(self, camera: str, track: str, t: float) -> Passage | None:
        """The passage that ended at ``t`` by the camera's clock, or is about to."""
        left, passage = self._ended.get((camera, track), (None, None))
        return passage if left == t else self.get(camera, track)

    def in_view(self, camera: str) -> Collection[tuple[int, Passage]]:
        """Those at a camera, each with its place among all."""
        return self._in_view.get(camera, {}).values()

    def was_in_view(self, camera: str, entry: int, began: float, t: float) -> bool:
        """Whether a passage that ``began`` at the zone ``entry`` was not over before ``t`` by the
        camera's clock.
        """
        going_on = (passage for _, passage in self.in_view(camera))
        over = (
            one
            for (of, _), (left, one) in self._ended.items()
            if of == camera and one is not None and left >= t
        )
        return any(passage.t == began and passage.entry == entry for passage in (*going_on, *over))

    def open_at(self, camera: str, t: float, by_clock: float) -> list[tuple[str, Passage]]:
        """Passages at a camera, with their tracks, that are open at the newest time ``t`` (seconds
        in right time; ``by_clock``: by the camera's clock). Those that end at that instant are
        among them, those that begin then are not: so the order in which events of one instant come
        does not matter.
        """
        last, ended = self._left_last.get(camera, (None, []))
        now = [(track, passage) for track, (_, passage) in self._in_view.get(camera, {}).items()]
        return [one for one in [*now, *(ended if last == by_clock else [])] if one[1].t < t]

    def forget_stale(self, now: float) -> None:
        """Forget the oldest: those that have lasted too long, and any beyond the limit."""
        while self._passages:
            key, oldest = next(iter(self._passages.items()))
            fresh = now - oldest.t <= self._stay_max.get(oldest.camera, UNDER_WAY_SECONDS_MAX)
            if fresh and len(self._passages) <= UNDER_WAY_MAX:
                return
            self._leaves(*key)

    def passages(self) -> list[tuple[str, str, Passage]]:
        """(camera, track, passage) of all under way, oldest first."""
        return [(camera, track, passage) for (camera, track), passage in self._passages.items()]

    def take_over(self, older: UnderWay, moved: dict[int, int]) -> None:
        """Remember what another has and nothing else; ``moved``: its zones' numbers here, without
        those gone.
        """
        self._passages = {
            key: _moved(passage, moved)
            for key, passage in older._passages.items()
            if passage.entry in moved
        }
        self._begun, self._in_view = len(self._passages), {}
        for place, ((camera, track), passage) in enumerate(self._passages.items(), start=1):
            self._in_view.setdefault(camera, {})[track] = place, passage
        self._ended = {
            key: (t, None if ended is None or ended.entry not in moved else _moved(ended, moved))
            for key, (t, ended) in older._ended.items()
        }
        for (camera, track), (t, ended) in self._ended.items():
            self._note_last(camera, track, t, ended)

    def _note_last(self, camera: str, track: str, t: float, passage: Passage | None) -> None:
        if camera not in self._left_last or self._left_last[camera][0] != t:
            self._left_last[camera] = t, []
        if passage is not None:
            self._left_last[camera][1].append((track, passage))

    def _leaves(self, camera: str, track: str) -> Passage | None:
        passage = self._passages.pop((camera, track), None)
        if passage is not None:
            in_view = self._in_view[camera]
            del in_view[track]
            if not in_view:
                del self._in_view[camera]
        return passage


def _moved(passage: Passage, moved: dict[int, int]) -> Passage:
    """Passages are never changed, so most are the same one."""
    entry = moved[passage.entry]
    return passage if entry == passage.entry else msgspec.structs.replace(passage, entry=entry)
