"""Explanations of object ids by a camera: renamed, merged, split, part of another object.

Such an id is not gone, and the one that it becomes has not come. A merged object is followed as all
that it was merged from, so that each of them leaves where it leaves; a split gives them back.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from camtopod.adapt.adapter import remember
from camtopod.adapt.camera_streams import Name, TrackedBox
from camtopod.adapt.tracks import TrackEvents


class ObjectTree:
    """Names of the tracks of one camera's objects, by their ids.

    tracks: those of the camera.
    """

    def __init__(self, tracks: TrackEvents) -> None:
        self.t = -math.inf
        """Time of the last frame."""
        self._tracks = tracks
        self._names: dict[str, str] = {}
        """Name of a track, by the id that its object has now, if that is another one."""
        self._companions: dict[str, list[str]] = {}
        """Names of the tracks that are where another one is."""
        self._count = 0

    def name(self, number: Name) -> Name:
        """Return the name of the track of an id."""
        if number is None:
            return None
        key = str(number)
        if key not in self._names:
            if key not in self._names.values():
                return number
            self._count += 1  # the id is another object's now
            remember(self._names, key, f"{key}.{self._count}")
        return self._names[key]

    def rename(self, old: Name, new: Name) -> None:
        """Follow an object under another id."""
        name = self.name(old)
        self._names.pop(str(old), None)
        if name is not None and str(name) != str(new):
            remember(self._names, str(new), str(name))

    def merge(self, before: Sequence[Name], after: Name) -> None:
        """Follow objects that are one from now on."""
        names = {str(number): str(self.name(number)) for number in before if number is not None}
        names = {number: name for number, name in names.items() if self._tracks.follows(name)}
        if not names or after is None:
            return
        first = str(after) if str(after) in names else next(iter(names))
        for number, name in names.items():
            if number != first:
                self._join(name, names[first])
                self._names.pop(number, None)
        self.rename(first, after)

    def split(self, before: Name, after: Sequence[Name]) -> None:
        """Follow objects that were one until now; those that had no id before have not come in."""
        numbers = [str(number) for number in after if number is not None]
        if not numbers or before is None:
            return
        name = str(self.name(before))
        first = str(before) if str(before) in numbers else numbers[0]
        self.rename(before, first)
        for number in numbers:
            if number != first:
                companions = self._companions.get(name, [])
                self._names.pop(number, None)
                if companions:
                    remember(self._names, number, companions.pop(0))
                else:
                    self._tracks.expect(self.name(number))

    def places(self, boxes: Sequence[TrackedBox], parents: dict[str, str]) -> list[TrackedBox]:
        """Return boxes by the names of their tracks, with those of objects merged into them.

        parents: name of the track of which another one is a part now, by the name of that.
        """
        for name in [name for name in self._companions if not self._tracks.follows(name)]:
            del self._companions[name]  # its id may be another object's now
        for part, whole in parents.items():
            if self._tracks.follows(part):
                self._join(part, whole)
        listed = {str(box.name) for box in boxes}
        return list(boxes) + [
            TrackedBox(companion, box.box, "")
            for box in boxes
            for companion in self._companions.get(str(box.name), [])
            if companion not in listed and self._tracks.follows(companion)
        ]

    def along(self, name: Name) -> list[Name]:
        """Return the name of a track, and of those that are where it is."""
        return [name, *self._companions.get(str(name), [])]

    def end(self, number: Name) -> list[Name]:
        """Return the names of the tracks that end with an id, and forget it.

        An object that is part of another one now ends with it.
        """
        key = str(number)
        if key not in self._names and any(key in part for part in self._companions.values()):
            return []
        names = self.along(self.name(number))
        self._names.pop(key, None)
        self._companions.pop(str(names[0]), None)
        return names

    def _join(self, name: str, other: str) -> None:
        """Follow a track, and the objects merged into it, at another one's places."""
        if name == other:
            return
        companions = self._companions.get(other, [])
        for track in (name, *self._companions.pop(name, [])):
            if track not in companions and track != other:
                companions.append(track)
        remember(self._companions, other, companions)
