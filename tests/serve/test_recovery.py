"""A daemon's learner after a start: it continues from a snapshot, whatever happened before."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from msgspec.structs import replace
from serving import closing_event, numbered, small_config, walkers

from camtopod.admin import Reset, Rewind
from camtopod.codec import to_msgpack
from camtopod.event_time import microseconds
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.records import Event
from camtopod.serve.ingest import present_names, read_names
from camtopod.serve.learner_process import recovery
from camtopod.serve.learner_process.feeder import CATCHING_UP_SECONDS, LearnerFeeder
from camtopod.serve.learner_process.messages import STATE, LearnProgress
from camtopod.serve.learner_process.process import PROGRAM, LearnerEnded, LearnerProcess
from camtopod.serve.learner_process.recovery import recent_events, recover
from camtopod.serve.storage import command_entry
from camtopod.serve.storage.journal import Entry, Journal, Snapshot
from camtopod.serve.storage.sqlite_file import StateError

SETTINGS = msgspec.structs.replace(small_config(Path()).learner, lateness_seconds=5.0)
EVENTS = [*sorted(numbered(walkers(60)), key=lambda event: event.t), closing_event()]


class Installation:
    """A journal and a daemon's learning on it, without the bus.

    published: the versions that were stored since the start.
    """

    def __init__(
        self, directory: Path, settings: Settings = SETTINGS, program: str = PROGRAM
    ) -> None:
        self.journal = Journal(directory)
        self.process = LearnerProcess(program)
        self.published: list[tuple[str, int, str]] = []
        self._epochs = iter("EFGHIJ"[len(self.journal.meta("epochs") or "") :])
        with contextlib.ExitStack() as undo:
            undo.callback(self.close)
            names = present_names(read_names(self.journal))
            recovered = recover(self.journal, self.process, settings, "s", self.new_epoch, names)
            undo.pop_all()
        self.started_at = recovered.position
        self.learning = LearnerFeeder(recovered, self.process, self.journal, self.on_progress)

    @property
    def epoch(self) -> str:
        """The epoch of the next version."""
        return self.learning.progress.epoch

    def on_progress(self, progress: LearnProgress) -> None:
        """Store what was learned, as the daemon does."""
        if progress.state is not None:
            versions = [version.stored for version in progress.versions]
            snapshot = Snapshot(progress.position, progress.epoch, progress.state)
            self.journal.commit([], versions, snapshot)
            self.published += [(one.epoch, one.version, one.digest) for one in versions]

    def new_epoch(self) -> str:
        epoch = next(self._epochs)
        self.journal.set_meta("epochs", (self.journal.meta("epochs") or "") + epoch)
        self.journal.set_meta("epoch", epoch)
        return epoch

    def store(self, events: list[Event]) -> None:
        """Store events in the journal, as the daemon does."""
        self.journal.commit(
            [Entry("event", e.camera, e.boot, e.seq, to_msgpack(e)) for e in events]
        )
        self.learning.note_stored()

    def learn(self, events: list[Event]) -> None:
        """Store and learn events, and store the versions."""
        self.store(events)
        self.run()

    def run(self) -> None:
        """Work until everything is learned."""
        stop = threading.Event()

        def beat() -> None:
            if not self.learning.waiting:
                stop.set()

        self.learning.work(stop, beat)

    def close(self) -> None:
        self.process.close()
        self.journal.close()


Start = Callable[..., Installation]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Start on the same directory again, as after a kill: unstored data is lost."""
    running: list[Installation] = []

    def again(**given: Any) -> Installation:
        if running:
            running[-1].close()
        running.append(Installation(tmp_path, **given))
        return running[-1]

    yield again
    running[-1].close()


def uninterrupted() -> list[tuple[str, int, str]]:
    learner, made = Learner(SETTINGS, "s", "E"), []
    for event in EVENTS:
        learner.receive(event)
        made += [(one.epoch, one.version, one.digest) for one in learner.updates()]
    return made


def test_killed_at_any_moment_the_versions_are_the_same(start: Start) -> None:
    published: list[tuple[str, int, str]] = []
    for first in range(0, len(EVENTS), 37):
        one = start()
        one.learn(EVENTS[first : first + 30])
        one.store(EVENTS[first + 30 : first + 37])  # stored, and killed before it was learned
        published += one.published
    last = start()
    last.run()
    assert published + last.published == uninterrupted()
    assert last.started_at > len(EVENTS) / 2, "it went on from a snapshot"


def test_it_says_how_far_it_is_behind(start: Start) -> None:
    """Of what was stored since it was up to date, and by event time."""
    one = start()
    one.learn(EVENTS[:100])
    watermark = one.learning.progress.statistics.watermark
    assert one.learning.catching_up(watermark + 1000.0) is None, "all of it is learned"
    one.store(EVENTS[100:150])
    assert one.learning.catching_up(watermark + CATCHING_UP_SECONDS - 1.0) is None
    behind = one.learning.catching_up(watermark + 1000.0)
    assert behind is not None
    assert (behind.seconds, behind.share) == (pytest.approx(1000.0), 0.0)
    one.learning.position += 20
    behind = one.learning.catching_up(watermark + 1000.0)
    assert behind is not None
    assert behind.share == pytest.approx(0.4)


def test_recent_events_are_by_time_in_whatever_order_they_were_stored(start: Start) -> None:
    one = start()
    one.store(sorted(EVENTS, key=lambda event: event.camera))

    assert [event for _, event in recent_events(one.journal)] == sorted(
        EVENTS, key=lambda event: event.t
    )


def test_what_a_paused_learner_holds_is_waiting(start: Start) -> None:
    """A recording is in the learner's memory at once, and is learned tick by tick."""
    one = start()
    one.learn(EVENTS[:100])
    progress = one.learning.progress
    assert one.learning.waiting == 0
    assert one.learning.catching_up(progress.statistics.watermark + 1000.0) is None
    one.learning.progress = replace(
        progress,
        is_paused=True,
        deadline=progress.statistics.watermark,
        statistics=replace(progress.statistics, held=60, watermark=1e12),
    )
    assert one.learning.waiting == 60
    behind = one.learning.catching_up(progress.statistics.watermark + 1000.0)
    assert behind is not None
    assert (behind.seconds, behind.share) == (pytest.approx(1000.0), 0.0)


def test_a_damaged_snapshot_costs_an_epoch_and_nothing_that_was_learned(start: Start) -> None:
    one = start()
    one.learn(EVENTS)
    positions = [snapshot.position for snapshot in one.journal.snapshots()]
    one.journal._db.execute("UPDATE snapshot SET state = x'00' WHERE position = ?", positions[:1])

    again = start()
    again.run()

    assert again.started_at == positions[1]
    assert {epoch for epoch, _, _ in again.published} == {"F"}
    assert again.learning.progress.statistics.accepted == len(EVENTS)


def test_a_damaged_entry_begins_an_epoch_with_what_is_left(start: Start) -> None:
    one = start()
    one.learn(EVENTS)
    assert one.published[-1][0] == "E"
    one.journal._db.execute("DELETE FROM snapshot")
    one.journal._db.execute("UPDATE entry SET raw = x'00' WHERE id BETWEEN 20 AND 60")
    again = start()
    again.run()
    assert again.learning.damage_count == 41
    assert {epoch for epoch, _, _ in again.published} == {"F"}
    assert [version for _, version, _ in again.published] == list(
        range(1, len(again.published) + 1)
    )


def test_other_settings_begin_an_epoch_with_what_is_known(start: Start) -> None:
    start().learn(EVENTS)
    again = start(settings=msgspec.structs.replace(SETTINGS, publish_q_max=0.5))
    again.run()
    assert [(epoch, version) for epoch, version, _ in again.published] == [("F", 1)]
    same = start(settings=msgspec.structs.replace(SETTINGS, publish_q_max=0.5))
    same.run()
    assert same.published == []


def test_without_a_snapshot_and_the_oldest_events_an_epoch_begins(start: Start) -> None:
    one = start()
    one.learn(EVENTS[:200])
    one.journal._db.execute("DELETE FROM snapshot")
    one.journal._db.execute("DELETE FROM entry WHERE id <= 100")
    again = start()
    assert again.started_at == 100
    again.learn(EVENTS[200:])
    assert {epoch for epoch, _, _ in again.published} == {"F"}


@pytest.mark.parametrize(("what", "status"), [("fails", 1), ("killed", -signal.SIGKILL)])
def test_an_entry_at_which_the_learner_dies_twice_is_skipped(
    what: str, status: int, start: Start, caplog: pytest.LogCaptureFixture
) -> None:
    one = start()
    one.learn(EVENTS[:120])
    poison = msgspec.structs.replace(EVENTS[130], track=what)
    one.store([*EVENTS[120:130], poison, *EVENTS[131:160]])
    for _ in range(recovery.DEATHS_MAX):
        failing = start(program="learners.faulty")
        with pytest.raises(LearnerEnded) as ended:
            failing.run()
        assert (ended.value.status, ended.value.at) == (status, 131)

    again = start(program="learners.faulty")
    assert "at entry 131 of the journal, which is skipped, in epoch F" in caplog.text
    again.run()
    again.learn(EVENTS[160:])
    assert again.learning.progress.statistics.accepted == len(EVENTS) - 1
    assert {epoch for epoch, _, _ in again.published} == {"F"}


def test_a_skipped_entry_is_in_no_state_that_the_learner_goes_on_from(start: Start) -> None:
    """The learner dies behind the version that an entry makes, whose snapshot has the entry."""
    learner = Learner(SETTINGS, "s", "E")
    makers = []
    for number, event in enumerate(EVENTS, 1):
        learner.receive(event)
        makers += [number] * len(learner.updates())
    fatal = next(number for number in makers if number > 120)
    poison = msgspec.structs.replace(EVENTS[fatal - 1], track="fails later")
    start().store([*EVENTS[: fatal - 1], poison, *EVENTS[fatal:]])
    for _ in range(recovery.DEATHS_MAX):
        failing = start(program="learners.faulty")
        with pytest.raises(LearnerEnded) as ended:
            failing.run()
        assert ended.value.at == fatal
    assert failing.journal.snapshots()[0].position == fatal

    again = start(program="learners.faulty")

    assert again.started_at < fatal
    again.run()
    assert again.learning.progress.statistics.accepted == len(EVENTS) - 1


def test_a_learner_that_dies_of_what_it_has_learned_begins_anew(
    start: Start, caplog: pytest.LogCaptureFixture
) -> None:
    one = start()
    one.learn(EVENTS[:120])
    for _ in range(recovery.DEATHS_MAX):
        recovery.note_failure(one.journal, STATE)
    position = one.journal.snapshots()[0].position

    again = start()

    assert (again.started_at, again.epoch) == (position, "F")
    assert "it begins with nothing" in caplog.text
    again.learn(EVENTS[120:])
    assert again.learning.waiting == 0
    assert again.learning.progress.statistics.accepted == len(EVENTS) - position


def test_a_rewind_is_replayed_like_an_event(start: Start) -> None:
    wild = [msgspec.structs.replace(e, t=e.t + 86_400.0, boot="w") for e in EVENTS[:30]]
    one = start()
    one.learn([*EVENTS[:120], *wild])
    to = EVENTS[119].t + 1.0
    entry = command_entry(Rewind(to, one.epoch, one.new_epoch()))
    one.journal.commit([entry])
    one.run()
    assert (one.epoch, one.learning.progress.statistics.watermark) == ("F", to)
    one.learn(EVENTS[120:])
    assert one.learning.progress.statistics.late <= 30, (
        "of what a wild clock had made late nothing is made good"
    )
    assert {epoch for epoch, _, _ in one.published} == {"E", "F"}

    again = start()

    again.run()
    assert (again.epoch, again.published) == ("F", [])


@pytest.mark.parametrize("is_reset", [False, True])
def test_killed_before_a_correction_was_learned_no_event_time_of_before_is_left(
    start: Start, is_reset: bool
) -> None:
    """The daemon would take nothing until this machine's clock had passed that time."""
    wild = [msgspec.structs.replace(e, t=e.t + 86_400.0, boot="w") for e in EVENTS[:30]]
    one = start()
    one.learn([*EVENTS[:120], *wild])
    to = EVENTS[119].t + 1.0
    epochs = one.epoch, one.new_epoch()
    one.journal.commit([command_entry(Reset(to, *epochs) if is_reset else Rewind(to, *epochs))])

    again = start()
    recent = recovery.recent_events(again.journal)
    progress = again.learning.progress
    assert (progress.event_time.newest_us or 0) > microseconds(to + 80_000.0)
    recovered = recovery.Recovered(again.started_at, progress)
    time = recovery.event_time(again.journal, recovered, SETTINGS, recent)
    newest = microseconds(to + SETTINGS.lateness_seconds)
    assert time.state.newest_us == (None if is_reset else newest)


def test_an_event_that_cannot_be_read_any_more_holds_no_start_up(start: Start) -> None:
    """An older program may have accepted it."""
    one = start()
    one.learn(EVENTS[:50])
    one.journal.commit([Entry("event", "a", None, None, b"{}")])
    again = start()
    again.run()
    assert [event for _, event in recent_events(again.journal)] == sorted(
        EVENTS[:50], key=lambda event: event.t
    )


def test_what_a_newer_program_has_learned_is_not_thrown_away(start: Start) -> None:
    one = start(program="learners.newer")
    one.learn(EVENTS[:150])
    with pytest.raises(StateError, match="the snapshot was saved by a newer camtopod"):
        start()
    assert start(program="learners.newer").started_at > 0


def test_what_predictions_remember(start: Start) -> None:
    one = start()
    one.learn(EVENTS[:50])
    assert [event for _, event in recent_events(one.journal)] == sorted(
        EVENTS[:50], key=lambda event: event.t
    )
    one.learn(EVENTS[50:])
    newest = recovery.newest_topology(one.journal)
    assert newest is not None
    assert newest.digest == one.published[-1][2]

    one.journal._db.execute(
        "UPDATE version SET digest = 'x' WHERE id = (SELECT MAX(id) FROM version)"
    )
    before = recovery.newest_topology(one.journal)
    assert before is not None
    assert before.version == newest.version - 1, "the newest is damaged"
