"""The spool: what is committed stays, once, in order, and damage is noticed."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path

import pytest
from serving import Failing

from camtopod import codec
from camtopod.records import Event
from camtopod.serve.database import StateError
from camtopod.serve.journal import Entry, Journal, StoredVersion
from camtopod.serve.spool import Spool


def event(number: int, camera: str = "lobby") -> Event:
    return Event(camera, "entry", float(number))


@pytest.fixture
def spool(tmp_path: Path) -> Iterator[Spool]:
    one = Spool(tmp_path / "spool.db", "boot-1", events_max=1000)
    yield one
    one.close()


# --- spool ----------------------------------------------------------------------------------------


def test_the_spool_counts_each_camera_without_gaps(spool: Spool) -> None:
    out = spool.append([event(1), event(2, "hall"), event(3)])
    assert [(one.camera, one.boot, one.seq) for one in out] == [
        ("lobby", "boot-1", 1),
        ("hall", "boot-1", 1),
        ("lobby", "boot-1", 2),
    ]
    batch = spool.batch("lobby", "boot-1", 0, 10)
    assert [codec.event_from_pack(raw) for _, raw in batch.events] == [out[0], out[2]]
    assert (batch.boot, batch.first, batch.more, batch.dropped) == ("boot-1", 1, False, 0)


def test_what_is_acknowledged_is_gone_and_the_count_goes_on(spool: Spool, tmp_path: Path) -> None:
    spool.append([event(n) for n in range(5)])
    spool.ack("lobby", "boot-1", 3)
    assert len(spool) == 2
    assert [seq for seq, _ in spool.batch("lobby", "boot-1", 4, 10).events] == [4, 5]
    spool.ack("lobby", "other boot", 99)
    spool.ack("lobby", "boot-1", 2)
    assert len(spool) == 2
    spool.ack("lobby", "boot-1", 5)
    spool.close()
    again = Spool(tmp_path / "spool.db", "boot-2", events_max=1000)
    assert again.boot == "boot-1", "a spool that was closed keeps its boot, so that its count goes on"
    assert len(again) == 0
    assert again.append([event(6)])[0].seq == 6
    assert again.batch("lobby", "boot-1", 6, 10).first == 6
    again.close()


def test_an_empty_spool_says_where_it_will_begin(spool: Spool) -> None:
    assert spool.batch("lobby", None, 0, 10).first == 1
    spool.append([event(1), event(2)])
    spool.ack("lobby", "boot-1", 2)
    batch = spool.batch("lobby", "boot-1", 3, 10)
    assert (batch.first, batch.events, batch.acked) == (3, [], 2)


def test_batches_are_bounded_and_go_on(spool: Spool) -> None:
    spool.append([event(n) for n in range(25)])
    seqs: list[int] = []
    start, more = 0, True
    while more:
        batch = spool.batch("lobby", "boot-1", start, 10)
        assert len(batch.events) <= 10
        seqs += [seq for seq, _ in batch.events]
        start, more = seqs[-1] + 1, batch.more
    assert seqs == list(range(1, 26))


def test_an_event_with_its_own_boot_and_seq_keeps_them_and_is_spooled_once(spool: Spool) -> None:
    own = Event("lobby", "entry", 1.0, boot="theirs", seq=77)
    assert spool.append([own, own]) == [own, own]
    assert len(spool) == 1
    spool.append([event(2)])
    assert [seq for seq, _ in spool.batch("lobby", "theirs", 0, 10).events] == [77]
    assert [seq for seq, _ in spool.batch("lobby", "theirs", 0, 10).events] == [1], "by turns"
    assert [seq for seq, _ in spool.batch("lobby", "theirs", 0, 10).events] == [77]
    assert spool.batch("lobby", "unknown", 5, 10).boot == "theirs", "the oldest that waits"
    spool.ack("lobby", "theirs", 77)
    assert len(spool) == 1


def test_a_full_spool_drops_the_oldest_and_says_so(tmp_path: Path) -> None:
    spool = Spool(tmp_path / "small.db", "b", events_max=10)
    spool.append([event(n) for n in range(8)])
    spool.append([event(n) for n in range(8)])
    assert len(spool) == 10
    batch = spool.batch("lobby", "b", 0, 100)
    assert [seq for seq, _ in batch.events] == list(range(7, 17))
    assert (batch.first, batch.dropped, spool.dropped) == (7, 6, 6)
    spool.close()


def test_a_spool_has_one_process(spool: Spool, tmp_path: Path) -> None:
    with pytest.raises(StateError, match="held by another"):
        Spool(tmp_path / "spool.db", "b", events_max=10)


@pytest.mark.parametrize("durable", [False, True])
def test_an_append_that_raises_may_be_repeated(spool: Spool, durable: bool) -> None:
    spool.append([event(1)])
    spool._db = Failing(spool._db, durable)  # type: ignore[assignment]
    with pytest.raises(sqlite3.OperationalError):
        spool.append([event(2), event(3)])
    assert [one.seq for one in spool.append([event(2), event(3)])] == [2, 3]
    assert [seq for seq, _ in spool.batch("lobby", None, 0, 10).events] == [1, 2, 3]
    spool.ack("lobby", "boot-1", 3)
    assert len(spool) == 0
