"""Cameras' names within the ids of zones and the subjects of alarms, and operators' judgements."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TypeVar

from msgspec.structs import replace

from camtopod.admin import Judge, Judgement, Verdict
from camtopod.records import Link

_ARROW = "->"
"""Between the two zones of an alarm's subject."""
_Links = TypeVar("_Links", list[Link], list[Link] | None)


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


def judged(judgements: Sequence[Judgement], command: Judge) -> list[Judgement]:
    """Return the judgements after a command, the new one at the end."""
    key = command.source, command.target
    others = [one for one in judgements if one[:2] != key]
    return others if command.verdict == "none" else [*others, (*key, command.verdict)]


def without_camera(judgements: Iterable[Judgement], camera: str) -> list[Judgement]:
    """Return the judgements of other cameras only."""
    return [one for one in judgements if camera not in (camera_of(one[0]), camera_of(one[1]))]


def with_new_name(judgements: Iterable[Judgement], old: str, new: str) -> list[Judgement]:
    """Return the judgements with a camera renamed."""
    return [(renamed(a, old, new), renamed(b, old, new), said) for a, b, said in judgements]


def marked(links: _Links, judgements: Iterable[Judgement]) -> _Links:
    """Return links with the operator's word on each in ``operator``.

    A judgement of two zones precedes one of their cameras. Visible links have none: they are
    passages that were seen.
    """
    said: dict[tuple[str, str], Verdict] = {(a, b): verdict for a, b, verdict in judgements}
    if links is None or not (said or any(link.operator for link in links)):
        return links

    def word_on(link: Link) -> Verdict | None:
        return said.get((link.from_, link.to)) or said.get(
            (camera_of(link.from_), camera_of(link.to))
        )

    return [
        link if link.relation == "visible" else replace(link, operator=word_on(link))
        for link in links
    ]
