"""Predictions are those of the version in use, with all that was observed before."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import pytest
from model_rows import LabelModel, with_rows
from msgspec.structs import replace
from serving import closing_event, numbered, walkers

from camtopod.learn.learner import Learner
from camtopod.predict import Predictor, Walks
from camtopod.predict.between import BetweenCameras
from camtopod.records import (
    Between,
    Event,
    InView,
    Look,
    Match,
    NextCamera,
    Prediction,
    Topology,
)
from camtopod.serve import live_predictions
from camtopod.serve.bus import QueryError
from camtopod.serve.hourly_counts import HOURS_MAX
from camtopod.serve.live_predictions import (
    FRESH_SECONDS,
    RECENT_SECONDS,
    REVISED_AT_ONCE_MAX,
    Live,
    Reader,
    asked_exit,
)

EVENTS = [*numbered(walkers(60)), closing_event()]
EXIT = next(event for event in EVENTS if event.kind == "exit")


def hear(live: Live, events: Sequence[Event]) -> None:
    for event in events:
        live.hear(event)


@pytest.fixture(scope="module")
def learned() -> Topology:
    learner = Learner(epoch="E")
    for event in EVENTS:
        learner.receive(event)
    assert learner.topology is not None
    return learner.topology


def test_exits_are_predicted_by_the_version_in_use(learned: Topology) -> None:
    made: list[Prediction | Match] = []
    live = Live(made.append, lambda: EXIT.t)
    live.hear(EXIT)
    assert made == [], "no version is in use yet"

    for number in (1, 2):
        live.use(Reader(replace(learned, version=number), walks=False))
        live.hear(EXIT)

    assert [one.version for one in made] == [1, 2]


def test_of_a_camera_that_is_new_since_the_version_nothing_is_known_yet(learned: Topology) -> None:
    made: list[Prediction | Match] = []
    live = Live(made.append, lambda: EXIT.t)
    live.use(Reader(learned, walks=True))
    live.hear(replace(EXIT, camera="new"))
    assert [str(one) for one in made] == ["not known yet"]
    with pytest.raises(QueryError, match="no camera 'new'; there are"):
        live.answer("predict/new", {"t": str(EXIT.t)})


def test_a_new_version_keeps_what_was_observed(learned: Topology) -> None:
    """Predictions equal those of a predictor of the new version that observed all events."""
    made: list[Prediction | Match] = []
    live = Live(made.append, lambda: EXIT.t)
    alone = Predictor(learned)
    live.use(Reader(learned, walks=False))
    expected = []
    for number, event in enumerate(EVENTS[:-1]):
        if number == len(EVENTS) // 2:
            live.use(Reader(replace(learned, version=learned.version + 1), walks=False))
        live.hear(event)
        if event.kind == "exit":
            expected.append(alone.predict(event))
        alone.observe(event)
    assert [replace(one, version=learned.version) for one in made] == expected


def test_entries_are_matched_and_those_of_a_backlog_are_not_published(learned: Topology) -> None:
    made: list[Prediction | Match] = []
    now = EVENTS[-2].t
    live = Live(made.append, lambda: now, processor_time=lambda: 0.0)
    live.use(Reader(learned, walks=True))
    hear(live, EVENTS[:-1])
    assert not any(isinstance(one, Match) for one in made), "predictions come first"
    live.match(lambda: True)
    assert not any(isinstance(one, Match) for one in made), "others have work"
    live.match(lambda: False)

    oldest = now - FRESH_SECONDS
    entries = [event for event in EVENTS[:-1] if event.kind == "entry" and event.t >= oldest]
    matches = [one for one in made if isinstance(one, Match)]
    assert [(one.camera, one.t) for one in matches[: len(entries)]] == [
        (event.camera, event.t) for event in entries
    ]
    assert all(one.t >= oldest for one in matches)


def test_entries_beyond_the_limit_have_no_match_and_are_known(
    learned: Topology, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_predictions, "UNMATCHED_MAX", 1)
    made: list[Prediction | Match] = []
    events = EVENTS[:-1]
    live = Live(made.append, lambda: events[-1].t, processor_time=lambda: 0.0)
    live.use(Reader(learned, walks=True))
    hear(live, events)
    live.match(lambda: False)

    exits = [event.t for event in events if event.kind == "exit"]
    assert [one.t for one in made if isinstance(one, Prediction)] == exits
    entries = sum(event.kind == "entry" for event in events)
    assert live.counts["matches_skipped"] == entries - (events[-1].kind == "entry")

    walks, hurried = (Walks(learned) for _ in range(2))
    [*before, last] = [event for event in events if event.kind == "entry"]
    for event in EVENTS[: EVENTS.index(last)]:
        walks.observe(event)
        hurried.observe(event, is_matched=event is before[0])
    in_full, in_haste = walks.observe(last), hurried.observe(last)
    assert in_full is not None
    assert in_haste is not None
    assert {(one.camera, one.t) for one in in_full.from_} <= {
        (one.camera, one.t) for one in in_haste.from_
    }


def test_matching_takes_no_more_than_its_time(learned: Topology) -> None:
    made: list[Prediction | Match] = []
    seconds = itertools.count()
    live = Live(made.append, lambda: EVENTS[-2].t, processor_time=lambda: float(next(seconds)))
    live.use(Reader(learned, walks=True))
    hear(live, EVENTS[-8:-1])
    live.match(lambda: False)  # one event, which takes a second
    made.clear()
    live.match(lambda: False)
    assert made == []
    assert next(seconds) == 2


def test_objects_between_cameras_are_counted_from_the_start(
    learned: Topology, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = EVENTS[0].t
    live = Live(lambda answer: None, lambda: now, processor_time=lambda: 0.0)
    assert live.between(None) is None, "no version is in use yet"
    live.use(Reader(learned, walks=False))
    assert live.between(None) is None, "nobody knows who has been seen again"
    live.use(Reader(learned, walks=True))
    counted, walks, predictor = BetweenCameras(now), Walks(learned), Predictor(learned)
    for event in EVENTS[:60]:
        now = event.t
        live.hear(event)
        live.match(lambda: False)
        if event.kind == "exit":
            counted.left(predictor.predict(event))
        predictor.observe(event)
        for match in [walks.observe(event), *walks.revised(now, REVISED_AT_ONCE_MAX)]:
            if match is not None:
                counted.entered(match)
        assert live.between(None) == counted.expected(now)
    assert counted.expected(now).number > 0.0

    live.forget_cameras({EVENTS[0].camera})
    counted.forget_cameras({EVENTS[0].camera})
    assert live.between(1) == counted.expected(now, 1)
    live.forget()
    assert live.between(None) == Between(now, now, 0.0, 0, 0)

    # Without a match of every entry it would be too many.
    live.hear(EVENTS[60])
    assert (left := live.between(None)) is not None
    monkeypatch.setattr(live_predictions, "UNMATCHED_MAX", 0)
    now += 5.0
    live.hear(EVENTS[61])
    assert (after := live.between(None)) is not None
    assert (left.since, after.since, after.number) == (now - 5.0, now, 0.0)


def test_recent_events_are_told_without_tracks(learned: Topology) -> None:
    now = EVENTS[-2].t
    live = Live(lambda answer: None, lambda: now)
    live.use(Reader(learned, walks=False))
    live.remember(EVENTS[:-1])

    everything = live.recent("recent", {})
    assert [one.t for one in everything.events] == [
        event.t for event in EVENTS[:-1] if event.t > now - RECENT_SECONDS
    ]
    assert everything.events[-1].zone in {zone.id for zone in learned.zones}
    assert everything.hours is None
    with pytest.raises(QueryError, match="since is a number"):
        live.recent("recent", {"since": "yesterday"})


def test_who_asks_for_what_came_since_the_answer_before_gets_each_event_once() -> None:
    """Also those of a camera whose clock is behind, which are older than what was told before."""
    now = 7200.0
    live = Live(lambda answer: None, lambda: now)
    since = live.recent("recent", {"since": "inf"}).t
    told = []
    for event in (Event("a", "entry", 7200.5), Event("b", "exit", 7190.0)):
        now += 1.0
        live.hear(event)
        answer = live.recent("recent", {"since": str(since)})
        since = answer.t
        told += answer.events

    assert [(one.camera, one.t) for one in told] == [("a", 7200.5), ("b", 7190.0)]
    assert live.recent("recent", {"since": str(since)}).events == []


def test_entries_and_exits_are_counted_by_the_hour_for_a_day() -> None:
    hour = 3600.0
    now = 100.0 * hour + 60.0
    live = Live(lambda answer: None, lambda: now)
    live.remember([Event("a", "entry", now - hour), Event("a", "exit", now - hour + 1.0)])
    hear(live, [Event("a", "exit", now), Event("b", "entry", now)])
    told = live.recent("recent", {"since": "inf", "hours": "1"})

    assert told.events == []
    assert told.hours is not None
    assert told.hours.since == now - hour, "that of the oldest event remembered from the journal"
    assert told.hours.first == 99.0 * hour
    assert told.hours.cameras == {"a": [[1, 1], [0, 1]], "b": [[0, 0], [1, 0]]}

    now += (HOURS_MAX - 1) * hour
    hear(live, [Event("a", "entry", now), Event("a", "entry", 9.0)])
    later = live.recent("recent", {"hours": "1"}).hours
    assert later is not None
    assert later.first == 100.0 * hour
    assert later.cameras["a"] == [[0, 1], *[[0, 0]] * (HOURS_MAX - 2), [1, 0]]


def test_a_recording_is_of_its_own_time() -> None:
    live = Live(lambda answer: None, lambda: 1e9)
    hear(live, [Event("a", "entry", 7200.0), Event("a", "exit", 7205.0)])
    told = live.recent("recent", {"hours": "1"})

    assert [event.t for event in told.events] == [7200.0, 7205.0]
    assert told.hours is not None
    assert (told.hours.first, told.hours.cameras) == (7200.0, {"a": [[1, 1]]})


def test_of_a_recording_that_comes_by_camera_the_last_hour_is_remembered() -> None:
    """Of each camera, however early the events of the next one begin."""
    live = Live(lambda answer: None, lambda: 1e9)
    times = [0.0, 1800.0, 5400.0 - RECENT_SECONDS, 4000.0, 5400.0]
    for camera in "abc":
        hear(live, [Event(camera, "entry", t) for t in times])

    answer = live.recent("recent", {"hours": "1"})
    assert [(event.camera, event.t) for event in answer.events] == [
        (camera, t) for camera in "abc" for t in times[1:]
    ]
    assert answer.hours is not None
    assert answer.hours.cameras == {camera: [[3, 0], [2, 0]] for camera in "abc"}


def test_recent_events_have_labels_that_the_version_knows(learned: Topology) -> None:
    """So what no class is, as a plate sent by mistake, is not told to readers."""
    assert learned.model is not None
    shares = {zone.id: [1.0] for zone in learned.zones}
    known = with_rows(learned, labels=LabelModel(["person"], 0.9, shares))
    live = Live(lambda answer: None, lambda: EVENTS[-2].t)
    live.use(Reader(known, walks=False))
    sent = ["Person", "ab123cd", None]
    live.remember(
        [replace(event, label=label) for event, label in zip(EVENTS[-5:-2], sent, strict=True)]
    )

    assert [one.label for one in live.recent("recent", {}).events] == ["person", None, None]


def test_a_question_may_give_the_label() -> None:
    event, now = asked_exit("a", {"label": "Bus", "x": "0.5", "y": "0.5"}, 7.0)

    assert (event.label, event.t, now) == ("bus", 7.0, None)


def test_without_walks_no_prediction_names_a_passage_of_another_camera(learned: Topology) -> None:
    passage = InView("b", "7", 1.7e9, 0.9)
    rows = [NextCamera(camera, f"{camera}/1", 0.3, 1.0, 2.0, 3.0) for camera in "bc"]
    looks = [Look("b", 0.93), Look("c", 0.03)]
    prediction = Prediction("a", "a/1", 1.7e9, "1", 1, 0.4, rows, looks, [passage])
    assert Reader(learned, walks=True).published(prediction) == prediction
    published = Reader(learned, walks=False).published(prediction)
    assert published == replace(prediction, look=[Look("b", 0.3), Look("c", 0.3)], in_view=None)
    alone = replace(prediction, look=None, in_view=None)
    assert Reader(learned, walks=False).published(alone) == alone, "no view overlaps"
