"""Arrivals, for Home Assistant: who is about to come where, and which entries are one walk.

An exit counts at each camera of its prediction until nine of ten such objects have arrived, less
what its object has been seen again since, by the matches of later entries.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection

from msgspec import Struct, field
from msgspec.structs import replace

from camtopod.records import Match, Prediction
from camtopod.statuses import without_cameras
from camtopod.words import LIKELY, sum_by_camera

MEMORY_SECONDS = 3600.0
"""Age at which exits and entries are forgotten."""
EXITS_MAX = 1000
"""Largest number of exits that are remembered."""
ENTRIES_MAX = 10_000
"""Largest number of entries that are remembered."""
LOOK_SECONDS = 10.0
"""Time for which to look at a camera from when the object is there, seconds."""


class Awaited(Struct, frozen=True):
    """An arrival at a camera.

    camera: where the object left; None without an expected arrival.
    from_, until (Unix seconds): when it is likely to arrive, or to be worth a look; None if that is
        not known.
    """

    probability: float
    camera: str | None = None
    from_: float | None = None
    until: float | None = None


NO_ARRIVAL = Awaited(0.0)
"""No arrival is expected."""


class Passing(Struct, frozen=True):
    """The match of an entry, and its walk.

    passages: the entries of its walk in the last hour, oldest first, this one included.
    again: True if this is its second match.
    was: the walk that it began by its first match, and that has no entry now; else None.
    """

    match: Match
    passages: list[Match]
    again: bool = False
    was: str | None = None


_Key = tuple[str, float, str | None]
"""Camera, time and track of an exit or an entry."""


class _Exit(Struct):
    prediction: Prediction
    seen: dict[_Key, float] = field(default_factory=dict)
    """Probability that its object is that of an entry."""


class ExpectedArrivals:
    """Exits and entries of the last hour, by camera, time and track; in memory only."""

    def __init__(self) -> None:
        self._exits: dict[_Key, _Exit] = {}
        self._entries: dict[_Key, Match] = {}

    def left(self, prediction: Prediction) -> None:
        """Observe an exit."""
        self._exits[prediction.camera, prediction.t, prediction.track] = _Exit(prediction)

    def entered(self, match: Match) -> Passing:
        """Observe the first or the second match of an entry."""
        entry = (match.camera, match.t, match.track)
        before = self._entries.pop(entry, None)
        self._entries[entry] = match
        self._rename(match.walk)

        # The exits that it may continue.
        for departure in self._exits.values():
            departure.seen.pop(entry, None)
        for passage in match.from_:
            source = self._exits.get((passage.camera, passage.t, passage.track))
            if source is not None:
                source.seen[entry] = passage.probability

        # Its walk.
        passages = [passage for passage in self._entries.values() if passage.walk == match.walk]
        passages.sort(key=lambda passage: passage.t)
        if before is None:
            return Passing(match, passages)
        is_empty = all(passage.walk != before.walk for passage in self._entries.values())
        return Passing(match, passages, True, before.walk if is_empty else None)

    def _rename(self, walk: str) -> None:
        """Give a walk its present name: it is named by its oldest passage of the last hour."""
        place = walk.partition("/")[0]  # without the number of those that begin together
        camera, _, t = place.rpartition("@")
        names = {
            entry.walk
            for entry in self._entries.values()
            if entry.walk.partition("/")[0] != place
            and entry.camera == camera
            and entry.t == float(t)
        }
        for key, entry in self._entries.items():
            if entry.walk in names and entry.t >= float(t):
                self._entries[key] = replace(entry, walk=walk)

    def forget(self, now: float) -> None:
        """Forget exits and entries older than an hour, and the oldest beyond the limits."""
        self._exits = {
            key: departure
            for key, departure in list(self._exits.items())[-EXITS_MAX:]
            if abs(now - key[1]) < MEMORY_SECONDS
        }
        self._entries = {
            key: match
            for key, match in list(self._entries.items())[-ENTRIES_MAX:]
            if abs(now - key[1]) < MEMORY_SECONDS
        }

    def forget_cameras(self, cameras: Collection[str]) -> None:
        """Forget exits and entries at cameras, walks through them, and that somebody goes there."""
        if not cameras:
            return
        matches = without_cameras(self._entries.values(), cameras)
        self._entries = {(match.camera, match.t, match.track): match for match in matches}
        self._exits = {key: self._exits[key] for key in self._exits if key[0] not in cameras}
        for departure in self._exits.values():
            prediction = departure.prediction
            departure.prediction = replace(
                prediction,
                next=[row for row in prediction.next if row.camera not in cameras],
                look=[row for row in prediction.look or () if row.camera not in cameras],
            )
            for entry in [entry for entry in departure.seen if entry[0] in cameras]:
                del departure.seen[entry]

    def expected(self, now: float) -> dict[str, Awaited]:
        """Return, by camera, how probable it is that somebody is still to come there.

        Times and ``camera`` are those of the likeliest arrival.
        """
        likeliest: dict[str, Awaited] = {}
        none_comes: dict[str, float] = defaultdict(lambda: 1.0)
        for departure in self._exits.values():
            prediction = departure.prediction
            remainder = max(0.0, 1.0 - sum(departure.seen.values()))
            shares: dict[str, float] = defaultdict(float)
            for row in prediction.next:
                from_, until = prediction.t + row.q10, prediction.t + row.q90
                if not now <= until:
                    continue
                window = (None, None) if row.prior else (from_, until)
                arrival = Awaited(row.probability * remainder, prediction.camera, *window)
                shares[row.camera] += arrival.probability
                best = likeliest.get(row.camera, arrival)
                likeliest[row.camera] = max(
                    best, arrival, key=lambda candidate: candidate.probability
                )
            for camera, share in shares.items():
                none_comes[camera] *= max(0.0, 1.0 - share)
        return {
            camera: replace(best, probability=1.0 - none_comes[camera])
            for camera, best in likeliest.items()
        }

    def looks(self, now: float) -> dict[str, Awaited]:
        """Return, by camera, the newest exit whose object is probably seen there now or next.

        Once it has been seen again, that is where.
        """
        looks: dict[str, Awaited] = {}
        for (camera, t, _), departure in self._exits.items():
            look, sees = look_at(departure.prediction)
            rows = [row for row in departure.prediction.next if row.camera == look]
            from_ = t
            until = t + max([LOOK_SECONDS, *(row.q90 for row in rows[:1])])
            for (place, begin, _), probability in departure.seen.items():
                if probability > LIKELY and place != camera:
                    look, sees, from_, until = place, probability, begin, begin + LOOK_SECONDS
            if sees > LIKELY and now <= until:
                looks[look] = Awaited(sees, camera, from_, until)
        return looks


def look_at(prediction: Prediction) -> tuple[str, float]:
    """Return the other camera that most probably sees the object now or, if none does, next.

    With its probability; "none" and 0 if there is no such camera.
    """
    looks = prediction.look or prediction.next  # without overlapping views
    shares = sum_by_camera(row for row in looks if row.camera != prediction.camera)
    return max(shares.items(), key=lambda item: item[1], default=("none", 0.0))
