"""Tracker: follow the objects of one view from frame to frame.

A track is *tentative* until it has been followed for half a second and its head or foot has moved;
then it is *confirmed*. Only what goes straight from edge to edge may be faster. In each frame,
blobs are assigned one to one (Kalman prediction, Hungarian method, gate in heights of the person);
a second pass assigns the remaining ones by area and distance of the middles (`assignment`).

A confirmed track that is not detected for longer than the patience has *ended*: it has left if it
was at an edge of the view, and is *lost* in mid-view. What appears there later is another track,
which has no entry.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from functools import partial
from math import dist, inf

from camtopod.labels import count_label
from camtopod.records import Event
from camtopod.vision.boxes import OBJECTS_MAX, Box, box_height, contains_centre, gap
from camtopod.vision.detect import Blob
from camtopod.vision.settings import VisionSettings
from camtopod.vision.track.assignment import (
    GATE_HEIGHTS,
    Costs,
    best_pairs,
    costs_by_area,
    costs_by_points,
)
from camtopod.vision.track.crossings import PATIENCE_SECONDS, Crossings, FrameView
from camtopod.vision.track.decisions import Reason
from camtopod.vision.track.kalman import MEASUREMENT, SIGMAS, Kalman
from camtopod.vision.track.stature import Stature
from camtopod.vision.track.track import HISTORY_SIGHTINGS, Sighting, Track, Unmet

PAUSE_SECONDS_MAX = 4.0
"""Longest pause of the frames over which a track may go on."""
CONFIRM_SECONDS = 0.5
"""Minimum time something must be tracked, and move, before it counts as an object.

It is also the patience with what is tentative.
"""
CONFIRM_SIGHTINGS_SHARE = 0.6
"""Least share of the frames in which a track is seen for it to be confirmed."""
CONFIRM_HEIGHTS = 0.25
"""Distance (heights) that head or foot must move for a track to be confirmed."""
PIECE_HEIGHT_MIN = 0.4
"""Least height of a blob that no border cuts, as a share of a person's."""
TALL_SIGHTINGS_MIN = 3
"""Sightings of the least height (setting `min_height`) that make an object.

A single one may be two small animals in one blob.
"""
_SIZE_RATE = 0.2
"""Weight of the newest sighting in the running means of height and width."""


class Tracker:
    """All objects of one view, in images of one size."""

    def __init__(
        self, settings: VisionSettings, crossings: Crossings, numbers: Iterator[int]
    ) -> None:
        """Begin without tracks; ``numbers`` are those of the next ones."""
        self._height_min = settings.min_height * crossings.size[1]
        self.crossings = crossings
        """Tells where objects enter and leave the view."""
        self._numbers = numbers
        self._frame = FrameView(-inf, (0.0, 0.0, *crossings.size))
        self._start: float | None = None
        self.stature = Stature()
        self.active: list[Track] = []

    def step(self, frame: FrameView, blobs: list[Blob]) -> list[Event]:
        """Process the blobs of ``frame``, later than the last; return the events certain now."""
        t = frame.t
        dt = t - self._frame.t

        before, self._frame = self._frame, frame
        is_paused = dt > PATIENCE_SECONDS
        if self._start is None or is_paused:
            self._start = t

        # Predict.
        for track in self.active:
            track.kalman.predict(dt, track.size)
            track.frames += 1

        # Assign blobs: by head and foot, by area. They occlude others, or start tracks. A
        # track goes on over a pause if its object is where it can be by then.
        blobs = [blob for blob in blobs if not blob.is_line or self._touches(blob.box)]
        patience = dt if is_paused and dt <= PAUSE_SECONDS_MAX else PATIENCE_SECONDS
        free = self._assign(t, blobs, patience, partial(costs_by_points, stature=self.stature))

        # A pause in the frames ends the other tracks; objects at an edge leave during the pause.
        lost_tracks = [track for track in self.active if is_paused and track.last.t < t]
        events = self._end(lost_tracks, before, "interrupted", 0.0)
        free = self._assign(
            t, free, patience, partial(costs_by_area, frame, dt=dt, crossings=self.crossings)
        )
        for track in self.active:
            track.is_occluded = track.last.t < t and any(
                gap(blob.box, track.last.box) < GATE_HEIGHTS * track.height for blob in blobs
            )
        for blob in free:
            if blob.begins:
                self._start_track(t, blob)

        # Confirm and end tracks.
        new_tracks = self._confirm(t)
        exits = self._retire(t)
        return events + self.crossings.entries(frame, new_tracks, self.active) + exits

    # -- sightings ------------------------------

    def _assign(self, t: float, blobs: list[Blob], patience: float, costs: Costs) -> list[Blob]:
        """Assign one blob to each track at the least total cost; return the others.

        The tracks are those without a sighting at ``t``, seen within the patience. An object whose
        middle is expected beyond the border has left: a blob there is of another one that enters.
        """
        tracks = [
            track
            for track in self.active
            if 0.0 < t - track.last.t <= patience and contains_centre(self._frame.view, track.box)
        ]
        pairs = best_pairs(self._frame, tracks, blobs, costs, self.crossings)
        for track, blob in pairs:
            self._update(t, track, blob)
        return [
            blob for blob in blobs if all(blob is not matched_blob for _, matched_blob in pairs)
        ]

    def _update(self, t: float, track: Track, blob: Blob) -> None:
        """Update a track by the blob assigned to it."""
        cut = self._touches(blob.box)
        if cut or self._touches(track.last.box) or not track.confirmed:
            # Entering or leaving the view: its size may only grow.
            track.height = max(track.height, blob.height)
            track.width = max(track.width, blob.width)
        else:
            track.height += _SIZE_RATE * (blob.height - track.height)
            track.width += _SIZE_RATE * (blob.width - track.width)

        sighting = Sighting(t, blob.foot, blob.box)
        track.kalman.update(sighting.points, track.height)
        track.last = sighting
        track.history.append(sighting)
        track.sightings += 1
        track.reach = max(
            track.reach,
            dist(sighting.points[:2], track.first.points[:2]),
            dist(sighting.foot, track.first.foot),
        )
        count_label(track.labels, blob.label)

        # Measure the height of whole people, once per distance walked.
        has_walked = dist(blob.foot, track.measured_at) > SIGMAS * MEASUREMENT * track.height
        if track.confirmed and has_walked and blob.whole and not cut:
            track.measured_at = blob.foot
            self.stature.add(track.number, blob.bottom, blob.height)

    # -- initiation and end ------------------------------

    def _start_track(self, t: float, blob: Blob) -> None:
        """Start a tentative track, unless the blob is a fragment of an object."""
        if len(self.active) >= OBJECTS_MAX:
            return
        confirmed_tracks = [track for track in self.active if track.confirmed]
        if any(
            track.last.t == t and contains_centre(track.last.box, blob.box)
            for track in confirmed_tracks
        ):
            return  # a fragment of an object that is seen already

        sighting = Sighting(t, blob.foot, blob.box)
        track = Track(
            number=next(self._numbers),
            first=sighting,
            last=sighting,
            kalman=Kalman(sighting.points, blob.height),
            height=blob.height,
            width=blob.width,
            from_start=t == self._start,
            beside_others=any(
                gap(track.box, blob.box) < GATE_HEIGHTS * track.height for track in confirmed_tracks
            ),
            history=deque([sighting], HISTORY_SIGHTINGS),
            unmet_condition=("brief", 0.0, CONFIRM_SECONDS),
        )
        count_label(track.labels, blob.label)
        self.active.append(track)

    def _confirm(self, t: float) -> list[Track]:
        """Return the tracks that have become objects."""
        tentative = [track for track in self.active if not track.confirmed and track.last.t == t]
        for track in tentative:
            track.unmet_condition = self._unmet(track)
        return [track for track in tentative if track.confirmed]

    def _unmet(self, track: Track) -> Unmet | None:
        """Return what a track that is seen now lacks to be an object; None if nothing."""
        box = track.last.box
        tall = sum(box_height(sighting.box) >= self._height_min for sighting in track.history)
        person_height = self.stature.height(box[3]) or 0.0
        fragment_height = 0.0 if self._touches(box) else PIECE_HEIGHT_MIN * person_height
        conditions: tuple[Unmet, ...] = (
            ("brief", track.last.t - track.first.t, CONFIRM_SECONDS),
            ("patchy", track.sightings / track.frames, CONFIRM_SIGHTINGS_SHARE),
            ("still", track.reach / track.height, CONFIRM_HEIGHTS),
            ("fragment", box_height(box), fragment_height),
            ("low", tall, min(TALL_SIGHTINGS_MIN, len(track.history))),
        )
        return next((condition for condition in conditions if condition[1] < condition[2]), None)

    def _touches(self, box: Box) -> bool:
        """Return True if an edge of the latest frame cuts the box."""
        return self.crossings.touches(self._frame, box)

    def _retire(self, t: float) -> list[Event]:
        """End tracks that were not detected for longer than the patience; return their exits."""
        ended_tracks = [
            track
            for track in self.active
            if t - track.last.t > (PATIENCE_SECONDS if track.confirmed else CONFIRM_SECONDS)
        ]
        self.active = [track for track in self.active if track not in ended_tracks]
        return [
            event for track in ended_tracks for event in self.crossings.exit_of(self._frame, track)
        ]

    def drop(self, track: Track) -> None:
        """Remove ``track`` without an event, because it is a ghost."""
        self.crossings.note("ghost", track, track.last)
        self.active = [other_track for other_track in self.active if other_track is not track]

    def finish(self, reason: Reason) -> list[Event]:
        """Forget all tracks, at the end of a recording or of a scene; return the last events.

        These are the exits of objects out of sight at an edge. Objects seen next count as having
        been there from the start.

        reason: recorded of the tracks that have no event.
        """
        self._start = None
        return self._end(self.active, self._frame, reason)

    def _end(
        self,
        tracks: Sequence[Track],
        frame: FrameView,
        reason: Reason,
        seconds_min: float = CONFIRM_SECONDS,
    ) -> list[Event]:
        """End tracks as of ``frame``; return the exits of objects out of sight at an edge.

        reason: recorded of the tracks that have no event.
        seconds_min: time for which an object has to be out of sight.
        """
        events = []
        for track in tracks:
            is_recent = frame.t - track.last.t < seconds_min
            if track.confirmed and (is_recent or not self.crossings.at_edge(frame, track)):
                self.crossings.note(reason, track, track.last)
            else:
                events += self.crossings.exit_of(frame, track)
        self.active = [track for track in self.active if track not in tracks]
        return events
