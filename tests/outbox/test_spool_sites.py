"""A spool of several sites: each has marks, names and drops of its own, over the same rows."""

from __future__ import annotations

import contextlib
import sqlite3
from pathlib import Path
from typing import Any

import pytest
from serving import Failing

from camtopod import codec
from camtopod.records import Event
from camtopod.serve.outbox.site_queue import SiteQueue
from camtopod.serve.outbox.spool import Spool

SITES = {"gate": ("north", "south"), "yard": ("north",)}


def opened(folder: Path, boot: str = "b1", most: int = 1000, kept: int = 10_000) -> Spool:
    return Spool(
        folder / "spool.db", boot, most, kept_max=kept, sites_of=lambda camera: SITES[camera]
    )


def killed(spool: Spool) -> None:
    spool._db.close()
    spool._lock.close()


def events(count: int, camera: str = "gate", start: int = 0) -> list[Event]:
    return [Event(camera, "entry", float(t)) for t in range(start, start + count)]


def batch(spool: Spool, site: str = "", camera: str = "gate") -> tuple[str, list[int], list[float]]:
    """Return boot, numbers and times of what is sent next to a site; the events say the same."""
    boot, pairs = spool.queue(site).next_batch(camera, 100) or ("", [])
    found = [codec.event_from_msgpack(raw) for _, raw in pairs]
    assert [(one.boot, one.seq) for one in found] == [(boot, seq) for seq, _ in pairs]
    return boot, [seq for seq, _ in pairs], [one.t for one in found]


def test_each_site_goes_on_from_its_own_mark(tmp_path: Path) -> None:
    with contextlib.closing(opened(tmp_path)) as spool:
        spool.append([*events(5), *events(2, "yard")])
        spool.queue().have("gate", "b1", 5)
        spool.queue("south").have("gate", "b1", 2)

        assert (spool.queue().waiting(), spool.queue("south").waiting()) == (2, 3)
        assert spool.waiting() == 5, "two of yard wait for its owner, three of gate for another"
        assert spool.queue("south").cameras() == ["gate"]
        assert batch(spool)[1] == []
        assert batch(spool, "south") == ("b1", [3, 4, 5], [2.0, 3.0, 4.0])
        spool.queue("south").have("gate", "b1", 0)
        assert len(batch(spool, "south")[1]) == 5
        assert batch(spool)[1] == []
        spool.queue("south").have("gate", "b1", 4)

    with contextlib.closing(opened(tmp_path, "b2")) as again:
        assert (again.queue().waiting("gate"), again.queue("south").waiting("gate")) == (0, 1)
        assert again.queue("south").mark("gate", "b1") == 4


@pytest.mark.parametrize("dies", [False, True])
def test_a_new_boot_at_one_site_is_a_name_there_and_renumbers_nothing(
    dies: bool, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    spool = opened(tmp_path)
    spool.append(events(5))
    spool.queue().have("gate", "b1", 4)
    spool.queue("south").have("gate", "b1", 2)
    spool.append([])  # writes the marks
    rows = spool._db.execute("SELECT * FROM event").fetchall()

    spool.queue("south").begin_boot("gate", "s1")

    assert "a new boot begins" in caplog.text
    assert spool._db.execute("SELECT * FROM event").fetchall() == rows
    (sixth,) = spool.append(events(1, start=5))
    assert (sixth.boot, sixth.seq) == ("b1", 6)
    assert spool.queue().numbered(sixth) == sixth
    assert (named := spool.queue("south").numbered(sixth)).boot == "s1"
    assert named.seq == 4
    foreign = Event("gate", "exit", 9.0, boot="file", seq=7)
    assert spool.queue("south").numbered(foreign) == foreign

    def check(spool: Spool) -> None:
        assert batch(spool) == ("b1", [5, 6], [4.0, 5.0])
        assert batch(spool, "south") == ("s1", [1, 2, 3, 4], [2.0, 3.0, 4.0, 5.0])
        assert spool.queue("south").waiting() == 4

    check(spool)
    spool.queue("south").have("gate", "b1", 9)  # which another life of the machine has sent
    check(spool)
    if dies:
        killed(spool)
    else:
        spool.close()

    with contextlib.closing(opened(tmp_path, "b2")) as again:
        check(again)
        assert again.queue().boots("gate") == ["b1", "b2"]
        assert again.queue("south").boots("gate") == ["b1", "s1", "b2"]
        again.queue("south").have("gate", "s1", 3)
        assert batch(again, "south") == ("s1", [4], [5.0])
        again.queue("south").have("gate", "b1", 1)
        assert batch(again, "south") == ("b1", [2], [1.0]), "an older journal asks for the old name"
        assert batch(again)[1] == [5, 6]


def test_only_what_all_sites_have_is_deleted_first_and_drops_are_of_a_site(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with contextlib.closing(opened(tmp_path, most=20)) as spool:
        spool.append([*events(15), *events(5, "yard")])
        spool.queue().have("gate", "b1", 15)
        spool.queue("south").have("gate", "b1", 10)
        spool.append(events(10, start=15))
        assert (spool.dropped, len(batch(spool, "south")[1])) == (0, 15)

        spool.append(events(3, "yard"))
        assert (spool.queue().dropped, spool.queue("south").dropped) == (0, 3)
        assert batch(spool, "south")[1] == [*range(14, 26)]
        assert batch(spool, camera="yard")[1] == [*range(1, 9)]
        spool.append(events(4, "yard"))
        assert (spool.queue().dropped, spool.queue("south").dropped) == (2, 5), "two of yard"
    assert caplog.text.count("site south: the spool") == 1


def test_the_kept_events_are_those_that_every_site_has(tmp_path: Path) -> None:
    with contextlib.closing(opened(tmp_path, kept=80)) as spool:
        for start in range(0, 300, 10):
            spool.append(events(10, start=start))
            spool.queue().have("gate", "b1", start + 10)
        assert len(batch(spool, "south")[1]) == 100
        assert spool.queue("south").waiting() == 300
        spool.queue("south").have("gate", "b1", 300)
        spool.append(events(10, start=300))
        assert spool.statistics()["kept"] == 80


def test_a_site_that_is_added_gets_what_is_kept_and_one_that_left_holds_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with contextlib.closing(opened(tmp_path, kept=10)) as spool:
        spool.append(events(30))
        spool.queue().have("gate", "b1", 30)
    monkeypatch.setitem(SITES, "gate", ("north",))
    with contextlib.closing(opened(tmp_path, "b2", kept=10)) as alone:
        assert alone.waiting() == 0
        alone.append(events(1, "yard"))
        assert alone.statistics()["kept"] == 10
    monkeypatch.setitem(SITES, "gate", ("north", "west"))
    with contextlib.closing(opened(tmp_path, "b3", kept=10)) as wider:
        assert batch(wider)[1] == []
        assert batch(wider, "west")[1] == [*range(21, 31)]


@pytest.mark.parametrize("durable", [False, True])
def test_an_append_that_raises_leaves_no_site_behind(durable: bool, tmp_path: Path) -> None:
    with contextlib.closing(opened(tmp_path, kept=1)) as spool:
        good = spool._db
        spool._db = Failing(good, durable)  # type: ignore[assignment]
        with pytest.raises(sqlite3.OperationalError):
            spool.append(events(150))
        spool._db = good
        spool.append(events(150))
        assert batch(spool, "south")[1] == batch(spool)[1] == [*range(1, 101)]


class Joining(SiteQueue):
    """A queue: while its drops are read, another thread joins a further site."""

    def __getattribute__(self, name: str) -> Any:
        if name == "dropped":
            self._spool.queue("south")
        return super().__getattribute__(name)


def test_drops_are_counted_while_a_site_is_joined(tmp_path: Path) -> None:
    with contextlib.closing(opened(tmp_path)) as spool:
        spool._queues[""] = Joining(spool, "")
        assert spool.dropped == 0
