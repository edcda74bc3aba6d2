"""Each rule of the daemon's side of a request, on a journal on disk."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from pathlib import Path

import pytest
from intake_bench import IntakeBench, Request, answer_of, event_bytes

from camtopod import codec
from camtopod.admin import Forget, Reset
from camtopod.config import Limits
from camtopod.records import Event
from camtopod.serve.ingest import (
    CommandRefused,
    Intake,
    cameras,
    execute,
    intake as intake_module,
    numbers,
)
from camtopod.serve.requests import BATCH_EVENTS_MAX, Batch
from camtopod.serve.storage import Entry


@pytest.fixture
def bench(tmp_path: Path) -> IntakeBench:
    return IntakeBench(tmp_path)


# --- numbers --------------------------------------------------------------------------------------


def test_a_batch_is_answered_when_it_is_on_disk_and_repetitions_count_once(
    bench: IntakeBench,
) -> None:
    bench.hello()
    answer = bench.store({1: -3, 2: -2})
    assert (answer.have, answer.reason) == ({"b1": 2}, "")

    assert bench.store({1: -3, 2: -2, 3: -1}).have == {"b1": 3}

    assert bench.stored == [("event", "a", 1), ("event", "a", 2), ("event", "a", 3)]
    assert [one.entry.seq for one in bench.learned] == [1, 2, 3]
    assert len(bench.heard) == 3
    assert bench.intake.counts["duplicate"] == 2


def test_what_is_missing_between_events_is_counted_as_lost(bench: IntakeBench) -> None:
    bench.hello()
    bench.store({1041: -4, 1043: -3})
    assert bench.intake.numbers.loss == 1

    assert bench.store({1046: -2, 1049: -1}, after=1043).have == {"b1": 1049}
    assert bench.intake.numbers.loss == 5


def test_a_batch_behind_events_that_were_never_taken_is_told_where_to_begin(
    bench: IntakeBench,
) -> None:
    bench.hello()
    bench.store({1: -3, 2: -2})

    assert bench.store({9: -1}, after=8).have == {"b1": 2}
    assert len(bench.stored) == 2


def test_an_older_journal_says_how_far_it_has_come(bench: IntakeBench, tmp_path: Path) -> None:
    bench.hello()
    bench.store({1: -5, 2: -4})
    with sqlite3.connect(tmp_path / "copy.db") as copy:
        bench.journal._db.backup(copy)
    copy.close()
    bench.store({3: -1}, after=2)
    bench.stop()
    for path in tmp_path.glob("journal.db*"):
        path.unlink()
    (tmp_path / "copy.db").rename(tmp_path / "journal.db")
    bench.start()

    assert bench.hello(boots=["b1", "b2"]).have == {"b1": 2, "b2": 0}
    assert bench.journal.missing == 1
    assert bench.store({3: -1}, after=2).have == {"b1": 3}


def test_a_rescued_journal_is_filled_from_the_first_hole(bench: IntakeBench) -> None:
    bench.hello()
    bench.store({seq: seq / 10 - 1.0 for seq in range(1, 7)})
    with bench.journal._db as database:
        database.execute("UPDATE entry SET raw = 'damaged' WHERE seq = 3")
        database.execute("UPDATE meta SET crc = 0 WHERE key = 'format'")
    bench.restart()

    assert bench.hello(boots=["b1"]).have == {"b1": 2}
    again = bench.store({seq: seq - 10.0 for seq in range(3, 9)}, after=2)
    assert again.have == {"b1": 8}
    assert sorted(seq for _, _, seq in bench.stored if seq) == [1, 2, 3, 4, 5, 6, 7, 8]
    assert [one.entry.seq for one in bench.learned][-3:] == [3, 7, 8]


def test_a_damaged_number_is_that_of_the_newest_entry(bench: IntakeBench) -> None:
    bench.hello()
    bench.store({1: -2.0, 2: -1.0})
    bench.journal._db.execute("UPDATE stream SET seq = 9")
    bench.restart()
    assert bench.hello(boots=["b1"]).have == {"b1": 2}
    assert bench.store({1: -2.0, 2: -1.0, 3: -0.5}).have == {"b1": 3}
    assert [seq for _, _, seq in bench.stored] == [1, 2, 3]


def test_a_boot_without_number_and_entries_comes_again_too_late_to_be_learned(
    bench: IntakeBench,
) -> None:
    bench.hello()
    bench.send(times={1: -20.0, 2: -19.0})
    bench.send(boot="b2", times={1: -1.0})
    bench.tick(5.1)
    bench.journal._db.execute("UPDATE stream SET seq = 9 WHERE boot = 'b1'")
    bench.journal._db.execute("DELETE FROM entry WHERE boot = 'b1'")
    bench.restart()

    assert bench.hello(boots=["b1", "b2"]).have == {"b1": 0, "b2": 1}
    again = bench.send(times={1: -25.0, 2: -24.0, 3: -1.0})
    bench.tick(5.1)

    assert (answer_of(again).have, answer_of(again).late) == ({"b1": 3}, 2)


def test_events_of_a_forgotten_boot_that_come_again_count_once(
    bench: IntakeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(numbers, "STREAMS_KEPT_MAX", 3)
    bench.hello()
    for number in range(6):
        bench.store({1: -1.0}, boot=f"boot-{number}")

    assert bench.hello(boots=["boot-0"]).have == {"boot-0": 0}
    assert bench.store({1: -1.0, 2: -0.5}, boot="boot-0").have == {"boot-0": 2}
    assert len(bench.stored) == 7
    assert bench.learned[-1].entry.seq == 2


def test_publications_count_once_and_those_of_spools_are_left_alone(bench: IntakeBench) -> None:
    bench.publish("a", boot="b1", seq=1, spooled=True)
    for seq in (0, 0, 1, 1):
        bench.publish("a", boot="b1", seq=seq)
    bench.publish("a")

    assert bench.stored == [("event", "a", 0), ("event", "a", 1), ("event", "a", None)]


@pytest.mark.parametrize("waits_for_command", [False, True])
def test_numbers_rise_over_publications_and_requests(
    bench: IntakeBench, waits_for_command: bool
) -> None:
    """A number on disk says that all below are."""
    bench.hello()
    inbox = bench.intake.inbox
    published = Event("a", "entry", bench.wall - 2.0, boot="b1", seq=1)
    inbox.on_event("event/a", codec.to_msgpack(published))
    batch = Batch("h1", "b1", 0, [(2, event_bytes("a", bench.wall - 1.0))])
    inbox.on_request("store/a", codec.to_msgpack(batch), Request().reply)
    if waits_for_command:
        bench.intake.is_storing_command = True
        bench.intake.step()
        bench.intake.is_storing_command = False
    bench.work()
    assert [seq for _, _, seq in bench.stored] == [1, 2]


def test_a_command_begins_and_ends_between_two_steps(
    bench: IntakeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    changes: list[bool] = []

    class Watched(Intake):
        def __setattr__(self, name: str, value: object) -> None:
            super().__setattr__(name, value)
            if name == "is_storing_command":
                changes.append(self.turn.locked())

    bench.hello()
    bench.store({1: -1.0})
    monkeypatch.setattr(bench.intake, "__class__", Watched)
    execute(bench.intake, Forget("a"), None, lambda: Reset(bench.wall), lambda _: None)
    with pytest.raises(CommandRefused):
        execute(bench.intake, Forget("b"), None, lambda: Reset(bench.wall), lambda _: None)
    assert changes == [True] * 4


# --- reasons --------------------------------------------------------------------------------------


def test_a_batch_of_another_hello_is_refused(bench: IntakeBench) -> None:
    bench.hello(number="h1")
    bench.hello(number="h2")

    assert bench.store({1: -1}, number="h1").reason == "hello"

    assert not bench.stored


@pytest.mark.parametrize(
    "request_",
    [
        b"\xc1",
        Batch("h1", "b1", 5, [(4, b"")]),
        Batch("h1", "b1", 0, [(2, b""), (1, b"")]),
    ],
    ids=["no MessagePack", "below after", "falling"],
)
def test_a_malformed_request_is_answered_and_counted(
    bench: IntakeBench, request_: Batch | bytes
) -> None:
    bench.hello()
    assert answer_of(bench.ask("a", request_)).reason == "malformed"
    assert bench.intake.rejects.counts.total() == 1


def test_an_event_with_an_invalid_label_is_stored_and_the_label_counted(
    bench: IntakeBench,
) -> None:
    bench.publish("a", label=["no", "text"], boot="b1", seq=1)
    bench.publish("a", label="Car", boot="b1", seq=2)

    assert bench.stored == [("event", "a", 1), ("event", "a", 2)]
    assert [event.label for event in bench.heard] == [None, "car"]
    assert bench.intake.rejects.counts == {"bad-label": 1}


def test_a_grabber_that_numbers_events_and_never_asks_is_too_old(
    bench: IntakeBench, caplog: pytest.LogCaptureFixture
) -> None:
    """As those of 0.2; other programs have no token on the bus, and new grabbers ask at once."""
    for camera in ("old", "new"):
        bench.intake.on_alive(camera, True)
    for camera in ("old", "new", "program"):
        bench.publish(camera, boot="b1", seq=1)
    bench.hello("new")
    bench.tick(intake_module.SILENT_SECONDS - 0.1)
    assert bench.intake.too_old == {}
    bench.tick(0.2)
    bench.tick(1.0)

    words = "camera old: its grabber is too old for this daemon: upgrade it"
    assert bench.intake.too_old == {"old": words}
    assert caplog.messages.count(words) == 1
    bench.intake.on_alive("old", False)
    bench.hello("old")
    bench.publish("old", boot="b1", seq=2)
    bench.tick(intake_module.SILENT_SECONDS + 1.0)
    assert bench.intake.too_old == {}

    for is_there in (False, True):  # it was replaced
        bench.intake.on_alive("new", is_there)
    bench.publish("new", boot="b2", seq=1)
    bench.tick(intake_module.SILENT_SECONDS + 1.0)
    assert bench.intake.too_old.keys() == {"new"}


def test_a_held_batch_is_answered_after_a_minute_and_stored_once(bench: IntakeBench) -> None:
    bench.hello()
    batch = Batch("h1", "b1", 0, [(1, event_bytes("a", bench.wall))])
    sent = Request()
    bench.intake.inbox.on_request("store/a", codec.to_msgpack(batch), sent.reply)
    bench.intake.step()  # and the disk does not answer
    bench.wall += 61.0
    bench.now += 61.0
    bench.intake.step()
    assert answer_of(sent).reason == "held"

    assert bench.store({}, after=1).have == {"b1": 1}
    assert [seq for _, _, seq in bench.stored] == [1]


def test_the_room_is_shared_by_the_cameras_that_are_there(
    bench: IntakeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert bench.hello().batch == BATCH_EVENTS_MAX
    bench.intake.alive |= {f"c{n}" for n in range(1000)}
    assert bench.hello().batch == 50

    monkeypatch.setattr(intake_module, "EVENTS_MAX", 3)
    answer = bench.store({1: 0.0, 2: 0.0, 3: 0.0, 4: 0.0})
    assert (answer.reason, answer.batch) == ("busy", 1)


def test_above_cameras_max_nothing_is_taken(tmp_path: Path) -> None:
    bench = IntakeBench(tmp_path, Limits(cameras_max=1, commit_seconds=0.0))
    bench.publish("invented")
    assert bench.hello("a").reason == ""  # a grabber comes before bare publications

    refused = bench.hello("b")

    assert refused.reason == "cameras"
    assert "limits.cameras_max (1) is reached" in refused.detail


# --- what is not learned --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "raw", [b"\xff", event_bytes("other", 1.7e9), b"x" * 5000], ids=["malformed", "other", "long"]
)
def test_a_poisoned_event_is_stored_in_its_place_and_not_learned(
    bench: IntakeBench, raw: bytes
) -> None:
    bench.hello()
    events = [(1, event_bytes("a", bench.wall)), (2, raw), (3, event_bytes("a", bench.wall))]

    answer = answer_of(bench.ask("a", Batch("h1", "b1", 0, events)))

    assert (answer.have, answer.refused) == ({"b1": 3}, 1)
    assert [kind for kind, _, _ in bench.stored] == ["event", "refused", "event"]
    assert [one.event is None for one in bench.learned] == [False, True, False]


def test_a_flood_is_stored_as_numbers(bench: IntakeBench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cameras, "EVENTS_PER_SECOND_MAX", 2)
    bench.hello()

    answer = bench.store(dict.fromkeys(range(1, 6), -1.0))

    assert (answer.have, answer.refused) == ({"b1": 5}, 3)
    assert bench.intake.counts["flood"] == 3


# --- clocks ---------------------------------------------------------------------------------------


def test_an_event_a_little_ahead_makes_no_other_late(bench: IntakeBench) -> None:
    bench.hello("a")
    bench.hello("b")
    bench.store({1: -0.1}, camera="b")

    assert bench.store({1: 30.0, 2: 30.5}).have == {"b1": 2}
    for seq in range(2, 12):
        bench.tick(4.0)
        assert bench.store({seq: -0.1}, camera="b", after=seq - 1).late == 0


def test_an_event_far_ahead_is_stored_and_not_learned(bench: IntakeBench) -> None:
    bench.hello()

    answer = bench.store({1: 3600.0, 2: -0.1})

    assert (answer.have, answer.refused) == ({"b1": 2}, 1)
    assert [kind for kind, _, _ in bench.stored] == ["future", "event"]


def test_nothing_is_taken_while_the_clock_is_behind_event_time(bench: IntakeBench) -> None:
    bench.hello()
    bench.store({1: 0.0})
    bench.stop()
    bench.wall -= 3600.0
    bench.start()

    assert bench.hello().reason == "clock"
    assert "camtopod reset" in bench.hello().detail

    bench.tick(3600.0)
    assert bench.hello().reason == ""


def test_a_clock_that_is_set_back_while_the_daemon_runs_takes_event_time_back(
    bench: IntakeBench,
) -> None:
    bench.hello()
    bench.store({1: 0.0})
    bench.store({2: 50.0}, after=1)

    bench.wall -= 3600.0
    bench.tick(0.1)

    assert bench.store({3: 0.0}, after=2).have == {"b1": 3}
    kinds = [kind for kind, _, _ in bench.stored]
    assert kinds == ["event", "event", "correction", "event"]
    assert bench.journal.meta("epoch") == "after", "in one transaction with its entry"


def test_idle_time_advances_for_the_learner(bench: IntakeBench) -> None:
    bench.hello()
    bench.store({1: 0.0})
    bench.intake.event_clock.deadline = bench.wall + 5.0
    bench.tick(9.0)
    assert bench.stored[-1][0] == "event"

    bench.tick(10.0)

    assert bench.stored[-1][0] == "advance"
    assert bench.learned[-1].advance == bench.wall - 10.0


# --- backlogs ------------------------------------------------------------------------------------


def test_who_catches_up_is_named_and_logged_once(
    bench: IntakeBench, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")

    def reason() -> str:
        bench.intake.cameras.log_behind(bench.wall, bench.now)
        return bench.intake.cameras.behind_reason(bench.wall, bench.now)

    bench.hello("a")
    bench.send("a", times={1: -50.0}, more=1)
    assert reason() == ""
    for number, camera in enumerate("bc", 1):
        bench.hello(camera)
        bench.send(camera, times={1: -3600.0 * number}, more=1)
    for _ in range(3):
        assert reason().startswith("camera c catches up and is 120 min behind, 1 more less: its ")
        assert len(caplog.messages) == 1

    for camera in "bc":
        bench.send(camera, after=1, times={2: -1.0})
    assert reason() == ""
    assert len(caplog.messages) == 2

    bench.hello("d")
    bench.send("d", times={1: -400.0 * 86_400.0}, more=1)
    assert reason().startswith("camera d catches up and is 400 days behind: its ")


def test_a_camera_that_goes_away_amid_its_backlog_is_named_for_a_while(bench: IntakeBench) -> None:
    bench.hello("a")
    bench.send("a", times={1: -3600.0}, more=1)
    bench.tick(cameras.SAID_SECONDS)
    assert bench.intake.cameras.behind_reason(bench.wall, bench.now)
    bench.tick(60.0)
    assert bench.intake.cameras.behind_reason(bench.wall, bench.now) == ""


def test_a_camera_that_promises_more_and_dies_is_waited_for_five_seconds(
    bench: IntakeBench,
) -> None:
    bench.hello("dies")
    bench.hello("a")
    bench.send("dies", times={1: -300.0}, more=100)
    assert bench.store({1: -200.0}, camera="a").have == {"b1": 1}, "it is stored at once"
    assert bench.waits == [["", "dies"]]

    bench.tick(5.1)
    assert bench.waits == [["", "dies"], []]


@pytest.mark.parametrize(("gain", "waits"), [(0.0, False), (0.5, False), (1.1, True)])
def test_a_camera_is_waited_for_while_it_gains_a_second_a_second(
    bench: IntakeBench, gain: float, waits: bool
) -> None:
    bench.hello("slow")
    bench.hello("a")
    bench.send("slow", times={1: -3600.0}, more=1000)
    bench.store({1: -50.0}, camera="a")
    for second in range(1, 90):
        bench.tick(1.0)
        behind = 3600.0 - gain * second
        bench.send("slow", after=second, times={second + 1: -behind}, more=1000)
        if second == 58:
            assert bench.waits == [["", "slow"], ["slow"]]

    assert bench.waits[2:] == [[]] * (not waits)
    assert bench.store({2: -0.1}, camera="a", after=1).late == 0


def test_backlogs_are_stored_as_they_come_and_learned_by_time(bench: IntakeBench) -> None:
    for camera in ("a", "b"):
        bench.hello(camera)
    bench.send("a", times={1: -100.0, 2: -80.0, 3: -60.0}, more=3)
    bench.send("b", times={1: -90.0, 2: -70.0}, more=0)
    bench.tick(5.1)
    bench.send("a", after=3, times={4: -50.0, 5: -40.0})
    bench.tick(5.1)

    assert [camera for _, camera, _ in bench.stored] == ["a", "a", "a", "b", "b", "a", "a"]
    assert bench.intake.counts["late"] == 0
    assert bench.waits == [["", "a"], []]


def test_backlogs_of_a_single_batch_are_learned_by_time(bench: IntakeBench) -> None:
    """As after an outage of a minute, from which cameras come back one after the other."""
    for n, camera in enumerate("abc"):
        bench.hello(camera)
        bench.send(camera, times={seq: 10.0 * seq - 61.0 - n for seq in range(1, 7)})
        bench.tick(1.0)
    bench.tick(5.1)

    assert bench.intake.counts["stored"] == 18
    assert bench.intake.counts["late"] == 0


def test_a_camera_that_was_away_alone_is_not_waited_for(bench: IntakeBench) -> None:
    bench.hello("a")
    bench.hello("b")
    bench.store({1: -0.1}, camera="b")
    bench.tick(100.0)
    bench.store({2: -0.1}, camera="b", after=1)

    assert bench.store({1: -90.0}, more=100).late == 1
    assert bench.waits == []


def test_three_hundred_cameras_come_back_at_once(bench: IntakeBench) -> None:
    names = [f"c{number}" for number in range(300)]
    bench.intake.alive |= {*names, *(f"other{number}" for number in range(700))}
    batch = {name: bench.hello(name).batch for name in names}
    backlog = [seq - 61.0 for seq in range(1, 61)]  # one event a second, of the last minute
    start = bench.wall
    stored = dict.fromkeys(names, 0)
    under_way: dict[str, Request] = {}

    turns = 0
    while min(stored.values()) < len(backlog):
        turns += 1
        assert turns < 50
        for name in names:
            after = stored[name]
            if name not in under_way and after < len(backlog):
                times = backlog[after : after + batch[name]]
                events = [(after + n, event_bytes(name, start + t)) for n, t in enumerate(times, 1)]
                more = len(backlog) - after - len(events)
                under_way[name] = Request()
                content = codec.to_msgpack(Batch("h1", "b1", after, events, more))
                bench.intake.inbox.on_request(f"store/{name}", content, under_way[name].reply)
        bench.tick(0.5)
        for name, sent in list(under_way.items()):
            if sent.answer is not None:
                stored[name] = sent.answer.have.get("b1", stored[name])
                batch[name] = sent.answer.batch
                del under_way[name]

    assert bench.intake.counts["stored"] == 18_000
    assert bench.intake.counts["late"] == 0
    assert turns < 40


# --- operators' commands --------------------------------------------------------------------------


def test_events_wait_until_they_are_stored(
    bench: IntakeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A command is stored after the events that were received before it."""
    waiting: list[int] = []
    pause = "camtopod.serve.ingest.store_queue.time.sleep"
    monkeypatch.setattr(pause, lambda _: waiting.append(bench.intake.queue.waiting))
    bench.hello()
    bench.store({1: -3})
    assert waiting
    assert 0 not in waiting
    assert bench.intake.queue.waiting == 0


def test_events_are_heard_while_a_command_is_stored(
    bench: IntakeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are stored after it: those of the camera that it forgets are refused."""
    bench.hello()
    bench.store({1: -3})
    bench.publish("b")
    store_command = bench.intake.writer.store_command

    def slow(entry: Entry, meta: Mapping[str, str]) -> None:
        bench.publish("a", kind="exit", spooled=True, boot="b1", seq=2)
        bench.publish("b", kind="exit")
        bench.publish("c")
        assert bench.intake.queue.waiting == 0
        store_command(entry, meta)

    monkeypatch.setattr(bench.intake.writer, "store_command", slow)
    execute(bench.intake, Forget("b"), None, lambda: Reset(bench.wall), lambda _: None)
    bench.work()

    assert [(event.camera, event.kind) for event in bench.heard[2:]] == [
        ("a", "exit"),
        ("b", "exit"),
        ("c", "entry"),
    ]
    assert [row[:2] for row in bench.stored] == [
        ("event", "a"),
        ("event", "b"),
        ("command", ""),
        ("event", "c"),
    ]
    assert bench.intake.names.refusals == {"b": 1}


def test_requests_wait_quietly_while_a_command_is_stored(bench: IntakeBench) -> None:
    """The intake neither turns on them, nor leaves entries unmatched for them."""
    intake = bench.intake
    bench.hello()
    content = codec.to_msgpack(Batch("h1", "b1", 0, [(1, event_bytes("a", bench.wall))], 0))
    intake.inbox.on_request("store/a", content, Request().reply)
    assert intake._is_busy()
    intake.is_storing_command = True
    intake.step()
    assert intake.inbox.has_request("a")
    assert not intake._is_busy()
    intake.inbox.on_event("event/c", event_bytes("c", bench.wall))
    assert intake._is_busy()
    intake.step()
    assert [event.camera for event in bench.heard] == ["c"]

    intake.is_storing_command = False
    bench.work()
    assert [row[:2] for row in bench.stored] == [("event", "c"), ("event", "a")]


def test_the_status_does_not_need_a_camera_that_makes_room_for_another(bench: IntakeBench) -> None:
    """It is asked for in another thread, between any two steps of which the camera may go."""

    class Fleeting(dict[str, cameras.CameraIntake]):
        def __contains__(self, name: object) -> bool:
            return super().pop(str(name), None) is not None

    bench.publish("a")
    bench.intake.cameras._cameras = Fleeting(bench.intake.cameras._cameras)
    assert bench.intake.cameras.status()["a"].events == 1
