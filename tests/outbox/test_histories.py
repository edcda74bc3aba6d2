"""Random histories of a spool and a daemon with every fault, both sides the program's own."""

from __future__ import annotations

import shutil
import tempfile
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest
from intake_bench import LATENESS, IntakeBench
from one_camera import CAMERA, Side, World

from camtopod import codec
from camtopod.event_time import EventTime, microseconds
from camtopod.serve.requests import Answer
from camtopod.serve.storage import Journal
from camtopod.serve.storage.journal import highest_numbers
from camtopod.serve.storage.journal_schema import insert

QUICK_HISTORIES = 12
TICK_SECONDS = 1.0
WALL = 1e6
"""This machine's clock at the beginning; the events are older."""


class RealDaemon:
    """The daemon of a history: the real path of an event and a real journal."""

    def __init__(self, world: Side, folder: Path) -> None:
        self.world = world
        self.folder = folder
        self.bench: IntakeBench | None = None
        self.generation = 0
        self.counted: Counter[int] = Counter()
        """How often each event was learned, as far as the journal has not gone back since."""
        self._learned = EventTime(LATENESS)
        self._deleted: list[tuple[str, int, int]] = []  # events that are no longer kept

    @property
    def up(self) -> bool:
        return self.bench is not None

    @property
    def journal(self) -> list[tuple[str, int, int]]:
        """(boot, seq, uid) of each event that was stored, in order."""
        return self._deleted + self.kept

    @property
    def kept(self) -> list[tuple[str, int, int]]:
        """Those that are in the journal."""
        bench = self.bench
        journal = bench.journal if bench is not None else Journal(self.folder)
        entries = [entry for _, entry in journal.entries() if entry is not None]
        if bench is None:
            journal.close()
        return [
            (str(one.boot), one.seq or 0, int(str(codec.event_from_bytes(one.raw).track)))
            for one in entries
            if one.kind == "event"
        ]

    @property
    def numbers(self) -> dict[str, int]:
        if self.bench is None:
            return {}
        return {boot: seq for (_, boot), seq in self.bench.journal.numbers().items()}

    def start(self) -> None:
        self.generation += 1
        now = self.world.now
        self.bench = IntakeBench(self.folder, wall=WALL + now, now=now, settled=False)
        stored = {uid for _, _, uid in self.journal}
        self.counted = Counter({uid: n for uid, n in self.counted.items() if uid in stored})
        self._learned = EventTime(LATENESS)
        self._learned.note(microseconds(max(stored, default=0)), CAMERA)
        self.world.at(self.world.now + self.world.chance.choice([0.3, 0.8]), self.world.appear)
        self._tick(self.generation)

    def stop(self, seconds: float) -> None:
        if self.bench is not None:
            self.bench.stop()
            self.bench = None
            self.generation += 1
            self.world.linked = False
            self.world.at(self.world.now + seconds, self.start)

    def go_back(self, rows: int) -> None:
        """Stop, and come back with an older journal: the first rows, and their numbers."""
        assert self.bench is not None
        journal = self.bench.journal
        journal._db.execute("DELETE FROM entry WHERE id > ?", (rows,))
        journal._db.execute("DELETE FROM stream")
        left = [entry for _, entry in journal.entries() if entry is not None]
        numbers = [(*stream, seq, rows) for stream, seq in highest_numbers(left).items()]
        insert(journal._db, "INSERT INTO stream", numbers)
        self.stop(1.0)

    def lose_number(self, boot: str) -> None:
        """Stop, and come back with a damaged number of a boot, and without older entries.

        As in service, those that are deleted are too late to be learned.
        """
        assert self.bench is not None
        database = self.bench.journal._db
        newest = max((uid for _, _, uid in self.kept), default=0)
        half = [one for one in self.kept[: len(self.kept) // 2] if one[2] < newest - LATENESS]
        self._deleted += half
        database.executemany("DELETE FROM entry WHERE boot = ? AND seq = ?", [x[:2] for x in half])
        database.execute("UPDATE stream SET seq = seq + 7 WHERE boot = ?", (boot,))
        self.stop(1.0)

    def receive(self, payload: bytes, reply: Callable[[Answer], None]) -> None:
        """Take a request, and let the daemon work now or later."""
        if self.bench is None:
            return
        if self.world.now < self.world.until["busy"]:
            reply(Answer({}, 1, "busy"))
            return
        self.bench.intake.inbox.on_request(
            f"store/{CAMERA}",
            payload,
            lambda content: reply(msgspec.msgpack.decode(content, type=Answer)),
        )
        held = self.world.now < self.world.until["held"]
        seconds = self.world.chance.uniform(0, 300 if held else 0.5)
        self.world.at(self.world.now + seconds, self._work, self.generation)

    def _tick(self, generation: int) -> None:
        """Let the daemon look at its clocks, as its loops do."""
        if generation == self.generation:
            if self.world.now >= self.world.until["held"]:
                self._work(generation)
            self.world.at(self.world.now + TICK_SECONDS, self._tick, generation)

    def _work(self, generation: int) -> None:
        if generation != self.generation or self.bench is None:
            return
        bench = self.bench
        bench.now = self.world.now
        bench.wall = WALL + self.world.now
        bench.intake.step()
        if self.world.now >= self.world.until["slow"]:
            bench.work()
        for received in bench.learned:
            if (event := received.event) is not None:
                self.counted[int(event.t)] += self._learned.note(microseconds(event.t), CAMERA)
        bench.learned.clear()


def history(
    seed: int, kinds: list[str] | None = None, sites: tuple[str, ...] = ("",)
) -> tuple[list[str], World]:
    """Run a history; return what went wrong."""
    folder = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    try:
        world = World(seed, folder, kinds, sites)
        for side in world.sides:
            side.daemon = RealDaemon(side, folder / f"state{side.site}")
        wrongs = world.run()
        for side in world.sides:
            side.daemon.stop(0.0)
        return wrongs, world
    finally:
        shutil.rmtree(folder)


@pytest.mark.parametrize("seed", range(QUICK_HISTORIES))
def test_nothing_is_lost_and_nothing_counts_twice(seed: int) -> None:
    wrongs, world = history(seed)
    assert wrongs == [], f"seed {seed}, faults {world.kinds}"


@pytest.mark.parametrize("seed", range(QUICK_HISTORIES // 2))
def test_a_site_with_faults_of_its_own_changes_nothing_for_another(seed: int) -> None:
    wrongs, world = history(2000 + seed, sites=("", "south"))
    assert wrongs == [], f"seed {2000 + seed}, faults {world.kinds}"


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_many_histories() -> None:
    for seed in range(1000, 1300):
        for sites in (("",), ("", "south")):
            wrongs, world = history(seed, sites=sites)
            assert wrongs == [], f"seed {seed}, faults {world.kinds}, {len(sites)} sites"
