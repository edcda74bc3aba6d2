"""Files that are cut or have flipped bits: losses are noticed, and refilled from the spool.

Damage must not be silent. It is not silent if the file is set aside, if the log reports it, or if a
grabber reports that more was acknowledged than the journal has.
"""

from __future__ import annotations

import collections
import contextlib
import logging
import random
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import pytest
from powercut import Content, put
from sizes import size
from written import CAMERAS, EPOCH, KEEP

from camtopod import codec
from camtopod.records import Event
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.storage import wal_check
from camtopod.serve.storage.journal import Entry, Journal, Snapshot, StoredVersion
from camtopod.serve.storage.sqlite_file import StateError

STEPS = 90
SNAPSHOT_BYTES = 5000
Key = tuple[str, str | None, int | None]


class Found(NamedTuple):
    """Final content of the files; ``said``: all reports of damage."""

    events: dict[Key, bytes]
    versions: dict[int, bytes | None]
    snapshots: list[Snapshot]
    said: list[str]


class Before(NamedTuple):
    """Files as a kill leaves them, their content, and where in the log the last transaction is."""

    content: Content
    found: Found
    last: range
    snapshots: list[Snapshot]
    """All that there have ever been: when the newest is lost, an older one is there again."""


class Installation(NamedTuple):
    """A journal and the spool it was filled from; the grabber still runs."""

    journal: Before
    spool: Before
    grabber: Spool


@contextmanager
def said() -> Iterator[list[str]]:
    """Collect the program's log from the level warning up."""
    lines: list[str] = []
    handler = logging.Handler(logging.WARNING)
    handler.emit = lambda record: lines.append(record.getMessage())  # type: ignore[method-assign]
    logger = logging.getLogger("camtopod")
    logger.addHandler(handler)
    try:
        yield lines
    finally:
        logger.removeHandler(handler)


@pytest.fixture
def installation(quick_path: Path) -> Iterator[Installation]:
    for name in ("journal", "spool", "image"):
        (quick_path / name).mkdir()
    journal = Journal(quick_path / "journal", KEEP)
    spool = Spool(quick_path / "spool" / "spool.db", "boot-1", 10_000)
    chance, ever = random.Random(1), list[Snapshot]()
    for number in range(1, STEPS + 1):
        if number == STEPS:
            starts = [
                log_end(quick_path / name) for name in ("journal/journal.db", "spool/spool.db")
            ]
        camera = chance.choice(CAMERAS)
        events = spool.append(
            [Event(camera, "entry", 60.0 * number + n) for n in range(chance.randint(1, 6))]
        )
        entries = [
            Entry("event", camera, one.boot, one.seq, codec.to_msgpack(one)) for one in events
        ]
        versions = (
            [StoredVersion(EPOCH, number, f"sha256:{number}", chance.randbytes(600))]
            if number % 5 == 0
            else []
        )
        snapshot = (
            Snapshot(len(journal), EPOCH, chance.randbytes(SNAPSHOT_BYTES))
            if number % 30 == 0
            else None
        )
        journal.commit(entries, versions, snapshot, now=0.0)
        ever += [snapshot] if snapshot else []
        if number % 3:
            spool.ack(camera, str(events[-1].boot), int(events[-1].seq or 0))
    ends = [log_end(quick_path / name) for name in ("journal/journal.db", "spool/spool.db")]
    files = files_of(quick_path / "journal"), files_of(quick_path / "spool")
    journal.close()
    grabber = spool
    for (camera, boot), seq in journal_streams(quick_path / "journal").items():
        grabber.ack(camera, boot, seq)
    found = look_into_journal(files[0], grabber, quick_path / "image")
    in_spool = look_into_spool(files[1], quick_path / "image")
    assert found.said == in_spool.said == []
    assert found.events == in_spool.events
    last = [range(*ends_of) for ends_of in zip(starts, ends, strict=True)]
    assert all(last), "the last transaction is not in the log: choose another number of steps"
    assert len(found.snapshots) == 2
    yield Installation(
        Before(files[0], found, last[0], ever), Before(files[1], in_spool, last[1], []), grabber
    )
    grabber.close()


def files_of(directory: Path) -> Content:
    """Copy files as a kill leaves them; the shared memory is made anew."""
    return {
        path.name: path.read_bytes()
        for path in directory.iterdir()
        if path.suffix in (".db", ".db-wal")
    }


def log_end(path: Path) -> int:
    return 32 + max(wal_check.read(path).frames, default=0) * (24 + 4096)


def journal_streams(directory: Path) -> dict[tuple[str, str], int]:
    journal = Journal(directory, KEEP)
    streams = journal.streams()
    journal.close()
    return streams


def look_into_journal(content: Content, grabber: Spool, directory: Path) -> Found:
    """Open it as the daemon does, have the grabber fill in what is missing, and read it."""
    clear(directory)
    put(content, directory)
    with said() as lines:
        try:
            journal = Journal(directory, KEEP)
        except StateError as error:
            return Found({}, {}, [], [f"refused: {error}"])
        if journal.set_aside is not None:
            lines.append("set aside")
        stored = journal.streams()
        for camera in CAMERAS:
            have = stored.get((camera, grabber.boot), -1)
            batch = grabber.batch(camera, grabber.boot, have + 1, 10_000)
            if (batch.acked or -1) > have:
                lines.append(
                    f"shorter: {batch.acked} of {camera} was acknowledged and {have} is there"
                )
            journal.commit(
                [Entry("event", camera, batch.boot, seq, raw) for seq, raw in batch.events]
            )
        events: dict[Key, bytes] = {}
        for number, entry in journal.entries():
            if entry is None:
                lines.append(f"entry {number} is damaged")
            else:
                events[entry.camera, entry.boot, entry.seq] = entry.raw
        versions = {number: journal.version(EPOCH, number) for number in journal.versions(EPOCH)}
        found = Found(events, versions, journal.snapshots(), lines)
        journal.close()
    return found


def look_into_spool(content: Content, directory: Path) -> Found:
    """Open it as the next grabber does and read all events."""
    clear(directory)
    put(content, directory)
    events: dict[Key, bytes] = {}
    with said() as lines:
        try:
            spool = Spool(directory / "spool.db", "boot-2", 10_000)
        except StateError as error:
            return Found({}, {}, [], [f"refused: {error}"])
        for camera in CAMERAS:
            batch = spool.batch(camera, None, 0, 10_000)
            events |= {(camera, batch.boot, seq): raw for seq, raw in batch.events}
        spool.close()
    return Found(events, {}, [], lines)


def clear(directory: Path) -> None:
    shutil.rmtree(directory)
    directory.mkdir()


def verdict(before: Before, now: Found) -> str:
    """Return ``same``, ``said`` (a loss, and it was reported) or ``refused``; fail otherwise."""
    was = before.found
    if not (
        now.events.items() <= was.events.items()
        and all(
            content in (None, was.versions.get(number)) for number, content in now.versions.items()
        )
        and all(one in before.snapshots for one in now.snapshots)
    ):
        return f"WRONG CONTENT, said {now.said}"
    if any(line.startswith("refused") for line in now.said):
        return "refused"
    if now[:3] == was[:3]:
        return "same"
    return "said" if now.said else f"SILENT: {missing(was, now)}"


def missing(before: Found, now: Found) -> str:
    return (
        f"{len(before.events) - len(now.events)} events, {len(before.versions) - len(now.versions)} versions, "
        f"{len(before.snapshots) - len(now.snapshots)} snapshots"
    )


def damaged(before: Before, name: str, chance: random.Random) -> Content:
    """Flip one bit anywhere in the files."""
    files = [name, f"{name}-wal"]
    chosen = chance.choices(files, [len(before.content[one]) for one in files])[0]
    content = bytearray(before.content[chosen])
    content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
    return before.content | {chosen: bytes(content)}


def flip(
    installation: Installation, count: int, directory: Path, seed: int
) -> dict[str, collections.Counter[str]]:
    """Make ``count`` flips, half of them in the journal and half in the spool."""
    chance = random.Random(seed)
    counts: dict[str, collections.Counter[str]] = {
        "journal": collections.Counter(),
        "spool": collections.Counter(),
    }
    for _ in range(count // 2):
        image = damaged(installation.journal, "journal.db", chance)
        now = look_into_journal(image, installation.grabber, directory)
        counts["journal"][verdict(installation.journal, now)] += 1
        now = look_into_spool(damaged(installation.spool, "spool.db", chance), directory)
        counts["spool"][verdict(installation.spool, now)] += 1
    return counts


def cut(
    installation: Installation, every: int, directory: Path
) -> dict[str, collections.Counter[str]]:
    """Cut the log anywhere in its last transaction, with the snapshot and the version in it."""
    counts: dict[str, collections.Counter[str]] = {
        "journal": collections.Counter(),
        "spool": collections.Counter(),
    }
    for name, before in (("journal", installation.journal), ("spool", installation.spool)):
        whole = before.content[f"{name}.db-wal"]
        for length in before.last[::every]:
            image = before.content | {f"{name}.db-wal": whole[:length]}
            if name == "journal":
                now = look_into_journal(image, installation.grabber, directory)
                assert now.events == before.found.events, "the grabber has all of it"
            else:
                now = look_into_spool(image, directory)
            if name == "spool" and length == before.last.start:
                continue  # as if the last transaction had never been: nobody can know, and nothing was put on the bus
            counts[name][verdict(before, now)] += 1
    return counts


def assert_nothing_silent(counts: dict[str, collections.Counter[str]]) -> None:
    for name, counter in counts.items():
        assert set(counter) <= {"same", "said"}, f"{name}: {counter}"
        assert counter["said"] > 0


def test_flipped_bits_are_never_silent(installation: Installation, quick_path: Path) -> None:
    assert_nothing_silent(flip(installation, 240, quick_path / "image", seed=2))


def test_a_journal_whose_format_is_damaged_is_set_aside(
    installation: Installation, quick_path: Path
) -> None:
    clear(quick_path / "image")
    put(installation.journal.content, quick_path / "image")
    with (
        contextlib.closing(sqlite3.connect(quick_path / "image" / "journal.db")) as connection,
        connection,
    ):
        connection.execute("UPDATE meta SET value = '3' WHERE key = 'format'")
    found = look_into_journal(
        files_of(quick_path / "image"), installation.grabber, quick_path / "image"
    )
    assert any(
        "does not say its format" in line and "a new one is begun" in line for line in found.said
    )


def test_a_log_cut_anywhere_is_noticed_and_filled_in_again(
    installation: Installation, quick_path: Path
) -> None:
    assert_nothing_silent(cut(installation, 401, quick_path / "image"))


def test_a_snapshot_cut_at_any_byte_is_not_used(
    installation: Installation, quick_path: Path
) -> None:
    directory = quick_path / "image"
    clear(directory)
    put(installation.journal.content, directory)
    journal = Journal(directory, KEEP)
    newest, older = journal.snapshots()
    for length in range(SNAPSHOT_BYTES):
        state = newest.state[:length]
        journal._db.execute(
            "UPDATE snapshot SET state = ? WHERE position = ?", (state, newest.position)
        )
        with said() as lines:
            assert journal.snapshots() == [older]
        assert len(lines) == 1
    journal.close()


def test_the_harness_sees_silent_damage(
    installation: Installation, quick_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without checksums, damage is silent and the content wrong."""
    chance = random.Random(3)
    clear(quick_path / "image")
    put(installation.spool.content, quick_path / "image")
    with (
        contextlib.closing(sqlite3.connect(quick_path / "image" / "spool.db")) as connection,
        connection,
    ):
        for table in ("event", "meta", "count", "acked"):
            connection.execute(f"UPDATE {table} SET crc = 0")
    before = installation.spool._replace(
        content={"spool.db-wal": b""} | files_of(quick_path / "image")
    )
    monkeypatch.setattr("camtopod.serve.storage.sqlite_file.crc", lambda *columns: 0)
    flips = (damaged(before, "spool.db", chance) for _ in range(100))
    verdicts = [verdict(before, look_into_spool(image, quick_path / "image")) for image in flips]
    assert any(one.startswith(("WRONG", "SILENT")) for one in verdicts)


@pytest.mark.campaign
@pytest.mark.timeout(7200)
def test_campaign_of_flipped_bits(installation: Installation, quick_path: Path) -> None:
    counts = flip(installation, size("FLIPS", 30_000), quick_path / "image", seed=4)
    print(f"flips: {counts}")
    assert_nothing_silent(counts)


@pytest.mark.campaign
@pytest.mark.timeout(7200)
def test_campaign_of_cuts_at_every_byte(installation: Installation, quick_path: Path) -> None:
    counts = cut(installation, size("CUT_EVERY", 1), quick_path / "image")
    print(f"cuts: {counts}")
    assert_nothing_silent(counts)
