"""Predictions and matches in a city: of each camera by the part that owns it.

A part of a city (`camtopod.records.Topology.parts`) is the topology of a district, which hears its
own cameras and those beyond its border. Each event is observed by all parts that hear its camera,
and the owner's part alone answers a question about a camera, as that district's daemon does.
`predicting` and `matching` answer the events of a recording, by a city or by one site.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

from camtopod.codec import require_event, require_topology
from camtopod.predict.predictor import Predictor
from camtopod.predict.walks import Walks
from camtopod.records import Event, Match, Prediction, Topology
from camtopod.topology import UnknownPlace

AnswerT = TypeVar("AnswerT")


class CityPredictor:
    """Predicts by the parts of a city, as a `Predictor` does by one topology.

        >>> from camtopod import CityPredictor, Event, load_topology
        >>> predictor = CityPredictor(load_topology("city.json"))
        >>> predictor.predict(Event("lobby", "exit", 1_700_000_000.0)).next[0].zone
        'hall/1'

    Raises ValueError for a topology that is no city.
    """

    def __init__(self, city: Topology) -> None:
        self._hearers = hearers_of(city)
        self._version = city.version
        self._predictors = [Predictor(part) for part in city.parts or ()]

    def observe(self, event: Event) -> None:
        """Observe an event; see `Predictor.observe`."""
        require_event(event)
        for part in self._hearers.get(event.camera, ()):
            self._predictors[part].observe(event)

    def predict(self, event: Event, now: float | None = None) -> Prediction:
        """Return the prediction of the owner's part, or raise, as `Predictor.predict`."""
        require_event(event, "exit")
        if event.camera not in self._hearers:
            raise UnknownPlace("camera", event.camera, self._version, list(self._hearers))
        return self.answer(event, now)

    def answer(self, event: Event, now: float | None = None) -> Prediction:
        """Return what `predict` does; of a camera that no part has, nothing is known."""
        owner, *_ = self._hearers.get(event.camera, (0,))
        return self._predictors[owner].answer(event, now)


class CityWalks:
    """Matches by the parts of a city, as `Walks` does by one topology.

    A walk is named as by the owner's part alone: by its oldest passage in a camera that this part
    hears.

    Raises ValueError for a topology that is no city.
    """

    def __init__(self, city: Topology) -> None:
        self._hearers = hearers_of(city)
        self._walks = [Walks(part) for part in city.parts or ()]

    def observe(self, event: Event) -> Match | None:
        """Observe an event; return the match of an entry by its owner's part, None for an exit."""
        parts = self._hearers.get(event.camera, (0,))
        match, *_ = [self._walks[part].observe(event) for part in parts]
        return match


def hearers_of(city: Topology) -> dict[str, list[int]]:
    """Return, by camera, the numbers of the parts that hear it, its owner's first.

    Raises ValueError for a topology that is no city; TypeError.
    """
    require_topology(city)
    if not city.parts:
        raise ValueError("the topology is no city: Predictor and Walks answer for it")
    hearers: dict[str, list[int]] = defaultdict(list)
    for number, part in enumerate(city.parts):
        for camera in part.cameras:
            is_owner = (city.owners or {}).get(camera.id) == part.site
            hearers[camera.id].insert(0 if is_owner else len(hearers[camera.id]), number)
    return dict(hearers)


def predicting(topology: Topology) -> Callable[[list[Event]], list[Prediction | None]]:
    """Return what answers the events of one moment after the other: the exits with predictions.

    Those of one moment become known when time has moved on.
    """
    predictor = CityPredictor(topology) if topology.parts else Predictor(topology)

    def answer(moment: list[Event]) -> list[Prediction | None]:
        answers = [predictor.answer(event) if event.kind == "exit" else None for event in moment]
        for event in moment:
            predictor.observe(event)
        return answers

    return answer


def matching(topology: Topology) -> Callable[[list[Event]], list[Match | None]]:
    """Return what answers the events of one moment after the other: the entries with matches.

    Of one moment, exits that end earlier passages count before entries.
    """
    walks = CityWalks(topology) if topology.parts else Walks(topology)

    def answer(moment: list[Event]) -> list[Match | None]:
        entry_tracks = {(event.camera, event.track) for event in moment if event.kind == "entry"}
        ending = [
            event.kind == "exit" and (event.camera, event.track) not in entry_tracks
            for event in moment
        ]
        for event, first in zip(moment, ending, strict=True):
            if first:
                walks.observe(event)
        return [
            None if first else walks.observe(event)
            for event, first in zip(moment, ending, strict=True)
        ]

    return answer


def by_moment(
    answer: Callable[[list[Event]], Iterable[AnswerT]], events: Iterable[Event]
) -> Iterator[AnswerT]:
    """Yield the answers to events, which are in order of time."""
    for _, moment in itertools.groupby(events, key=lambda event: event.t):
        yield from answer(list(moment))
