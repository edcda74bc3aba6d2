"""The journal's files are removed, moved, cut or replaced under the running daemon.

From then on nothing is acknowledged, the fault is reported, and after a restart nothing is missing
that a spool still has.
"""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
import sqlite3
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pytest
from serving import T0, WAIT_SECONDS, camtopod, free_endpoint, small_config, wait_for
from test_refill import raws

from camtopod.config.settings import BusSettings, Config
from camtopod.records import Event
from camtopod.serve.bus.session import Bus, dial
from camtopod.serve.daemon import Daemon
from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.storage.journal_writer import SLOW_SECONDS

NOW = T0 + 10_000.0
BEFORE, AFTER = 300, 20
"""Events that are stored before, and that come after it."""
SAYS_OLDER = "has come back older than it was: it had 300 entries"


def removed(state: Path) -> None:
    (state / "journal.db").unlink()


def removed_with_its_log(state: Path) -> None:
    for path in state.glob("journal.db*"):
        path.unlink()


def moved(state: Path) -> None:
    (state / "journal.db").rename(state / "elsewhere.db")


def cut(state: Path) -> None:
    os.truncate(state / "journal.db", 0)


def cut_after_a_checkpoint(state: Path) -> None:
    """Cut it when nothing is left in the log that could be copied back into it."""
    with contextlib.closing(sqlite3.connect(state / "journal.db")) as database:
        busy, _, _ = database.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
    assert not busy
    cut(state)


def cut_by_a_page(state: Path) -> None:
    os.truncate(state / "journal.db", (state / "journal.db").stat().st_size - 4096)


def replaced_by_a_folder(state: Path) -> None:
    removed(state)
    (state / "journal.db").mkdir()


def replaced_by_a_copy(state: Path) -> None:
    shutil.copyfile(state / "journal.db", state / "copy.db")
    (state / "copy.db").rename(state / "journal.db")


def overwritten(state: Path) -> None:
    """Overwrite a file as `cp` does when it restores a backup: same file, same size."""
    with (state / "journal.db").open("r+b") as file:
        content = bytearray(file.read())
        content[24:28] = bytes(4)  # how often it was changed
        file.seek(0)
        file.write(content)


def log_cut(state: Path) -> None:
    os.truncate(state / "journal.db-wal", 0)


def log_cut_in_half(state: Path) -> None:
    os.truncate(state / "journal.db-wal", (state / "journal.db-wal").stat().st_size // 2)


def log_removed(state: Path) -> None:
    (state / "journal.db-wal").unlink()


def lock_removed(state: Path) -> None:
    (state / "journal.lock").unlink()


def directory_moved(state: Path) -> None:
    state.rename(state.with_name("elsewhere"))


def directory_removed(state: Path) -> None:
    shutil.rmtree(state)


Harm = Callable[[Path], None]
HARMS: tuple[Harm, ...] = (
    removed,
    removed_with_its_log,
    moved,
    cut,
    cut_after_a_checkpoint,
    cut_by_a_page,
    replaced_by_a_folder,
    replaced_by_a_copy,
    overwritten,
    log_cut,
    log_cut_in_half,
    log_removed,
    lock_removed,
    directory_moved,
    directory_removed,
)
DAMAGED = (cut, cut_by_a_page)
"""After these what can be read of the journal is taken over, and what the spools have comes once
more.
"""
OLDER = (
    removed,
    removed_with_its_log,
    moved,
    cut_after_a_checkpoint,
    replaced_by_a_folder,
    log_cut,
    log_cut_in_half,
)
"""After these the journal has fewer entries than before."""
NEW_DIRECTORY = (directory_moved, directory_removed)


class Grabber:
    """A spool that keeps acknowledged events, and the number of its events."""

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._spool = Spool(directory / "spool.db", "boot-1", 10_000)
        self.publisher = Publisher(self._spool, 100)
        self.made = 0

    def publish(self, count: int) -> None:
        events = [
            Event("lobby", "entry", T0 + 0.1 * n) for n in range(self.made, self.made + count)
        ]
        self.made += count
        for event in events:
            self.publisher.publish(event)

    @contextlib.contextmanager
    def at(self, endpoint: str) -> Iterator[Bus]:
        """Attach to a daemon's bus with a new publisher, as after a restart."""
        with contextlib.closing(dial(small_config(self._directory, endpoint))) as bus:
            self.publisher = Publisher(self._spool, 100)
            self.publisher.attach(bus, ["lobby"])
            yield bus

    def close(self) -> None:
        self._spool.close()


@pytest.fixture(autouse=True)
def log_that_is_not_copied_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let only `cut_after_a_checkpoint` checkpoint; on a slow machine 300 commits would."""
    monkeypatch.setattr("camtopod.serve.storage.sqlite_file._AUTOCHECKPOINT_PAGES", 100_000)


@pytest.fixture
def grabber(tmp_path: Path) -> Iterator[Grabber]:
    with contextlib.closing(Grabber(tmp_path)) as one:
        yield one


def is_clear_about(reason: str, state: Path) -> bool:
    """Return True if a message names the fault, the file and the remedy."""
    return (
        str(state / "journal") in reason and "while it is in use" in reason and "restart" in reason
    )


class Seen(NamedTuple):
    """A daemon that has stopped acknowledging: its epoch, identity and endpoint."""

    epoch: str
    name: str
    endpoint: str


def config_at(state: Path, endpoint: str) -> Config:
    """Return the configuration of a daemon started again at the same endpoint.

    A spool recognises its daemon by that, or by its name.
    """
    return msgspec.structs.replace(small_config(state), bus=BusSettings(listen=(endpoint,)))


def stops(harm: Harm, state: Path, grabber: Grabber, caplog: pytest.LogCaptureFixture) -> Seen:
    """Run a daemon, inject the fault, and stop it."""
    with Daemon(small_config(state), clock=lambda: NOW) as daemon, grabber.at(daemon.endpoint):
        grabber.publish(BEFORE)
        assert grabber.publisher.wait_acknowledged(20)
        seen = Seen(daemon.epoch, daemon._name(), daemon.endpoint)
        harm(state)
        wait_for(lambda: daemon.status()["state"] == "degraded", "it to notice")
        grabber.publish(AFTER)
        wait_for(
            lambda: daemon.status()["events"]["received"] >= grabber.made, "the events to be there"
        )
        reason = daemon.status()["reason"]
        assert is_clear_about(reason, state), reason
        assert daemon.unready() == [reason]
        assert daemon.failing() == [], "a restart by a supervisor would make the loss final"
        assert caplog.text.count("cannot write the journal, so nothing is acknowledged") == 1
    assert grabber.publisher.unacknowledged == AFTER
    return seen


@pytest.mark.parametrize("harm", HARMS)
def test_nothing_is_acknowledged_from_then_on_and_what_the_spools_have_comes_back(
    harm: Harm, grabber: Grabber, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    state = tmp_path / "state"
    with caplog.at_level(logging.INFO):
        before = stops(harm, state, grabber, caplog)
        if harm is replaced_by_a_folder:
            (state / "journal.db").rmdir()
        caplog.clear()
        config = config_at(state, before.endpoint)
        with Daemon(config, clock=lambda: NOW - 1.0) as again, grabber.at(again.endpoint):
            assert grabber.publisher.wait_acknowledged(20)
            wait_for(lambda: len(again._journal) >= BEFORE + AFTER, "all events to be there again")
            status, name = again.status(), again._name()
    assert status["state"] == "running"
    found = [seq for seq, _ in raws(state)]
    assert (sorted(set(found)) if harm in DAMAGED else found) == list(range(1, BEFORE + AFTER + 1))
    assert (SAYS_OLDER in caplog.text) == (status["journal"]["missing"] > 0) == (harm in OLDER)
    assert ("journal.db is damaged" in caplog.text) == (
        harm in (*DAMAGED, removed, moved, replaced_by_a_folder)
    )
    if harm in (*OLDER, *DAMAGED):
        assert status["epoch"] > before.epoch, "though the clock is behind"
    elif harm not in NEW_DIRECTORY:
        assert status["epoch"] == before.epoch, "nothing was lost"
    if harm not in (*DAMAGED, *NEW_DIRECTORY):
        assert name == before.name


@pytest.mark.parametrize("harm", [moved, directory_moved])
def test_it_goes_on_by_itself_when_the_file_is_back(
    harm: Harm, grabber: Grabber, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    state = tmp_path / "state"
    with (
        caplog.at_level(logging.INFO),
        Daemon(small_config(state), clock=lambda: NOW) as daemon,
        grabber.at(daemon.endpoint),
    ):
        grabber.publish(BEFORE)
        assert grabber.publisher.wait_acknowledged(20)
        harm(state)
        wait_for(lambda: daemon.status()["state"] == "degraded", "it to notice")
        grabber.publish(AFTER)
        if harm is moved:
            (state / "elsewhere.db").rename(state / "journal.db")
        else:
            (tmp_path / "elsewhere").rename(state)
        assert grabber.publisher.wait_acknowledged(20)
        assert daemon.status()["state"] == "running"
        epoch = daemon.epoch
    assert "the journal can be written again" in caplog.text
    caplog.clear()
    with Daemon(small_config(state), clock=lambda: NOW) as again:
        assert again.epoch == epoch
    assert "older than it was" not in caplog.text
    assert [seq for seq, _ in raws(state)] == list(range(1, BEFORE + AFTER + 1))


def test_of_two_daemons_in_one_directory_the_one_whose_lock_is_gone_stops(
    grabber: Grabber, tmp_path: Path
) -> None:
    state = tmp_path / "state"
    with Daemon(small_config(state), clock=lambda: NOW) as first, grabber.at(first.endpoint):
        grabber.publish(BEFORE)
        assert grabber.publisher.wait_acknowledged(20)
        lock_removed(state)
        with Daemon(small_config(state), clock=lambda: NOW) as second:
            wait_for(lambda: first.status()["state"] == "degraded", "it to notice")
            grabber.publish(AFTER)
            wait_for(
                lambda: first.status()["events"]["received"] >= grabber.made,
                "the events to be there",
            )
            assert is_clear_about(first.status()["reason"], state)
            assert grabber.publisher.unacknowledged == AFTER
            with grabber.at(second.endpoint):
                assert grabber.publisher.wait_acknowledged(20)
            assert second.status()["state"] == "running"
    assert [seq for seq, _ in raws(state)] == list(range(1, BEFORE + AFTER + 1))


class Process:
    """The real program, its status and its output."""

    def __init__(self, directory: Path) -> None:
        self.state, self._config, self.endpoint = (
            directory / "state",
            directory / "c.toml",
            free_endpoint(),
        )
        self._config.write_text(
            f'[bus]\nlisten = ["{self.endpoint}"]\n[state]\ndirectory = "{self.state}"\n'
            "[limits]\npull_seconds = 0.2\nack_seconds = 0.05\nstatus_seconds = 0.1\n"
        )
        self.said = b""

    @contextlib.contextmanager
    def running(self) -> Iterator[subprocess.Popen[bytes]]:
        """Run until killed with SIGKILL."""
        process = camtopod("--config", str(self._config), "run", stderr=subprocess.PIPE)
        assert process.stderr is not None
        try:
            while b"ready at" not in self.said:
                line = process.stderr.readline()
                assert line, self.said
                self.said += line
            yield process
        finally:
            process.kill()
            self.said += process.communicate()[1]

    @staticmethod
    def status(bus: Bus) -> dict[str, Any]:
        answers: list[Any] = []

        def answered() -> bool:
            answers[:] = bus.query("status/daemon", seconds=20.0, one=True)
            return bool(answers)  # a bus that does not know the daemon yet has none at once

        wait_for(answered, "the daemon's status")
        status: dict[str, Any] = msgspec.msgpack.decode(answers[0][1])
        return status


@pytest.mark.parametrize("harm", [removed, removed_with_its_log, cut, log_cut, lock_removed])
def test_a_process_that_is_killed_then_has_acknowledged_nothing_that_is_gone(
    harm: Harm, grabber: Grabber, tmp_path: Path
) -> None:
    process = Process(tmp_path)
    with process.running(), grabber.at(process.endpoint) as bus:
        grabber.publish(BEFORE)
        assert grabber.publisher.wait_acknowledged(20)
        harm(process.state)
        wait_for(lambda: process.status(bus)["state"] == "degraded", "it to notice")
        grabber.publish(AFTER)
        wait_for(
            lambda: process.status(bus)["events"]["received"] >= grabber.made,
            "the events to be there",
        )
        assert is_clear_about(process.status(bus)["reason"], process.state)
        assert grabber.publisher.unacknowledged == AFTER
    assert b"nothing is acknowledged" in process.said

    process.said = b""
    with process.running(), grabber.at(process.endpoint) as bus:
        assert grabber.publisher.wait_acknowledged(20)
        wait_for(
            lambda: process.status(bus)["journal"]["entries"] == BEFORE + AFTER,
            "all events to be there again",
        )
        assert process.status(bus)["journal"]["missing"] == (0 if harm is lock_removed else BEFORE)
    assert (SAYS_OLDER.encode() in process.said) == (harm is not lock_removed)
    assert [seq for seq, _ in raws(process.state)] == list(range(1, BEFORE + AFTER + 1))


class Hanging:
    """A connection whose COMMIT does not return until allowed."""

    def __init__(self, database: Any, let_in: threading.Event, let_out: threading.Event) -> None:
        self._database, self._let_in, self._let_out = database, let_in, let_out

    def __getattr__(self, name: str) -> Any:
        return getattr(self._database, name)

    def execute(self, statement: str, *parameters: object) -> Any:
        if statement == "COMMIT":
            self._let_in.set()
            assert self._let_out.wait(60)
        return self._database.execute(statement, *parameters)


def test_the_status_is_answered_while_the_disk_hangs(
    grabber: Grabber, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("camtopod.serve.storage.journal_writer.SLOW_SECONDS", SLOW_SECONDS / 10)
    let_in, let_out = threading.Event(), threading.Event()
    with (
        Daemon(small_config(tmp_path / "state"), clock=lambda: NOW) as daemon,
        grabber.at(daemon.endpoint) as bus,
    ):
        journal = daemon._journal
        journal._db = Hanging(journal._db, let_in, let_out)  # type: ignore[assignment]
        try:
            grabber.publish(1)
            assert let_in.wait(WAIT_SECONDS)
            wait_for(
                lambda: "the disk of the journal does not answer" in Process.status(bus)["reason"],
                "the reason",
            )
            assert Process.status(bus)["journal"]["bytes"] > 0
            assert daemon.unready() != []
        finally:
            let_out.set()
        assert grabber.publisher.wait_acknowledged(20)
        wait_for(lambda: Process.status(bus)["state"] == "running", "the disk to answer again")
