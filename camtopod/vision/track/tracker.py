"""Tracker: follow the objects of one view from frame to frame.

A track is *tentative* until it has been followed for half a second and its head or foot has moved;
then it is *confirmed*. In each frame, blobs that cover several confirmed tracks update these as a
group (people crossing or walking side by side). The other blobs are assigned one to one (Kalman
prediction, Hungarian method, gate in heights of the person), and what is left in a second pass by
area and distance of the middles.

A confirmed track that is not detected for longer than the patience has *ended* if it was at an edge
of the view. In mid-view it is *lost*: it is kept for some seconds, and a track confirmed nearby
or where it would be by now continues it. A passage that is lost behind a lamp post or a tree thus
stays one passage.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import dist, hypot

import numpy as np
from scipy.optimize import linear_sum_assignment

from camtopod.records import Event
from camtopod.vision.boxes import area, box_height, centre, contains_centre, gap, in_image, overlap
from camtopod.vision.detect import Blob
from camtopod.vision.settings import VisionSettings
from camtopod.vision.track.crossings import GONE_PATIENCE_SECONDS, LATENESS_SECONDS_MAX, Crossings
from camtopod.vision.track.decisions import Reason
from camtopod.vision.track.kalman import MEASUREMENT, Kalman
from camtopod.vision.track.stature import Stature
from camtopod.vision.track.track import Sighting, Track, Unmet

CONFIRM_SECONDS = 0.5
"""Minimum time something must be tracked, and move, before it counts as an object.

It is also the patience with what is tentative.
"""
PATIENCE_SECONDS = 1.5
"""Time an object may go undetected before its track ends."""
STITCH_SECONDS = 10.0
"""Time within which a track lost in mid-view may be found again and continue its passage."""
TRACKS_MAX = 200
"""Maximum number of tracks at a time; further objects are not tracked."""
GATE_HEIGHTS = 0.35
"""Gate: largest distance (heights, plus two sigma) of head or foot from the expected position."""
CONFIRM_SIGHTINGS_SHARE = 0.6
"""Least share of the frames in which a track is seen for it to be confirmed."""
CONFIRM_HEIGHTS = 0.25
"""Distance (heights) that head or foot must move for a track to be confirmed."""
STITCH_HEIGHTS = 1.5
"""Distance (heights) within which a lost track may continue: where it was last seen, or where it
would be by now at its last velocity."""
PIECE_HEIGHT_MIN = 0.4
"""Least height of a blob that no border cuts, as a share of a person's."""
TALL_SIGHTINGS_MIN = 3
"""Sightings of the least height (setting `min_height`) that make an object.

A single one may be two small animals in one blob.
"""
GROUP_FACTOR = 1.3
"""Least width or height of a group, as a factor of its widest or tallest member's."""
LIKE_FACTOR = 2.0
"""Largest factor between the areas, or heights, of one object that no border cuts."""
_SIZE_RATE = 0.2
"""Weight of the newest sighting in the running means of height and width."""
NEARER_SHARE = 0.7
"""Weight in the cost of an assignment of the one of head and foot that is nearer."""
_NEVER = 1e9
"""Cost of an assignment that is not allowed."""


Costs = Callable[[Track, list[Blob]], list[float]]
"""Cost of each blob for a track; `_NEVER` where it is not allowed."""


class Tracker:
    """All objects of one view, in images of one size."""

    def __init__(
        self, settings: VisionSettings, crossings: Crossings, numbers: Iterator[int]
    ) -> None:
        """Begin without tracks; ``numbers`` are those of the next ones."""
        self._note = crossings.note
        self._height_min = settings.min_height * crossings.size[1]
        self.crossings = crossings
        """Tells where objects enter and leave the view."""
        self._numbers = numbers
        self._t: float | None = None
        self._start: float | None = None
        self.stature = Stature()
        self.active: list[Track] = []
        self.lost: list[Track] = []

    def step(self, t: float, blobs: list[Blob]) -> list[Event]:
        """Process the blobs of the frame captured at ``t`` seconds, later than the last.

        Returns the events that are certain now.
        """
        before = t if self._t is None else self._t
        self._t = t
        self._dt = t - before
        self.crossings.now = max(self.crossings.now, t)

        # A pause in the frames ends all tracks.
        events = []
        if self._dt > PATIENCE_SECONDS:
            events = self.finish("interrupted")
        if self._start is None:
            self._start = t

        # Predict.
        for track in self.active:
            track.kalman.predict(self._dt, track.size, coasting=track.last.t < before)
            track.frames += 1

        # Assign blobs, to groups first. They occlude others, or start tracks.
        free = self._update_groups(t, blobs)
        free = self._assign(t, free, self._costs)
        free = self._assign(t, free, self._costs_by_area)
        for track in self.active:
            hidden = track.confirmed and track.last.t < t
            near = GATE_HEIGHTS * track.height
            track.occluded = hidden and (
                track.occluded or any(gap(blob.box, track.last.box) < near for blob in blobs)
            )
        for blob in free:
            if blob.begins:
                self._start_track(t, blob)

        # Confirm, split and end tracks.
        appeared = self._confirm(t)
        left, vanished = self._retire(t)
        return events + self.crossings.report(appeared, left, vanished, self.active)

    # -- sightings ------------------------------

    def _update_groups(self, t: float, blobs: list[Blob]) -> list[Blob]:
        """Update tracks by blobs that cover several confirmed people; return the other blobs."""
        free = []
        waiting = [
            (track, *centre(track.box))
            for track in self.active
            if track.confirmed and track.last.t < t
        ]

        for blob in blobs:
            left, top, right, bottom = blob.box
            inside = [
                track
                for track, x, y in waiting
                if track.last.t < t
                and left <= x <= right
                and top <= y <= bottom
                and not self.crossings.turns_back(track, blob.box)
            ]
            wide = len(inside) > 1 and blob.width > GROUP_FACTOR * max(
                track.width for track in inside
            )
            tall = len(inside) > 1 and blob.height > GROUP_FACTOR * max(
                track.height for track in inside
            )
            if wide or tall:
                self._update_group(t, blob, inside)
            else:
                free.append(blob)
        return free

    def _update_group(self, t: float, blob: Blob, inside: list[Track]) -> None:
        """Update the tracks inside a group's blob.

        The outermost people touch its outline; the others are taken to be where they were expected.
        """
        leftmost = min(inside, key=lambda track: track.box[0])
        rightmost = max(inside, key=lambda track: track.box[2])
        lowest = max(inside, key=lambda track: track.box[3])
        highest = min(inside, key=lambda track: track.box[1])

        for track in inside:
            left, _, right, bottom = track.box
            x = min(max((left + right) / 2, blob.left), blob.right)
            if track is leftmost:
                x = blob.left + track.width / 2
            elif track is rightmost:
                x = blob.right - track.width / 2
            bottom = min(max(bottom, blob.top), blob.bottom)
            if track is lowest:
                bottom = blob.bottom
            elif track is highest:
                bottom = min(blob.top + track.height, blob.bottom)
            box = (x - track.width / 2, bottom - track.height, x + track.width / 2, bottom)
            track.kalman.update((x, bottom - track.height, x, bottom), track.height)
            self._seen(track, Sighting(t, (x, bottom), box))

    def _assign(self, t: float, blobs: list[Blob], costs: Costs) -> list[Blob]:
        """Assign one blob to each track at the least total cost (Kuhn 1955); return the others.

        An object whose middle is expected beyond the border has left: what is seen there comes in.
        """
        waiting = [
            track
            for track in self.active
            if track.last.t < t and in_image(track.box, self.crossings.size)
        ]
        if not waiting or not blobs:
            return blobs
        cost = np.array([costs(track, blobs) for track in waiting])
        for i, j in np.argwhere(cost < _NEVER):
            if self.crossings.turns_back(waiting[i], blobs[j].box):
                cost[i, j] = _NEVER
        taken = set()
        for i, j in zip(*linear_sum_assignment(cost), strict=True):
            if cost[i, j] < _NEVER:
                taken.add(int(j))
                self._update_single(t, waiting[i], blobs[j])
        return [blob for j, blob in enumerate(blobs) if j not in taken]

    def _costs(self, track: Track, blobs: list[Blob]) -> list[float]:
        """Return for each blob the distance of head and foot in gates.

        Tentative tracks have a higher cost, so that they yield to confirmed ones.
        """
        head_x, head_y, foot_x, foot_y = track.kalman.position
        scale = max(track.size, self.stature.height(foot_y) or 0.0)
        gate = GATE_HEIGHTS * scale + 2 * track.kalman.uncertainty
        height_min = PIECE_HEIGHT_MIN * track.height if track.confirmed else 0.0
        leftmost = min(head_x, foot_x, track.last.box[0]) - gate
        rightmost = max(head_x, foot_x, track.last.box[2]) + gate

        costs = [_NEVER] * len(blobs)
        for j, blob in enumerate(blobs):
            # Most blobs are neither near nor overlapping.
            if blob.right < leftmost or rightmost < blob.left:
                continue
            head = hypot((blob.left + blob.right) / 2 - head_x, blob.top - head_y)
            foot = hypot(blob.foot_x - foot_x, blob.bottom - foot_y)
            near = min(head, foot)
            far = max(head, foot)
            if near > gate and overlap(track.last.box, blob.box) < 0.3:
                continue
            if blob.bottom - blob.top >= height_min or self.crossings.touches(blob.box):
                distance = NEARER_SHARE * near + (1 - NEARER_SHARE) * far
                costs[j] = distance / gate + (not track.confirmed) / 2
        return costs

    def _costs_by_area(self, track: Track, blobs: list[Blob]) -> list[float]:
        """Return for each blob of like area the distance of its middle, as a share of the reach.

        For what the first pass leaves: objects that move by more than a gate from frame to frame,
        or whose head and foot jump because the border cuts them or fragments come and go.
        """
        assert self._t is not None
        costs = [_NEVER] * len(blobs)
        box = track.last.box
        if self._t - track.last.t > GONE_PATIENCE_SECONDS:
            return costs

        # One step at its speed, or what its outline may jump.
        head_x, head_y, foot_x, foot_y = track.kalman.velocity
        step = self._dt * hypot(head_x + foot_x, head_y + foot_y) / 2
        cut = self.crossings.touches(box)
        reach = max(step, box[2] - box[0], box_height(box) / (1 if cut else 2))
        middles = [centre(box), centre(track.box)]
        for j, blob in enumerate(blobs):
            x, y = centre(blob.box)
            distance = min(hypot(x - a, y - b) for a, b in middles)
            ratio = area(blob.box) / area(box)
            alike = 1 / LIKE_FACTOR <= ratio <= LIKE_FACTOR
            if distance <= reach and (alike or cut or self.crossings.touches(blob.box)):
                costs[j] = distance / reach
        return costs

    def _update_single(self, t: float, track: Track, blob: Blob) -> None:
        """Update a track by the blob assigned to it."""
        measured = (*blob.head, *blob.foot)
        cut = self.crossings.touches(blob.box)
        if cut or self.crossings.touches(track.last.box) or not track.confirmed:
            # Entering or leaving the view: its size may only grow.
            track.height = max(track.height, blob.height)
            track.width = max(track.width, blob.width)
        else:
            track.height += _SIZE_RATE * (blob.height - track.height)
            track.width += _SIZE_RATE * (blob.width - track.width)

        track.kalman.update(measured, track.height)
        self._seen(track, Sighting(t, blob.foot, blob.box))

        # Measure the height of whole people, once per distance walked.
        step = hypot(blob.foot_x - track.measured_at[0], blob.bottom - track.measured_at[1])
        walked = step > 2 * MEASUREMENT * track.height
        if track.confirmed and walked and blob.whole and not cut:
            track.measured_at = blob.foot
            self.stature.add(track.number, blob.bottom, blob.height)

    def _seen(self, track: Track, sighting: Sighting) -> None:
        """Record a sighting."""
        track.last = sighting
        track.history.append(sighting)
        track.sightings += 1
        left, top, right, bottom = sighting.box
        head_x, head_y, foot_x, foot_y = track.origin
        head = hypot((left + right) / 2 - head_x, top - head_y)
        foot = hypot(sighting.foot[0] - foot_x, bottom - foot_y)
        track.reach = max(track.reach, head, foot)

    # -- initiation and end ------------------------------

    def _start_track(self, t: float, blob: Blob) -> None:
        """Start a tentative track, unless the blob is too small or a fragment of an object."""
        if len(self.active) >= TRACKS_MAX:
            return
        expected = self.stature.height(blob.bottom)
        cut = self.crossings.touches(blob.box)
        if expected is not None and not cut and blob.height < PIECE_HEIGHT_MIN * expected:
            return
        others = [track for track in self.active if track.confirmed]
        if any(track.last.t == t and contains_centre(track.last.box, blob.box) for track in others):
            return  # a fragment of an object that is seen already

        sighting = Sighting(t, blob.foot, blob.box)
        measured = (*blob.head, *blob.foot)
        beside = any(gap(track.box, blob.box) < GATE_HEIGHTS * track.height for track in others)
        height = max(blob.height, PIECE_HEIGHT_MIN * (expected or 0.0))
        track = Track(
            number=next(self._numbers),
            first=sighting,
            last=sighting,
            kalman=Kalman(measured, height),
            height=height,
            width=blob.width,
            from_start=t == self._start,
            beside_others=beside,
            origin=measured,
        )
        track.history.append(sighting)
        self.active.append(track)

    def _confirm(self, t: float) -> list[Track]:
        """Confirm tracks that have become objects; return those that continue no lost track."""
        appeared = []
        for track in self.active:
            if track.confirmed or track.last.t < t:
                continue
            track.unmet = self._unmet(t, track)
            track.confirmed = track.unmet is None
            if track.confirmed and not self._stitch(track):
                appeared.append(track)
        return appeared

    def _unmet(self, t: float, track: Track) -> Unmet | None:
        """Return what a track that is seen at ``t`` lacks to be an object; None if nothing."""
        seconds = t - track.first.t
        if seconds < CONFIRM_SECONDS:
            return "brief", seconds, CONFIRM_SECONDS
        if track.sightings < CONFIRM_SIGHTINGS_SHARE * track.frames:
            return "patchy", track.sightings / track.frames, CONFIRM_SIGHTINGS_SHARE
        if track.reach < CONFIRM_HEIGHTS * track.height:
            return "still", track.reach / track.height, CONFIRM_HEIGHTS

        # Tall enough in several sightings.
        if self._height_min > 0.0:
            heights = [box_height(sighting.box) for sighting in track.history]
            tall = sum(height >= self._height_min for height in heights)
            needed = min(TALL_SIGHTINGS_MIN, len(heights))
            if tall < needed:
                return "low", tall, needed
        return None

    def _stitch(self, track: Track) -> bool:
        """Continue the nearest track that was lost in mid-view; False if none is within reach."""
        if self.crossings.begins_at_edge(track):
            return False
        missing = [
            other
            for other in self.active
            if other.confirmed
            and other.last.t < track.first.t
            and not self.crossings.at_edge(other)
        ]

        # Nearest by distance over reach.
        best = None
        best_score = 1.0
        height = box_height(track.first.box)
        for other in [*self.lost, *missing]:
            seconds = max(0.0, track.first.t - other.last.t)
            x, y = other.last.foot
            walked = (x + seconds * other.velocity[0], y + seconds * other.velocity[1])
            distance = min(dist(track.first.foot, (x, y)), dist(track.first.foot, walked))
            low, high = sorted((height, box_height(other.last.box)))
            score = distance / (STITCH_HEIGHTS * high)
            if score < best_score and high < LIKE_FACTOR * low:
                best = other
                best_score = score

        if best is not None:
            self._absorb(track, best)
        return best is not None

    def _absorb(self, track: Track, earlier: Track) -> None:
        """Make ``track`` continue the passage ``earlier``, with its number and beginning."""
        seconds = max(0.0, track.first.t - earlier.last.t)
        self._note("continues", track, track.first, value=seconds, other=earlier.number)
        track.number = earlier.number
        track.first = earlier.first
        track.from_start = earlier.from_start
        track.beside_others = earlier.beside_others
        self.lost = [other for other in self.lost if other is not earlier]
        self.active = [other for other in self.active if other is not earlier]

    def _retire(self, t: float) -> tuple[list[Track], list[Track]]:
        """End tracks that were not detected for longer than the patience.

        Returns those that were at an edge, and those that are lost for good.
        """
        kept = []
        left = []

        # Patience depends on how the object was last seen.
        for track in self.active:
            track.edge = self.crossings.at_edge(track)
            patience = CONFIRM_SECONDS
            if track.confirmed:
                patience = PATIENCE_SECONDS
                if track.edge is not None and self.crossings.touches(track.last.box):
                    patience = GONE_PATIENCE_SECONDS
            if t - track.last.t <= patience:
                kept.append(track)
            elif not track.confirmed:
                self._note_unmet(track)
            elif track.edge is not None:
                left.append(track)
            else:
                self.lost.append(track)
        self.active = kept

        # Lost tracks that were not continued have vanished.
        patience = STITCH_SECONDS
        if self.crossings.anywhere:  # an exit is told in time
            patience = LATENESS_SECONDS_MAX - CONFIRM_SECONDS
        deadline = t - patience
        vanished = [track for track in self.lost if track.last.t < deadline]
        self.lost = [track for track in self.lost if track.last.t >= deadline]
        return left, vanished

    def _note_unmet(self, track: Track) -> None:
        """Record why a tentative track that has ended was not an object."""
        assert track.unmet is not None, "set in the frame in which it began"
        reason, value, least = track.unmet
        self._note(reason, track, track.last, None, value, least)

    def drop(self, track: Track) -> None:
        """Remove ``track`` without an event, because it is a ghost."""
        self._note("ghost", track, track.last)
        self.active = [other for other in self.active if other is not track]

    def finish(self, reason: Reason) -> list[Event]:
        """Forget all tracks, at the end of a recording or of a scene; return the last events.

        These are the exits of objects out of sight at an edge. Objects seen next count as having
        been there from the start.

        reason: what is recorded of the others.
        """
        t = self._t or 0.0
        self._start = None
        left = []
        for track in self.active:
            unseen = t - track.last.t > CONFIRM_SECONDS
            track.edge = self.crossings.at_edge(track) if track.confirmed and unseen else None
            if track.edge:
                left.append(track)
            elif track.confirmed:
                self._note(reason, track, track.last)
            else:
                self._note_unmet(track)
        for track in self.lost:
            self._note("lost", track, track.last)
        self.active = []
        self.lost = []
        return self.crossings.report_exits(left)
