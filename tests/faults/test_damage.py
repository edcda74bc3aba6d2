"""Flipped bits in the files of journal and spool: nothing wrong is read, and no loss is silent."""

from __future__ import annotations

import collections
import contextlib
import random
from pathlib import Path
from typing import NamedTuple

import pytest
from sizes import size
from written import CAMERAS, EPOCH

from camtopod import codec
from camtopod.records import Event
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.storage.journal import Entry, Journal, Snapshot, StoredVersion
from camtopod.serve.storage.sqlite_file import StateError

STEPS = 60
ROWS = STEPS + STEPS // 5 + 2


class Content(NamedTuple):
    """What can be read of a file: name of a row -> its content; and whether damage was reported."""

    rows: dict[object, object]
    reported: bool


@pytest.fixture
def files(quick_path: Path) -> Path:
    """Return a directory with a journal and a spool that were closed properly."""
    chance = random.Random(1)
    journal = Journal(quick_path)
    spool = Spool(quick_path / "spool.db", "boot-1", 10_000)
    for number in range(1, STEPS + 1):
        event = spool.append([Event(CAMERAS[number % len(CAMERAS)], "entry", 60.0 * number)])[0]
        entry = Entry("event", event.camera, event.boot, event.seq, codec.to_msgpack(event))
        version = StoredVersion(EPOCH, number, f"sha256:{number}", chance.randbytes(600))
        snapshot = Snapshot(len(journal), EPOCH, chance.randbytes(5000))
        journal.commit(
            [entry], [version] if number % 5 == 0 else [], snapshot if number % 30 == 0 else None
        )
    journal.close()
    spool.close()
    return quick_path


def journal_content(directory: Path) -> Content:
    """Read a journal as the daemon does."""
    with contextlib.closing(Journal(directory)) as journal:
        entries = dict(journal.entries())
        versions = {
            f"version {number}": journal.version(EPOCH, number)
            for number in journal.versions(EPOCH)
        }
        snapshots = {f"snapshot {one.position}": one for one in journal.snapshots()}
        reported = journal.set_aside is not None or None in entries.values()
    rows = entries | versions | snapshots
    return Content({name: row for name, row in rows.items() if row is not None}, reported)


def spool_content(directory: Path) -> Content:
    """Read a spool as the next grabber does."""
    rows: dict[object, object] = {}
    with contextlib.closing(Spool(directory / "spool.db", "boot-2", 10_000)) as spool:
        for camera in CAMERAS:
            _, events = spool.queue().next_batch(camera, 10_000) or ("", [])
            rows |= {(camera, seq): raw for seq, raw in events}
        reported = spool.statistics()["damaged_files"] > 0
    return Content(rows, reported)


def flip(
    name: str, files: Path, count: int, seed: int, caplog: pytest.LogCaptureFixture
) -> collections.Counter[str]:
    """Flip ``count`` single bits of a file, each in a copy; return what came of them."""
    read = journal_content if name == "journal.db" else spool_content
    original = (files / name).read_bytes()
    before = read(files)
    assert not before.reported
    assert len(before.rows) == (ROWS if name == "journal.db" else STEPS)

    chance = random.Random(seed)
    outcomes: collections.Counter[str] = collections.Counter()
    for _ in range(count):
        for path in files.iterdir():
            path.unlink()
        content = bytearray(original)
        content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
        (files / name).write_bytes(content)
        caplog.clear()
        try:
            after = read(files)
        except StateError:
            outcomes["refused"] += 1
            continue
        if not after.rows.items() <= before.rows.items():
            outcomes["wrong"] += 1
        elif len(after.rows) == len(before.rows):
            outcomes["same"] += 1
        else:
            outcomes["reported" if after.reported or caplog.records else "silent"] += 1
    return outcomes


@pytest.mark.parametrize("name", ["journal.db", "spool.db"])
def test_flipped_bits_are_never_silent(
    name: str, files: Path, caplog: pytest.LogCaptureFixture
) -> None:
    outcomes = flip(name, files, 40, 2, caplog)

    assert set(outcomes) <= {"same", "reported"}
    assert outcomes["reported"] > 0


@pytest.mark.campaign
@pytest.mark.timeout(7200)
@pytest.mark.parametrize("name", ["journal.db", "spool.db"])
def test_campaign_of_flipped_bits(name: str, files: Path, caplog: pytest.LogCaptureFixture) -> None:
    outcomes = flip(name, files, size("FLIPS", 10_000) // 2, 4, caplog)

    print(f"{name}: {outcomes}")
    assert set(outcomes) <= {"same", "reported"}


def test_without_checksums_damage_would_be_silent(
    files: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The canary: entries of which the checksum is not compared."""
    with contextlib.closing(Journal(files)) as journal:
        before = dict(journal.entries())
        journal._db.execute("UPDATE entry SET raw = x'00' WHERE id = 3")
        monkeypatch.setattr("camtopod.serve.storage.journal.sound", bool)
        assert dict(journal.entries())[3] not in (None, before[3])
