"""The receiver without a bus: acknowledged events are stored despite failures.

All queues are bounded.
"""

from __future__ import annotations

import queue
import random
import sqlite3
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from serving import T0, closing_event, numbered, walkers

from camtopod.codec import Rejected, to_msgpack
from camtopod.config.settings import Limits
from camtopod.learn.learner import Learner
from camtopod.records import Ack, Event, Prediction
from camtopod.serve.ingest.admission import SpoolAnswer
from camtopod.serve.ingest.camera_registry import Received
from camtopod.serve.ingest.puller import read_batch
from camtopod.serve.ingest.receiver import BUSY_EVENTS, PREDICT_SECONDS_BUSY, Receiver
from camtopod.serve.live_predictions import Live
from camtopod.serve.outbox.spool import SpoolBatch
from camtopod.serve.runtime.progress import Beat, no_beat
from camtopod.serve.storage.journal import Entry, Journal, Snapshot
from camtopod.serve.storage.packed_version import Version
from camtopod.serve.storage.sqlite_file import Damaged


class Acks:
    """A bus that stores acknowledgements."""

    def __init__(self) -> None:
        self.seen: list[Ack] = []

    def publish(self, key: str, noun: Any, schema: str) -> None:
        if schema == "ack":
            self.seen.append(noun)


class Bench:
    """A receiver on a journal; time stands still at `T0`."""

    def __init__(self, directory: Path, **limits: float) -> None:
        self.journal, self.bus = Journal(directory), Acks()
        self.learned: list[Received] = []
        self.seen: list[Received] = []
        self.published: list[Version] = []
        self.receiver = Receiver(
            self.journal,
            self.bus,
            Limits(**limits),
            lambda: T0,  # type: ignore[arg-type]
            self.learned.extend,
            lambda: 10_000,
            self.published.append,
            lambda batch, _: self.seen.extend(batch),
            steady=lambda: 0.0,
        )
        self.stopping = threading.Event()

    def hear(self, *events: Event) -> None:
        for event in events:
            self.receiver.on_event(f"event/{event.camera}", to_msgpack(event))

    def round(self) -> None:
        self.receiver._round(self.receiver._take_messages())
        self.receiver._store_waiting(self.stopping)

    def work(self, beat: Beat = no_beat) -> None:
        """Work until told to stop; errors of the journal are raised here."""
        ordering = threading.Thread(target=self.receiver.work, args=(self.stopping, beat))
        ordering.start()
        try:
            self.receiver.store(self.stopping)
        finally:
            self.stopping.set()
            ordering.join()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    one = Bench(tmp_path, held_events_max=50)
    yield one
    one.journal.close()


def events(first: int, last: int, camera: str = "lobby", boot: str = "b") -> list[Event]:
    return [Event(camera, "entry", T0 - 1000 + n, boot=boot, seq=n) for n in range(first, last + 1)]


class Mouth:
    """A subscription to which the test publishes."""

    def __init__(self, *said: list[Event]) -> None:
        self._said, self._over = queue.SimpleQueue[list[Event] | None](), False
        for events in said:
            self.say(*events)

    def say(self, *events: Event) -> None:
        self._said.put([*events])

    def receive(self, wait: bool = True) -> list[tuple[str, bytes]] | None:
        try:
            events = None if self._over else self._said.get(block=wait)
        except queue.Empty:
            return []
        self._over = events is None
        return (
            None
            if events is None
            else [(f"event/{event.camera}", to_msgpack(event)) for event in events]
        )

    def close(self) -> None:
        self._said.put(None)


# --- what is heard --------------------------------------------------------------------------------


def test_what_is_heard_is_put_in_order_by_the_thread_that_hears_it(bench: Bench) -> None:
    """Handing events to another thread would take longer than a prediction."""
    mouth, seen_by = Mouth(events(2, 2), events(1, 1)), set()
    bench.receiver._see = lambda batch, _: (
        bench.seen.extend(batch),
        seen_by.add(threading.get_ident()),
    )  # type: ignore[assignment]
    bench.receiver.subscription = mouth  # type: ignore[assignment]
    mouth.close()
    bench.receiver.listen()
    assert [one.entry.seq for one in bench.seen] == [1, 2]
    assert seen_by == {threading.get_ident()}


def test_nothing_heard_is_forgotten_at_the_end(bench: Bench) -> None:
    mouth = Mouth()
    bench.receiver.subscription = mouth  # type: ignore[assignment]
    listening = threading.Thread(target=bench.receiver.listen)
    listening.start()
    mouth.say(*events(1, 3))
    bench.stopping.set()
    bench.work()
    listening.join()
    assert [one.entry.seq for one in bench.learned] == [1, 2, 3]


def test_while_the_other_thread_puts_in_order_what_is_heard_waits_for_it(bench: Bench) -> None:
    mouth = Mouth(events(1, 3))
    bench.receiver.subscription = mouth  # type: ignore[assignment]
    mouth.close()
    with bench.receiver._turn:
        bench.receiver.listen()
        assert (len(bench.receiver._inbox), bench.seen) == (3, [])
    bench.round()
    assert [one.entry.seq for one in bench.seen] == [1, 2, 3]


def test_what_there_is_no_room_for_is_heard_all_the_same(tmp_path: Path) -> None:
    """Otherwise all other messages on the bus would wait, too."""
    bench = Bench(tmp_path, commit_events_max=100)
    mouth = Mouth(events(1, 500))
    bench.receiver.subscription = mouth  # type: ignore[assignment]
    mouth.close()
    bench.receiver.listen()
    assert (bench.receiver._queue.waiting, len(bench.receiver._inbox)) == (200, 300)
    for _ in range(5):
        bench.round()
    assert [one.entry.seq for one in bench.learned] == [*range(1, 501)]
    bench.journal.close()


def test_predictions_end_when_so_much_comes_meanwhile_that_they_would_be_late(bench: Bench) -> None:
    mouth, given = Mouth(events(1, 200)), []
    bench.receiver.subscription = mouth  # type: ignore[assignment]

    def see(batch: list[Received], seconds: float) -> None:
        if not given:
            mouth.say(*events(201, 200 + BUSY_EVENTS + 1))
            mouth.close()
        given.append((len(batch), seconds > PREDICT_SECONDS_BUSY))
        until = time.monotonic() + min(seconds, 2 * PREDICT_SECONDS_BUSY)
        while time.monotonic() < until:
            pass

    bench.receiver._see = see
    bench.receiver.listen()
    assert given[0] == (20, True), "there is time for each"
    assert given[1] == (180, False), "and none any more"


# --- the end --------------------------------------------------------------------------------------


def test_what_could_not_be_stored_at_the_end_is_not_acknowledged_with_what_could(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An acknowledgement covers all events up to its seq; a disk may take the last and not those
    before.
    """
    commit, refused = bench.journal.commit, [False]

    def full(entries: Any, *rest: Any) -> None:
        if entries and not refused[0]:
            refused[0] = True
            bench.hear(*events(4, 4))
            bench.stopping.set()
            raise sqlite3.OperationalError("database or disk is full")
        commit(entries, *rest)

    monkeypatch.setattr(bench.journal, "commit", full)
    bench.hear(*events(1, 3))
    bench.work()
    assert refused == [True]
    stored = {entry.seq for _, entry in bench.journal.entries() if entry is not None}
    for ack in bench.bus.seen:
        assert set(range(1, ack.seq + 1)) <= stored


class Disk:
    """Some commits succeed; then they do, fail, or fail but are durable; the last
    failure stops all.
    """

    def __init__(self, bench: Bench, chance: random.Random, failures: int) -> None:
        self._bench, self._chance, self._failures = bench, chance, failures
        self._commit, self._good = bench.journal.commit, chance.randint(1, 4)

    def commit(self, entries: Any, *rest: Any) -> None:
        self._good -= bool(entries)
        broken = entries and self._failures and self._good < 0
        fate = self._chance.choice(("succeed", "fail", "durable")) if broken else "succeed"
        if fate != "succeed":
            self._failures -= 1
            if not self._failures:
                self._bench.stopping.set()
        if fate != "fail":
            self._commit(entries, *rest)
            if fate == "durable":
                self._bench.journal._last -= len(entries)  # as a commit leaves it that raises
        if fate != "succeed":
            raise sqlite3.OperationalError("disk I/O error")


@pytest.mark.parametrize("seed", range(60))
def test_whatever_the_disk_does_until_the_end_what_is_acknowledged_is_there_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    monkeypatch.setattr("camtopod.serve.storage.journal_writer._RETRY_SECONDS", 0.0)
    chance = random.Random(seed)
    bench = Bench(tmp_path, commit_events_max=1, ack_seconds=1e-9)
    monkeypatch.setattr(bench.journal, "commit", Disk(bench, chance, chance.randint(1, 6)).commit)
    coming = [
        event
        for camera in "ab"
        for event in events(1, 250, camera)
        for _ in range(chance.choice((1, 1, 2)))
    ]
    chance.shuffle(coming)
    coming.sort(key=lambda event: event.t + chance.uniform(0, 9))
    bench.hear(*coming)
    receiver = bench.receiver
    bench.work(
        lambda: None if len(receiver._inbox) or receiver._queue.waiting else bench.stopping.set()
    )
    entries = [entry for _, entry in bench.journal.entries()]
    stored = [(entry.camera, entry.seq) for entry in entries if entry is not None]
    assert len(set(stored)) == len(stored)
    assert bench.bus.seen
    for ack in bench.bus.seen:
        assert {(ack.camera, seq) for seq in range(1, ack.seq + 1)} <= set(stored)
    assert [one.entry for one in bench.learned] == entries[: len(bench.learned)], (
        "learned in the journal's order"
    )
    bench.journal.close()


def first_version() -> Version:
    learner = Learner(epoch="E")
    for event in [*numbered(walkers(20)), closing_event()]:
        learner.receive(event)
    topology = learner.updates()[0]
    return Version.of(topology)


def test_a_version_that_could_not_be_stored_at_the_end_is_stored_before_a_snapshot_that_has_it(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    commit, full = bench.journal.commit, True

    def failing(*given: Any) -> None:
        if full:
            bench.stopping.set()
            raise sqlite3.OperationalError("database or disk is full")
        commit(*given)

    monkeypatch.setattr(bench.journal, "commit", failing)
    bench.receiver.storing.on_version(first_version())
    bench.work()
    full = False
    bench.receiver.storing.store_remaining(Snapshot(0, "E", b"state"))
    assert bench.journal.snapshots() == [Snapshot(0, "E", b"state")]
    assert list(bench.journal.versions("E")) == [1]


def test_the_last_snapshot_handed_over_is_stored_though_nothing_was_learned_since(
    bench: Bench,
) -> None:
    bench.receiver.storing.on_snapshot(Snapshot(0, "E", b"state"))
    bench.receiver.storing.store_remaining(None)
    assert len(bench.journal.snapshots()) == 1


# --- predictions ----------------------------------------------------------------------------------


def test_what_is_about_to_be_stored_is_seen_before_the_disk_has_it_and_once(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    commit, seen_by_then = bench.journal.commit, []

    def slow(entries: Any, *rest: Any) -> None:
        seen_by_then.append(len(bench.seen))
        commit(entries, *rest)

    monkeypatch.setattr(bench.journal, "commit", slow)
    future = Event("lobby", "exit", T0 + 3600.0, boot="b", seq=4)
    bench.hear(*events(1, 3), *events(2, 3), future, *events(6, 6))
    bench.round()
    assert seen_by_then == [4]
    bench.hear(*events(1, 6))
    bench.round()
    assert [one.entry.seq for one in bench.seen] == [1, 2, 3, 4, 5, 6], (
        "6 waited for 5; nothing twice"
    )
    assert [one.entry for one in bench.seen] == [one.entry for one in bench.learned]
    assert [one.entry.seq for one in bench.seen if one.event is None] == [4], (
        "no event to be predicted"
    )


def test_a_disk_that_does_not_answer_holds_up_no_prediction_and_bounds_what_waits(
    tmp_path: Path,
) -> None:
    bench = Bench(tmp_path, commit_events_max=10)
    for first in range(1, 100, 10):
        bench.hear(*events(first, first + 9))
        bench.receiver._round(bench.receiver._take_messages())
    assert len(bench.seen) == 20, "a transaction's worth, and another"
    bench.round()
    bench.round()
    assert len(bench.learned) == 20
    bench.journal.close()


def test_predictions_that_would_come_late_are_skipped_and_counted() -> None:
    learner = Learner(epoch="E")
    for event in [*numbered(walkers(60)), closing_event()]:
        learner.receive(event)
    made: list[Prediction] = []
    live = Live(made.append)
    batch = [Received(Entry("event", "a", None, None, b""), event) for event in walkers(5)]
    live.see(batch, seconds_max=1.0)
    assert (made, live.counts["predictions"], live.counts["predictions_skipped"]) == ([], 0, 0), (
        "nothing learned yet"
    )
    assert learner.topology is not None
    live.use(learner.topology)
    live.see(batch, seconds_max=60.0)
    assert (len(made), live.counts["predictions"], live.counts["predictions_skipped"]) == (
        10,
        10,
        0,
    )
    live.see(batch, seconds_max=0.0)
    assert (len(made), live.counts["predictions"], live.counts["predictions_skipped"]) == (
        10,
        10,
        10,
    )


# --- limits ---------------------------------------------------------------------------------------


def test_early_events_of_a_publisher_without_a_count_wait_within_the_limit(bench: Bench) -> None:
    for _ in range(20):
        bench.hear(*(Event("lobby", "entry", T0 + 30 + n / 1000) for n in range(50)))
        bench.round()
    assert bench.receiver.cameras.waiting <= 100, "the limit, and what came with the last"
    assert bench.receiver.counts["held_full"] == 1000 - bench.receiver.cameras.waiting


def test_an_answer_that_begins_beyond_all_measure_is_counted_as_far_as_counts_go(
    bench: Bench,
) -> None:
    """A status that cannot be encoded would end the daemon."""
    for boot in "abc":
        bench.hear(*events(1, 1, boot=boot))
        bench.round()
        batch = SpoolBatch("lobby", boot, 2**63 - 1, 0, False, [])
        assert bench.receiver.on_answer(SpoolAnswer(batch, 2))
        bench.round()
    assert bench.receiver.streams.lost > 2**62
    assert to_msgpack(bench.receiver.streams.lost)


def test_a_camera_whose_place_was_given_away_may_still_have_something_under_way(
    tmp_path: Path,
) -> None:
    """An event held behind a gap for long is stored when the gap is given up."""
    bench = Bench(tmp_path, cameras_max=1, gap_seconds=0.001)
    bench.hear(*events(5, 6))
    bench.receiver._limits = Limits(gap_seconds=1e6)
    bench.round()
    assert bench.receiver.cameras.register("other", 1e9), "it has been silent for long"
    bench.receiver._limits = Limits(gap_seconds=1e-9)
    bench.round()
    assert [entry.seq for _, entry in bench.journal.entries() if entry is not None] == [5, 6]
    bench.journal.close()


def test_after_a_start_the_cameras_heard_last_have_their_places(tmp_path: Path) -> None:
    bench = Bench(tmp_path)
    for camera in ("old", "older", "new", "newer"):
        bench.hear(*events(1, 1, camera))
        bench.round()
    bench.journal.close()
    again = Bench(tmp_path, cameras_max=2, streams_max=2)
    assert again.receiver.refused_reason == "", "those that found no place have not been refused"
    assert "new" in again.receiver.cameras
    assert "newer" in again.receiver.cameras
    again.hear(*events(1, 2, "newer"))
    again.round()
    assert again.receiver.counts["duplicate"] == 1
    assert again.receiver.counts["stored"] == 1
    again.journal.close()


def test_a_camera_with_a_grabber_is_stored_beside_any_number_of_names(tmp_path: Path) -> None:
    bench = Bench(tmp_path, cameras_max=3)
    for k in range(5):
        bench.hear(*events(1, 2, f"name{k}"))
        bench.round()
    bench.hear(*events(1, 1, "plain"))
    bench.round()
    assert bench.receiver.rejects.counts == {"too-many-cameras": 5}
    assert "camera plain and 2 others are refused" in bench.receiver.refused_reason
    bench.receiver.with_spool.add("lobby")
    bench.hear(*events(1, 3, "lobby"))
    bench.round()
    assert [
        received.entry.seq for received in bench.learned if received.entry.camera == "lobby"
    ] == [1, 2, 3]
    assert bench.receiver.rejects.counts == {"too-many-cameras": 5}
    bench.journal.close()


def test_a_journal_over_its_size_is_back_within_it_however_much_is_stored_between_two_snapshots(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("camtopod.serve.storage.journal.PRUNED_ROWS_MAX", 10)
    bench = Bench(tmp_path)
    bench.journal._keep = type(bench.journal._keep)(journal_bytes_max=1)
    for snapshots in range(1, 4):
        bench.hear(*events(100 * snapshots - 99, 100 * snapshots))
        bench.round()
        bench.receiver.storing.on_snapshot(Snapshot(100 * snapshots, "E", b""))
        for _ in range(12):
            bench.round()
    assert bench.journal.first() == 201, "up to the older snapshot"
    bench.journal.close()


def test_a_version_is_published_after_it_is_stored(bench: Bench) -> None:
    one = first_version()
    bench.receiver.storing.on_version(one)
    bench.round()
    assert bench.published == [one]
    assert bench.journal.versions("E") == {1: one.head.digest}


def test_a_journal_that_turns_out_to_be_damaged_ends_the_work_and_holds_up_no_end(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """The next start sets it aside; another attempt would not help."""

    def damaged(*_: Any) -> None:
        raise Damaged("the journal is damaged")

    monkeypatch.setattr(bench.journal, "commit", damaged)
    bench.hear(*events(1, 1))
    with pytest.raises(Damaged):
        bench.work()
    assert bench.bus.seen == []
    bench.receiver.storing.store_remaining(Snapshot(0, "E", b"state"))
    assert (
        "the last versions and snapshot could not be stored: the journal is damaged" in caplog.text
    )


def test_what_waits_is_no_larger_than_an_event_may_be(bench: Bench) -> None:
    """A client may publish a megabyte, under a name of any length."""
    for name in ("lobby", "x" * 60_000):
        bench.receiver.on_event(f"event/{name}", b"\x00" * 1_000_000)
    waiting = bench.receiver._inbox.take(10)
    assert all(len(one.camera) + len(one.raw) < 5000 for one in waiting)
    for name in ("lobby", "x" * 60_000):
        bench.receiver.on_event(f"event/{name}", b"\x00" * 1_000_000)
    bench.round()
    assert bench.receiver.rejects.counts == {"too-long": 2}


@pytest.mark.parametrize(
    ("batch", "what"),
    [
        (
            SpoolBatch("lobby", "b", 1, 0, False, [(1, b""), (2, b""), (3, b"")]),
            "3 events, asked for 2",
        ),
        (SpoolBatch("lobby", "b", 1, 0, False, [(2, b""), (2, b"")]), "not by rising seq"),
        (SpoolBatch("lobby", "b", 2, 0, False, [(1, b"")]), "begins behind"),
        (SpoolBatch("hall", "b", 1, 0, False, []), "camera 'hall'"),
    ],
)
def test_an_answer_that_is_none_to_the_question_is_rejected(batch: SpoolBatch, what: str) -> None:
    with pytest.raises(Rejected, match=what):
        read_batch(to_msgpack(batch), "lobby", 2)
    good = SpoolBatch("lobby", "b", 1, 0, True, [(1, b""), (2, b"")])
    assert read_batch(to_msgpack(good), "lobby", 2) == good
