"""The spool: events stay, once and in order; limits hold, and damage is noticed."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from serving import Failing

from camtopod import codec
from camtopod.config import Limits
from camtopod.records import Event
from camtopod.serve.outbox import spool_files
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.outbox.spool_files import open_ingest_spool, open_spool, spool_path
from camtopod.serve.requests import BATCH_BYTES_MAX
from camtopod.serve.storage import sqlite_file
from camtopod.serve.storage.sqlite_file import StateError


def events(count: int, camera: str = "lobby", start: int = 0) -> list[Event]:
    return [Event(camera, "entry", float(t)) for t in range(start, start + count)]


def seqs(spool: Spool, camera: str = "lobby", most: int = 10_000) -> tuple[str, list[int]]:
    """Return boot and numbers of the next batch; of none, no boot."""
    batch = spool.queue().next_batch(camera, most)
    return ("", []) if batch is None else (batch[0], [seq for seq, _ in batch[1]])


@pytest.fixture
def spool(tmp_path: Path) -> Iterator[Spool]:
    with contextlib.closing(Spool(tmp_path / "spool.db", "b1", 1000)) as opened:
        yield opened


def reopened(spool: Spool, boot: str = "b2") -> Spool:
    spool.close()
    return Spool(spool.path, boot, 1000)


def test_each_camera_is_counted_from_one(spool: Spool) -> None:
    numbered = spool.append([*events(1), *events(1, "hall"), *events(1, start=1)])

    assert [(one.camera, one.boot, one.seq) for one in numbered] == [
        ("lobby", "b1", 1),
        ("hall", "b1", 1),
        ("lobby", "b1", 2),
    ]
    batch = spool.queue().next_batch("lobby", 10)
    assert batch is not None
    assert [codec.event_from_msgpack(raw) for _, raw in batch[1]] == [numbered[0], numbered[2]]


def test_a_new_boot_begins_with_each_opening_and_older_ones_come_first(spool: Spool) -> None:
    spool.append(events(2))

    with contextlib.closing(reopened(spool)) as again:
        assert [(one.boot, one.seq) for one in again.append(events(1))] == [("b2", 1)]
        assert again.queue().boots("lobby") == ["b1", "b2"]
        assert (again.waiting(), again.waiting(own=True)) == (3, 1)
        assert seqs(again) == ("b1", [1, 2])
        again.queue().have("lobby", "b1", 2)
        assert seqs(again) == ("b2", [1])


def test_a_batch_has_so_many_events_and_bytes_of_one_boot(spool: Spool) -> None:
    spool.append(events(10))
    assert seqs(spool, most=3) == ("b1", [1, 2, 3])

    wide = [Event("hall", "entry", 1.0, track="\N{CAMERA}" * 128) for _ in range(300)]
    spool.append(wide)
    batch = spool.queue().next_batch("hall", 500)
    assert batch is not None
    size = sum(len(raw) for _, raw in batch[1])
    assert BATCH_BYTES_MAX - 1000 < size <= BATCH_BYTES_MAX


def test_marks_go_forwards_and_backwards_and_survive_closing(spool: Spool) -> None:
    spool.append(events(5))
    spool.queue().have("lobby", "b1", 4)
    assert (spool.queue().waiting("lobby"), seqs(spool)) == (1, ("b1", [5]))
    spool.queue().have("lobby", "b1", 1)
    assert (spool.queue().waiting("lobby"), seqs(spool)) == (4, ("b1", [2, 3, 4, 5]))
    spool.queue().have("lobby", "of nobody", 7)
    spool.queue().have("lobby", "b1", 3)

    with contextlib.closing(reopened(spool)) as again:
        assert (again.queue().mark("lobby", "b1"), seqs(again)) == (3, ("b1", [4, 5]))


def test_numbers_of_their_own_stay_if_they_rise_and_count_once(spool: Spool) -> None:
    def own(seq: int) -> Event:
        return Event("lobby", "entry", float(seq), boot="theirs", seq=seq)

    assert spool.append([own(7), own(7), own(9)]) == [own(7), own(9)]
    assert spool.append([own(9)]) == []
    assert [(one.boot, one.seq) for one in spool.append([own(8)])] == [("b1", 1)]
    assert [(one.boot, one.seq) for one in spool.append([own(0)])] == [("b1", 2)]

    with contextlib.closing(reopened(spool)) as again:
        assert again.append([own(7), own(8), own(9), own(10)]) == [own(8), own(10)]
        assert again.waiting(own=True) == 4, "all of that boot are of this process now"


def test_what_is_stored_already_does_not_wait_when_it_comes_again(tmp_path: Path) -> None:
    recording = [Event("lobby", "entry", float(n), boot="file", seq=n) for n in range(1, 101)]
    with contextlib.closing(Spool(tmp_path / "spool.db", "b1", 1000, kept_max=10)) as spool:
        spool.append(recording)
        spool.queue().have("lobby", "file", 100)
        spool.append(events(1))
        assert spool.statistics()["kept"] == 10

    with contextlib.closing(Spool(tmp_path / "spool.db", "b2", 1000)) as again:
        again.append(recording[:50])
        assert again.waiting() == 1


def test_what_the_daemon_would_reject_is_refused_with_the_reason(
    spool: Spool, caplog: pytest.LogCaptureFixture
) -> None:
    wrong = [Event("lobby", "entry", float("nan")), Event("lobby", "entry", 1.0, x=0.5)]

    assert [one.seq for one in spool.append([*wrong, *events(1)])] == [1]
    assert spool.statistics()["refused"] == 2
    assert "half-position" in caplog.text


def test_another_boot_begins_with_what_waits(spool: Spool) -> None:
    spool.append(events(5))
    spool.append(events(2, "hall"))
    spool.queue().have("lobby", "b1", 2)

    spool.queue().begin_boot("lobby", "b2")

    assert spool.queue().boots("lobby") == ["b1", "b2"]
    batch = spool.queue().next_batch("lobby", 10)
    assert batch is not None
    found = [codec.event_from_msgpack(raw) for _, raw in batch[1]]
    assert [(one.boot, one.seq, one.t) for one in found] == [
        ("b2", 1, 2.0),
        ("b2", 2, 3.0),
        ("b2", 3, 4.0),
    ]
    assert spool.append(events(1))[0].seq == 6, "rows are not numbered anew"
    assert seqs(spool) == ("b2", [1, 2, 3, 4])
    assert seqs(spool, "hall") == ("b1", [1, 2])


# --- limits ---------------------------------------------------------------------------------------


def test_the_newest_stored_events_of_a_camera_are_kept(tmp_path: Path) -> None:
    with contextlib.closing(Spool(tmp_path / "spool.db", "b1", 1000, kept_max=80)) as spool:
        spool.append(events(1, "hall"))
        spool.queue().have("hall", "b1", 1)
        for start in range(0, 300, 10):
            spool.append(events(10, start=start))
            spool.queue().have("lobby", "b1", start + 10)

        assert 80 < spool.statistics()["kept"] <= 101
        spool.queue().have("lobby", "b1", 0)
        assert seqs(spool)[1][-1] == 300
        spool.queue().have("hall", "b1", 0)
        assert seqs(spool, "hall") == ("b1", [1])


def test_a_full_spool_drops_stored_events_first_then_the_oldest_and_says_so(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with contextlib.closing(Spool(tmp_path / "spool.db", "b1", 20)) as spool:
        spool.append(events(5, "hall"))
        spool.append(events(15))
        spool.queue().have("lobby", "b1", 10)
        spool.append(events(8))
        assert (spool.dropped, spool.waiting(), spool.statistics()["kept"]) == (0, 18, 2)

        spool.append(events(4))
        assert (spool.dropped, spool.waiting(), spool.statistics()["kept"]) == (2, 20, 0)
        assert seqs(spool, "hall") == ("b1", [3, 4, 5])
        spool.append(events(4))
    assert caplog.text.count("is full: its oldest events are dropped") == 1


def test_a_spool_that_is_full_by_bytes_stays_small(tmp_path: Path) -> None:
    bytes_max = 400_000
    with contextlib.closing(Spool(tmp_path / "spool.db", "b1", 10**6, bytes_max)) as spool:
        for start in range(0, 20_000, 500):
            spool.append(events(500, start=start))

        assert spool.path.stat().st_size < bytes_max + 200_000
        assert 1000 < spool.waiting() == 20_000 - spool.dropped
        first = spool.dropped + 1
        assert seqs(spool, most=5) == ("b1", list(range(first, first + 5)))


# --- faults ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("durable", [False, True])
def test_an_append_that_raises_is_repeated(spool: Spool, durable: bool) -> None:
    spool.append(events(1))
    spool._db = Failing(spool._db, durable)  # type: ignore[assignment]
    with pytest.raises(sqlite3.OperationalError):
        spool.append(events(2, start=1))

    assert [one.seq for one in spool.append(events(3, start=1))] == [2, 3, 4]
    assert (spool.waiting(), seqs(spool)) == (4, ("b1", [1, 2, 3, 4]))


@pytest.mark.parametrize(
    ("change", "left"),
    [
        ("UPDATE event SET seq = 7 WHERE seq = 2", [1, 3, 4, 5]),
        ("UPDATE event SET raw = x'00' WHERE seq = 5", [1, 2, 3, 4]),
        ("UPDATE event SET boot = CAST(x'62c328' AS TEXT) WHERE seq = 1", [2, 3, 4, 5]),
    ],
)
def test_a_damaged_event_is_left_out_and_logged_once(
    change: str, left: list[int], spool: Spool, caplog: pytest.LogCaptureFixture
) -> None:
    spool.append(events(5))
    spool._db.execute(change)

    with contextlib.closing(reopened(spool)) as again:
        batches = []
        while (batch := seqs(again))[1]:
            batches += batch[1]
            again.queue().have("lobby", *(batch[0], batch[1][-1]))
        assert batches == left
        assert again.waiting() == 0
    assert caplog.text.count("1 events of lobby are damaged") == ("boot" not in change)


def test_a_damaged_file_is_set_aside_and_what_can_be_read_goes_on(
    spool: Spool, caplog: pytest.LogCaptureFixture
) -> None:
    for start in range(0, 900, 100):
        spool.append(events(100, start=start))
    spool.queue().have("lobby", "b1", 10)
    spool.close()
    content = bytearray(spool.path.read_bytes())
    middle = len(content) // 2 // 4096 * 4096
    content[middle : middle + 4096] = bytes(4096)
    spool.path.write_bytes(content)

    with contextlib.closing(Spool(spool.path, "b2", 1000)) as again:
        assert again.path.with_name("spool.db.damaged-1").read_bytes() == content
        left = again.waiting()
        assert 700 < left < 890
        assert again.queue().mark("lobby", "b1") == 10
        assert again.append(events(1))[0].seq == 1
    assert "is damaged" in caplog.text
    with contextlib.closing(Spool(spool.path, "b3", 1000)) as once_more:
        assert once_more.waiting() == left + 1


def test_a_disk_that_damages_every_file_is_not_filled_up(tmp_path: Path) -> None:
    path = tmp_path / "spool.db"
    for _ in range(sqlite_file.DAMAGED_FILES_MAX):
        path.write_bytes(b"rubbish " * 1000)
        Spool(path, "b", 10).close()
    path.write_bytes(b"rubbish " * 1000)

    with pytest.raises(StateError, match="check the disk"):
        Spool(path, "b", 10)
    assert path.read_bytes() == b"rubbish " * 1000


def test_it_is_nobody_elses_to_read_or_open(tmp_path: Path) -> None:
    path = tmp_path / "new" / "state" / "spool.db"
    with contextlib.closing(Spool(path, "b", 10)) as spool:
        spool.append(events(1))
        assert path.parent.stat().st_mode & 0o777 == 0o700
        modes = {one.name: one.stat().st_mode & 0o777 for one in path.parent.iterdir()}
        names = ("spool.db", "spool.db-shm", "spool.db-wal", "spool.lock")
        assert modes == dict.fromkeys(names, 0o600)
        with pytest.raises(StateError, match="held by another"):
            Spool(path, "b", 10)
    path.chmod(0o644)
    Spool(path, "b", 10).close()
    assert path.stat().st_mode & 0o777 == 0o600


# --- the files of a site --------------------------------------------------------------------------


def test_ingest_takes_a_free_spool_and_what_ended_processes_left(tmp_path: Path) -> None:
    limits = Limits()
    with contextlib.closing(open_spool(tmp_path, "hq", "lobby", limits)) as grabber:
        grabber.append(events(1))
    first = open_ingest_spool(tmp_path, "hq", limits)
    second = open_ingest_spool(tmp_path, "hq", limits)
    assert first.path != second.path
    numbered = second.append(events(3))
    second.queue().have("lobby", str(numbered[0].boot), 1)
    second.close()
    elsewhere = open_ingest_spool(tmp_path, "other", limits)
    assert elsewhere.waiting() == 0
    elsewhere.close()
    first.close()

    with contextlib.closing(open_ingest_spool(tmp_path, "hq", limits)) as third:
        assert third.path == first.path
        assert seqs(third) == (numbered[0].boot, [2, 3])
        assert third.waiting(own=True) == 0
    assert not second.path.exists()
    assert spool_path(tmp_path, "hq", "lobby").exists(), "that is the grabber's"


def test_ingest_takes_another_spool_while_one_is_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another process that looks for ended ones has the lock of the first one for a moment."""
    limits = Limits()
    open_ingest_spool(tmp_path, "hq", limits).close()
    look = sqlite_file.Lock(spool_path(tmp_path, "hq", "ingest").with_suffix(".lock"))
    attempts = []

    def open_while_locked(directory: Path, site: str, name: str, *others: Any) -> Spool:
        attempts.append(name)
        try:
            return open_spool(directory, site, name, *others)
        finally:
            look.close()

    monkeypatch.setattr(spool_files, "open_spool", open_while_locked)
    with contextlib.closing(open_ingest_spool(tmp_path, "hq", limits)) as spool:
        assert spool.path == spool_path(tmp_path, "hq", "ingest@2")
    assert attempts == ["ingest", "ingest@2"]


def test_a_spool_that_another_process_takes_at_the_last_moment_is_no_reason_to_warn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    limits = Limits()
    first = open_ingest_spool(tmp_path, "hq", limits)
    second = open_ingest_spool(tmp_path, "hq", limits)
    first.close()
    second.close()
    adopt = Spool.adopt
    locks = []

    def adopt_too_late(spool: Spool, path: Path) -> None:
        locks.append(sqlite_file.Lock(path.with_suffix(".lock")))
        adopt(spool, path)

    monkeypatch.setattr(Spool, "adopt", adopt_too_late)
    open_ingest_spool(tmp_path, "hq", limits).close()

    assert len(locks) == 1
    assert second.path.exists()
    assert caplog.text == ""
    locks[0].close()
