"""Shuffled, repeated and delayed events: one result for all orders, within the lateness."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

import msgspec
import pytest
from camtopod.serve.ingest.camera_registry import Received
from camtopod.serve.ingest.receiver import Receiver
from hypothesis import given, settings, strategies as st
from serving import numbered
from sizes import size
from traffic import crossings, last_event

from camtopod.codec import to_msgpack
from camtopod.config.settings import Limits
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.records import Ack, Event

LATENESS = Settings().lateness_seconds
SPAN_SECONDS = 600.0
EVENTS = numbered(
    [*crossings(14, SPAN_SECONDS), *(last_event(SPAN_SECONDS, camera) for camera in "yz")]
)
LEARN = Settings(version_seconds=20.0, refit_share=0.3)
ROUND_EVENTS = 7
"""Events that come in between two rounds of the receiver."""
TENTHS = st.lists(
    st.integers(0, round(10 * LATENESS) - 1), min_size=len(EVENTS), max_size=len(EVENTS)
)
AGAIN = st.lists(st.tuples(st.integers(0, len(EVENTS) - 1), st.integers(0, 6000)), max_size=30)


class Shelf:
    """A fake journal; stores commits."""

    def __init__(self) -> None:
        self.entries: list[Any] = []
        self._numbers: dict[tuple[str, str, int], Any] = {}

    def streams(self) -> dict[tuple[str, str], int]:
        return {}

    def commit(self, entries: Sequence[Any], *others: object, **more: object) -> None:
        self.entries += entries
        self._numbers |= {(entry.camera, entry.boot, entry.seq): entry for entry in entries}

    def find_entry(self, camera: str, boot: str, seq: int) -> Any:
        return self._numbers.get((camera, boot, seq))

    def median_stored_time(self) -> float | None:
        return None

    def meta(self, key: str) -> str | None:
        return None

    def prune(self, now: float) -> None:
        """Do nothing: nothing is old."""


class Line:
    """A fake bus; stores acknowledgements."""

    def __init__(self) -> None:
        self.acks: dict[str, int] = {}

    def publish(self, key: str, ack: Ack, schema: str) -> None:
        self.acks[ack.camera] = ack.seq


def versions(learner: Learner) -> list[tuple[int, str]]:
    return [(one.version, one.digest) for one in learner.updates()]


def received(
    arrivals: Sequence[Event], learn: Settings = LEARN
) -> tuple[list[tuple[int, str]], Learner, Shelf, Line]:
    """Return the result of events that arrive in this order at the receiver and the learner."""
    learner, shelf, line, made = Learner(learn, "site", "e"), Shelf(), Line(), []

    def take(batch: list[Received]) -> None:
        for one in batch:
            assert one.event is not None
            learner.receive(one.event)
        made.extend(versions(learner))

    receiver = Receiver(
        shelf,
        line,
        Limits(),
        lambda: EVENTS[-1].t,
        take,
        lambda: 10_000,
        lambda version: None,
        lambda *_: None,  # type: ignore[arg-type]
    )
    stopping = threading.Event()
    stopping.set()  # one round at a time
    for start in range(0, len(arrivals), ROUND_EVENTS):
        for event in arrivals[start : start + ROUND_EVENTS]:
            receiver.on_event(f"event/{event.camera}", to_msgpack(event))
        receiver.work(stopping)
        receiver.store(stopping)
    return made, learner, shelf, line


def expected() -> list[tuple[int, str]]:
    learner = Learner(LEARN, "site", "e")
    for event in EVENTS:
        learner.receive(event)
    return versions(learner)


EXPECTED = expected()


def one_result(tenths: list[int], again: list[tuple[int, int]]) -> None:
    """Delay each event by so many tenths of a second; repeat some."""
    at = [
        (event.t + late / 10, number)
        for number, (event, late) in enumerate(zip(EVENTS, tenths, strict=True))
    ]
    at += [(at[number][0] + late / 10, number) for number, late in again]
    made, learner, shelf, line = received([EVENTS[number] for _, number in sorted(at)])
    assert made == EXPECTED
    assert learner.statistics()["late"] == 0
    assert len(shelf.entries) == len(EVENTS)
    assert line.acks == {event.camera: event.seq for event in EVENTS}


@given(TENTHS, AGAIN)
@settings(max_examples=5, deadline=None)
def test_any_order_within_the_lateness_gives_one_result(
    tenths: list[int], again: list[tuple[int, int]]
) -> None:
    one_result(tenths, again)


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@given(TENTHS, AGAIN)
@settings(max_examples=size("DISORDER", 2_000), deadline=None)
def test_very_many_orders_give_one_result(tenths: list[int], again: list[tuple[int, int]]) -> None:
    one_result(tenths, again)


def test_there_is_something_to_get_wrong() -> None:
    assert len(EXPECTED) >= 3
    elsewhere = msgspec.structs.replace(EVENTS[10], x=0.5)
    made, *_ = received([*EVENTS[:10], elsewhere, *EVENTS[11:]])
    assert made != EXPECTED, "the canary: one event in another place shows"


def test_what_comes_too_late_is_stored_and_counted_and_not_learned() -> None:
    number = next(
        k for k, event in enumerate(EVENTS) if event.camera == "b" and event.t > EVENTS[0].t + 200
    )
    late = [event for event in EVENTS if event.camera == "b" and event is not EVENTS[number]]
    alone = msgspec.structs.replace(EVENTS[number], boot="other", seq=1)
    rest = numbered(late) + [event for event in EVENTS if event.camera != "b"]
    rest.sort(key=lambda event: event.t)
    after = next(k for k, event in enumerate(rest) if event.t > alone.t + 60)
    made, learner, shelf, _ = received([*rest[:after], alone, *rest[after:]])
    assert learner.statistics()["late"] == 1
    assert len(shelf.entries) == len(EVENTS)
    assert made == received(rest)[0]
