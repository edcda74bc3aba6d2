"""Cameras' names within the ids of zones and the subjects of alarms."""

from __future__ import annotations

from collections.abc import Iterable

_ARROW = "->"
"""Between the two zones of an alarm's subject."""


def camera_of(place: str) -> str:
    """Return the camera of a zone's id; a camera's name is returned as it is."""
    return place.partition("/")[0]


def mentions(subject: str, cameras: Iterable[str]) -> bool:
    """Return True if an alarm's subject (a camera, a zone, a link) is of one of these cameras."""
    return not {camera_of(place) for place in subject.split(_ARROW)}.isdisjoint(cameras)


def renamed(subject: str, old: str, new: str) -> str:
    """Return a camera, a zone or a link (``lobby/1->hall/2``) with the camera ``old`` renamed."""
    places = []
    for place in subject.split(_ARROW):
        camera, slash, number = place.partition("/")
        places.append(f"{new if camera == old else camera}{slash}{number}")
    return _ARROW.join(places)
