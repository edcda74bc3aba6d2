"""Entry and exit events from tracks: which object crossed the edge of the view, when and where.

An edge is the border of the image, an ignored area that reaches to it (`ignored_areas`), or a
door in mid-view, named or learned (`doors`). An entry has the time of the first sighting, although
it is reported only when the object is confirmed; an exit has the time of the last sighting.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import hypot, inf
from typing import NamedTuple

from camtopod.labels import most_frequent
from camtopod.records import Event, Kind
from camtopod.vision.boxes import TOUCH_PIXELS, Box, border_distances, box_height, touches_border
from camtopod.vision.settings import Polygon
from camtopod.vision.track.decisions import Decision, Edge, Reason
from camtopod.vision.track.doors import Doors
from camtopod.vision.track.ignored_areas import IgnoredAreas
from camtopod.vision.track.kalman import MEASUREMENT, SIGMAS
from camtopod.vision.track.track import Sighting, Track

BORDER_SHARE = 0.025
"""Distance from the border within which a box is at it (share of the image's diagonal)."""
REACH_SECONDS = 0.6
"""Time for which the velocity of an object out of sight is relied on.

A box that reaches the border within it is at the border; an event is dated back or forward by as
much at most.
"""
REACH_SIZES = 0.5
"""Distance (sizes) that an object's outline may jump between two frames at least."""
PATIENCE_SECONDS = 1.5
"""Time an object may go undetected before its track ends.

A sighting is moved to the crossing of the border if it takes no longer.
"""
CROSSING_SIGHTINGS_MIN = 3
"""Least number of sightings, of which two tell the speed, of an object that crosses very fast."""
CUT_SHARE_MAX = 0.75
"""Largest share of its height that is left of an object that the top border cuts as it crosses."""
WALKED_HEIGHTS_MIN = 1.5
"""Least distance from its origin (heights) that a track must have moved to be evidence of a door.

What moves in place, such as fragments of a person who stands, or the leaf of a door, begins and
ends in mid-view, too. So this is also what an object that uses a learned door has moved.
"""


class FrameView(NamedTuple):
    """An analysed image, as far as it decides where objects may enter and leave."""

    t: float
    """Capture time, seconds."""
    view: Box
    """Part of the scene that it shows, pixels; its sides are the border."""
    is_trusted: bool = False
    """Its objects are those of a trusted detector, which may enter and leave in mid-view."""


class Crossings:
    """Entries and exits of one view."""

    def __init__(
        self,
        camera: str,
        width: int,
        height: int,
        doors: Sequence[Polygon],
        ignored_areas: IgnoredAreas,
        take: Callable[[Decision], None],
    ) -> None:
        """Prepare for a working image of ``width`` x ``height`` pixels.

        doors: named doors, in fractions of the image.
        take: called with each decision about the beginning or end of a track.
        """
        self._camera = camera
        self._take = take
        self.size = (width, height)
        self._margin = BORDER_SHARE * (width**2 + height**2) ** 0.5
        self._ignored_areas = ignored_areas
        self.doors = Doors(width, height, doors)
        self._start_t = -inf

    def begin(self, start_t: float, ignored_areas: IgnoredAreas) -> None:
        """Begin with a new scene; there are no events before ``start_t``, seconds."""
        self._start_t = start_t
        self._ignored_areas = ignored_areas

    def note(
        self,
        reason: Reason,
        track: Track,
        at: Sighting,
        edge: Edge | None = None,
        value: float = 0.0,
        least: float = 0.0,
    ) -> None:
        """Record what the beginning or end of ``track`` at a sighting was taken for."""
        self._take(
            Decision(
                reason,
                track.number,
                at.t,
                self._place(at),
                track.first.t,
                edge,
                value,
                least,
                track.sightings,
            )
        )

    def _place(self, at: Sighting) -> tuple[float, float]:
        """Return the foot point of a sighting as fractions of the image."""
        x, y = (foot / side for foot, side in zip(at.foot, self.size, strict=True))
        return min(max(x, 0.0), 1.0), min(max(y, 0.0), 1.0)

    # -- where ------------------------------

    def touches(self, frame: FrameView, box: Box) -> bool:
        """Return True if the border of the view or an ignored area cuts the box."""
        return touches_border(box, frame.view) or self._ignored_areas.cut(box)

    def at_edge(self, frame: FrameView, track: Track) -> Edge | None:
        """Return the edge at which the track was last seen, if objects leave there."""
        return self._edge(frame, track, track.last, 1.0)

    def _edge(self, frame: FrameView, track: Track, at: Sighting, sense: float) -> Edge | None:
        """Return the edge near a sighting, on the way of the track.

        sense: 1.0 for the way that it goes on, -1.0 for the way that it came.
        """
        dx, dy = (sense * REACH_SECONDS * speed for speed in track.velocity)
        left, top, right, bottom = border_distances(at.box, frame.view)
        height = box_height(at.box)

        # Distance to each border, and the way towards it. At the top the foot decides, because
        # heads are cut off far inside the view, unless much of a body that goes there is cut, too.
        is_cut = top <= TOUCH_PIXELS and height < CUT_SHARE_MAX * track.height and dy < 0
        borders: tuple[tuple[float, float, Edge], ...] = (
            (left, -dx, "left border"),
            (right, dx, "right border"),
            (0.0 if is_cut else top + height, -dy, "top border"),
            (bottom, dy, "bottom border"),
        )
        near_borders = [
            (distance, border)
            for distance, way, border in borders
            if distance <= max(self._margin, way)
        ]
        if near_borders:
            return min(near_borders)[1]

        # Another edge is an ignored area on its way, or a door.
        if self._ignored_areas.lead_out(
            at.foot, (dx, dy), self._margin + hypot(dx, dy), self._margin
        ):
            return "ignored area"
        return self.doors.door_at(*at.foot, track.height)

    def comes_in(self, frame: FrameView, track: Track, box: Box) -> bool:
        """Return True if ``box`` is not the object of ``track``, but another one that comes in.

        Either a border cuts it that the object, whole so far, does not reach yet, or it moves away
        from a border where the object is and leaves soon at its speed, by more than two sigma of
        the measurement.
        """
        dx, dy = track.velocity
        speeds = (-dx, -dy, dx, dy)
        extent = frame.view[2] - frame.view[0], frame.view[3] - frame.view[1]
        before = border_distances(track.last.box, frame.view)
        after = border_distances(box, frame.view)
        whole = min(before) > TOUCH_PIXELS
        return any(
            (
                before[side] <= self._margin
                and extent[side % 2] - before[side - 2] < PATIENCE_SECONDS * speeds[side]
                and before[side - 2] - after[side - 2] > SIGMAS * MEASUREMENT * track.size
            )
            or (
                whole
                and after[side] <= TOUCH_PIXELS
                and before[side]
                > max(self._margin, REACH_SECONDS * speeds[side], REACH_SIZES * track.size)
            )
            for side in range(4)
        )

    # -- what ------------------------------

    def entries(
        self, frame: FrameView, new_tracks: Sequence[Track], active: Sequence[Track]
    ) -> list[Event]:
        """Return the entries of tracks that became objects, and learn where people walk.

        active: all tracks.
        """
        events = [event for track in new_tracks for event in self._entry(frame, track)]

        # A track that began in mid-view entered by a learned door, or is evidence of one, once it
        # has moved far enough. Cells that people walk through are evidence against doors.
        for track in active:
            if track.began_in_view and _has_walked(track):
                track.began_in_view = False
                edge = self.doors.door_at(*track.first.foot, track.height)
                if edge is None:
                    self.doors.record_unexplained(track.first.foot)
                else:
                    events.append(self._event(frame, "entry", track, track.first, edge))
            if track.confirmed:
                track.cells.add(self.doors.cell(*track.last.foot))
        return events

    def _entry(self, frame: FrameView, track: Track) -> list[Event]:
        """Return the entry of a track that became an object, if it is one."""
        edge = self._edge(frame, track, track.first, -1.0)
        if edge is None and frame.is_trusted and not track.beside_others:
            edge = "mid-view"
        crossed_t = self._at_border(frame, track, track.first, edge, -1.0).t
        if crossed_t < self._start_t or (track.from_start and crossed_t == track.first.t):
            self.note("from start", track, track.first)
            return []
        if edge is not None and edge != "learned door":
            return [self._event(frame, "entry", track, track.first, edge)]
        track.began_in_view = edge is not None or not track.beside_others
        self.note("in mid-view" if track.began_in_view else "beside others", track, track.first)
        return []

    def _has_crossed(self, frame: FrameView, track: Track, edge: Edge | None) -> bool:
        """Return True if a brief track that ends at ``edge`` has come straight from another one.

        One that began beside another object is more likely a fragment of it.
        """
        return (
            edge is not None
            and not track.beside_others
            and track.unmet_condition is not None
            and track.unmet_condition[0] == "brief"
            and track.sightings >= CROSSING_SIGHTINGS_MIN
            and _has_walked(track)
            and self._edge(frame, track, track.first, -1.0) not in (None, edge)
        )

    def exit_of(self, frame: FrameView, track: Track) -> list[Event]:
        """Return the exit of an object whose track ends, if it has left.

        An object that crossed the view too fast for a confirmation has its entry as well.
        """
        edge = self.at_edge(frame, track)
        if self._has_crossed(frame, track, edge):
            entries = self._entry(frame, track)
            return [*entries, self._event(frame, "exit", track, track.last, edge)]
        if track.unmet_condition is not None:
            self.note(track.unmet_condition[0], track, track.last, None, *track.unmet_condition[1:])
            return []

        # It has walked through the cells except where it began and ended.
        ends = {self.doors.cell(*track.first.foot), self.doors.cell(*track.last.foot)}
        self.doors.record_walk(track.cells - ends)

        if edge == "learned door" and not _has_walked(track):
            edge = None
        if edge is None and frame.is_trusted and not track.is_occluded:
            edge = "mid-view"
        if edge is not None:
            return [self._event(frame, "exit", track, track.last, edge)]

        # A track that is lost in mid-view may be evidence of a door.
        self.note("occluded" if track.is_occluded else "lost", track, track.last)
        if _has_walked(track) and not track.is_occluded:
            self.doors.record_unexplained(track.last.foot)
        return []

    def _event(
        self, frame: FrameView, kind: Kind, track: Track, at: Sighting, edge: Edge | None
    ) -> Event:
        """Return the event at a sighting, and record it."""
        entry = kind == "entry"
        at = self._at_border(frame, track, at, edge, -1.0 if entry else 1.0)
        self.note("entered" if entry else "left", track, at, edge)
        x, y = (round(share, 4) for share in self._place(at))
        return Event(
            self._camera,
            kind,
            round(at.t, 6),
            x,
            y,
            str(track.number),
            label=most_frequent(track.labels),
        )

    def _at_border(
        self, frame: FrameView, track: Track, at: Sighting, edge: Edge | None, sense: float
    ) -> Sighting:
        """Return a sighting moved along the way of the track to where it crosses the border.

        Objects are first seen some images after they have entered, above all beside others, and
        last seen before they have left.
        sense: 1.0 for the way that it goes on, -1.0 for the way that it came.
        """
        x, y = at.foot
        dx, dy = track.velocity
        left, top, right, bottom = frame.view
        distance, speed = {
            "left border": (at.box[2] - left - track.width / 2, -dx),
            "right border": (right - at.box[0] - track.width / 2, dx),
            "top border": (y - top, -dy),
            "bottom border": (bottom - at.box[1] - track.height / 2, dy),
        }.get(edge or "", (0.0, 0.0))
        seconds = distance / (max(sense * speed, 0.0) or inf)
        if not 0.0 < seconds <= PATIENCE_SECONDS:
            return at
        ahead = sense * seconds
        return at._replace(
            t=at.t + sense * min(seconds, REACH_SECONDS), foot=(x + ahead * dx, y + ahead * dy)
        )


def _has_walked(track: Track) -> bool:
    """Return True if the track has moved far enough to be evidence of a door."""
    return track.reach >= WALKED_HEIGHTS_MIN * track.height
