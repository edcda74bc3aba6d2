"""Backlogs of several cameras are merged by time, in any order of arrival."""

from __future__ import annotations

import random
from pathlib import Path

import msgspec
from serving import T0, small_config, wait_for

from camtopod.learn.settings import Settings
from camtopod.records import Event
from camtopod.serve.bus import session as buses
from camtopod.serve.daemon import Daemon
from camtopod.serve.ingest.backlog import (
    HOLD_SECONDS_MAX,
    SETTLE_SECONDS,
    STALLED_SECONDS,
    BacklogMerger,
)
from camtopod.serve.ingest.camera_registry import Received
from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.storage.journal import Entry


def at(camera: str, *times: float) -> list[Received]:
    return [
        Received(Entry("event", camera, "b", int(t), b""), Event(camera, "entry", t)) for t in times
    ]


def release(
    merge: BacklogMerger, ready: list[Received], now: float, most: int = 100
) -> list[Received]:
    return merge.release(ready, now, lambda: most)


def times(released: list[Received]) -> list[float]:
    return [one.event.t for one in released if one.event is not None]


def test_live_events_go_straight_through() -> None:
    merge = BacklogMerger(100)
    assert release(merge, at("a", 5.0, 4.0), 0.0) == at("a", 5.0, 4.0)
    merge.note_answer("a", [5.5], False, 0.0)
    assert release(merge, at("a", 5.5), 0.0) == at("a", 5.5), (
        "one event that got lost on the way is no backlog"
    )


def test_backlogs_are_merged_by_time() -> None:
    merge = BacklogMerger(100)
    release(merge, at("a", 1.0), 0.0)
    merge.note_answer("a", [10.0, 30.0], False, 0.0)
    assert release(merge, at("a", 10.0, 30.0), 0.0) == []
    merge.note_answer("b", [5.0, 20.0], False, 1.0)
    assert release(merge, at("b", 5.0, 20.0) + at("c", 40.0), 1.0) == []
    assert merge.waiting == 5
    assert release(merge, [], SETTLE_SECONDS + 0.9) == []
    assert times(release(merge, [], SETTLE_SECONDS + 1.0)) == [5.0, 10.0, 20.0, 30.0, 40.0]
    assert merge.waiting == 0
    assert release(merge, at("a", 41.0), 3.0) == at("a", 41.0)


def test_who_has_more_is_waited_for_unless_it_is_stuck() -> None:
    merge = BacklogMerger(100)
    merge.note_answer("a", [10.0, 30.0], True, 0.0)
    merge.note_answer("b", [5.0, 20.0], True, 0.0)
    assert release(merge, at("a", 10.0, 30.0) + at("b", 5.0, 20.0), 0.0) == [], "others may come"
    assert times(release(merge, [], SETTLE_SECONDS)) == [5.0, 10.0, 20.0]
    assert release(merge, [], STALLED_SECONDS + SETTLE_SECONDS - 0.1) == []
    assert times(release(merge, [], STALLED_SECONDS + SETTLE_SECONDS)) == [30.0]


def test_a_backlog_that_is_late_anyway_is_not_waited_for() -> None:
    merge = BacklogMerger(100)
    release(merge, at("a", 100.0), 0.0)
    merge.note_answer("b", [5.0, 20.0], True, 0.0)
    assert release(merge, at("b", 5.0, 20.0) + at("a", 101.0), 0.0) == at("b", 5.0, 20.0) + at(
        "a", 101.0
    )


def test_nobody_waits_for_ever_nor_does_too_much() -> None:
    merge = BacklogMerger(3)
    merge.note_answer("a", [10.0, 30.0], True, 0.0)
    merge.note_answer("b", [10.0, 40.0], True, 0.0)
    release(merge, at("b", 40.0, 41.0, 42.0), 0.0)
    assert merge.is_full("b")
    assert not merge.is_full("a")
    now = 0.0
    while now < HOLD_SECONDS_MAX - 1:
        now += 1.0
        merge.note_answer("a", [30.0 + now / 1000], True, now)
        assert release(merge, [], now) == []
    assert times(release(merge, [], HOLD_SECONDS_MAX)) == [40.0, 41.0, 42.0]


def test_no_more_than_may_is_released_at_a_time() -> None:
    merge = BacklogMerger(100)
    merge.note_answer("a", [10.0, 30.0], False, 0.0)
    release(merge, at("a", *range(10, 31)), 0.0)
    out = [one for _ in range(5) for one in release(merge, [], 9.0, 5)]
    assert times(out) == list(range(10, 31))
    assert release(merge, at("b", 1.0), 9.0) == at("b", 1.0)


def test_small_backlogs_that_keep_coming_hold_nothing_up_for_long() -> None:
    merge = BacklogMerger(100)
    for now in range(int(STALLED_SECONDS)):
        merge.note_answer("a", [10.0 * now, 10.0 * now + 9], False, float(now))
        assert release(merge, at("a", 10.0 * now), float(now)) == []
    merge.note_answer("a", [100.0, 109.0], False, STALLED_SECONDS)
    assert len(release(merge, [], STALLED_SECONDS)) == STALLED_SECONDS


def test_what_has_no_time_keeps_its_place() -> None:
    merge = BacklogMerger(100)
    merge.note_answer("a", [10.0, 30.0], False, 0.0)
    refused = Received(Entry("refused", "a", "b", 11, b""))
    earlier = at("a", 9.0)
    release(merge, [*at("a", 10.0), refused, *earlier, *at("b", 9.5)], 0.0)
    assert release(merge, [], 9.0) == [*at("b", 9.5), *at("a", 10.0), refused, *earlier]


def test_after_an_outage_of_the_daemon_nothing_is_late(tmp_path: Path) -> None:
    """Three grabbers have an hour of events each; the learner's lateness is five seconds."""
    config = small_config(tmp_path / "state", pull_events_max=200)
    config = msgspec.structs.replace(config, learn=Settings())
    chance = random.Random(1)
    with Daemon(config) as daemon, buses.dial(small_config(tmp_path, daemon.endpoint)) as bus:
        publishers = []
        for camera in "abc":
            spool = Spool(tmp_path / f"{camera}.db", f"boot-{camera}", 100_000)
            publisher = Publisher(spool, 500)
            events = sorted(T0 + chance.uniform(0, 3600) for _ in range(700))
            publisher.publish(*(Event(camera, "entry", t, 0.5, 0.5) for t in events))
            publishers.append((publisher, spool))
        for publisher, _ in publishers:
            publisher.attach(bus)
        wait_for(
            lambda: all(publisher.wait_acknowledged(0.0) for publisher, _ in publishers),
            "everything to be stored",
        )
        wait_for(lambda: daemon.status().learner["accepted"] == 2100, "everything to be learned")
        assert daemon.status().learner["late"] == 0
        for _, spool in publishers:
            spool.close()
