"""Words for the grabber's decisions: why a track became an event or not (`grab --explain`)."""

from __future__ import annotations

from datetime import UTC, datetime

from camtopod.vision.track import Decision, Edge, Reason

_EPOCH = datetime.fromtimestamp(0, UTC)
_EDGES: dict[Edge, str] = {
    "left border": "the left border",
    "right border": "the right border",
    "top border": "the top border",
    "bottom border": "the bottom border",
    "ignored area": "an ignored area that reaches to the border",
    "named door": "the named door",
    "learned door": "the learned door",
    "mid-view": "what hides it in mid-view",
}
_BEGINNINGS: dict[Reason, str] = {
    "entered": "entry by {edge} at {place}",
    "from start": "no entry: in view already when tracking began",
    "beside others": "no entry: appeared at {place} beside another track, in mid-view: rather half "
    "of a group than a new person",
    "in mid-view": "no entry: appeared in mid-view at {place}, not at a border or door "
    "(if that happens there again and again, a door is learned)",
}
"""Words by the reason of a beginning."""
_TENTATIVE: dict[Reason, str] = {
    "brief": "no event: too short at {place}, {seen} in {value:.1f} s, at least {least:g} s are "
    "needed",
    "patchy": "no event: flickers at {place}, seen in {value:.0%} of the frames, at least "
    "{least:.0%} are needed",
    "still": "no event: sways or stands at {place}, moved by {value:.2f} of its height, at least "
    "{least:g} are needed",
    "fragment": "no event: a fragment at {place}, {value:.0f} pixels high, people there have at "
    "least {least:.0f}",
    "low": "no event: lower than min_height at {place}, reaches it in {value:.0f} of {least:.0f} "
    "sightings that are needed",
}
"""Words by the reason why a track was not an object."""
_ENDS: dict[Reason, str] = {
    "left": "exit by {edge} at {place}",
    "lost": "no exit: lost in mid-view at {place}, not at a border or door (if that happens there "
    "again and again, a door is learned)",
    "occluded": "no exit: lost behind others in mid-view at {place}",
    "interrupted": "no exit: in mid-view at {place} when the stream paused",
    "ghost": "no exit: not an object, but the hole in the background where one stood at {place}; "
    "the background is corrected",
    "scene changed": "no exit: the whole image changed, and all tracks are forgotten",
    "blind": "no exit: the pictures showed nothing any more",
    "in view": "no exit: still in view at the end of the recording",
}
"""Words by the reason of the end of an object."""
_WORDS = {**_BEGINNINGS, **_TENTATIVE, **_ENDS}


def words_of(decision: Decision) -> str:
    """Return what a track was taken for, and why."""
    x, y = decision.place
    sightings = "1 sighting" if decision.sightings == 1 else f"{decision.sightings} sightings"
    return _WORDS[decision.reason].format(
        edge="the border" if decision.edge is None else _EDGES[decision.edge],
        place=f"({x:.2f}, {y:.2f})",
        seen=sightings,
        value=decision.value,
        least=decision.least,
    )


def decision_line(camera: str, decision: Decision) -> str:
    """Return a line about a decision: time, camera, track, the decision and its reason.

    The time is that of the event: of the first sighting at a beginning, of the last one at an end.
    The end of an object also has the time of the first sighting.
    """
    words = f"{clock_words(decision.t)}  {camera}  track {decision.track}: {words_of(decision)}"
    if decision.reason not in _ENDS:
        return words
    return f"{words} (first seen at {clock_words(decision.first_t)})"


def clock_words(t: float) -> str:
    """Return a capture time in words: date and time in UTC, or the position in a recording.

    Times within the epoch's first year are positions.
    """
    at = datetime.fromtimestamp(t, UTC)
    if at.year <= _EPOCH.year:
        return f"{t:.1f} s"
    return f"{at:%Y-%m-%dT%H:%M:%S}.{at.microsecond // 100000}Z"
