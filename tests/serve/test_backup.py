"""A backup that was made while the daemon runs, and restored as deploy/operations.md says."""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from msgspec.structs import replace
from pages import blocks
from paths import DEPLOY
from serving import all_out, closing_event, numbered, wait_for, walkers
from test_daemon import Site, put, site

from camtopod.codec import to_msgpack
from camtopod.serve.runtime import ulid
from camtopod.serve.storage import Entry, Journal
from camtopod.sim.simulation import SimSettings, simulate

__all__ = ["site"]

PAGE = (DEPLOY / "operations.md").read_text()


def backup_command(source: Path, target: Path) -> list[str]:
    """Return the command of the page, with this Python and these files."""
    [line] = [line for line in "\n".join(blocks(PAGE, "sh")).splitlines() if ".backup(" in line]
    command = shlex.split(line)
    assert command[0].endswith("/bin/python")
    assert command[-2].endswith("/journal.db")
    return [sys.executable, *command[1:-2], str(source), str(target)]


def test_a_backup_of_a_running_daemon_is_whole_and_can_be_restored(
    site: Site, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    daemon = site.daemon()
    events = [*numbered(walkers(60)), closing_event()]
    put(site.client(daemon), *events)
    wait_for(lambda: all_out(daemon, len(events)), "all to be learned")
    saved = tmp_path / "saved.db"
    subprocess.run(backup_command(site.directory / "state" / "journal.db", saved), check=True)
    assert daemon.failing() == []

    # More comes after the backup.
    publisher = site.publisher()
    publisher.attach(site.client(daemon))
    publisher.publish(*(closing_event() for _ in range(5)))
    assert publisher.wait_stored(10)
    epoch, newest = daemon.epoch, daemon.topology
    assert newest is not None
    daemon.stop()

    # Restored, it is known to be older, and goes on in a new epoch with what was learned.
    state = site.directory / "state"
    for suffix in ("-wal", "-shm"):
        (state / f"journal.db{suffix}").unlink(missing_ok=True)
    shutil.copyfile(saved, state / "journal.db")
    again = site.daemon()
    assert "has come back older than it was" in caplog.text
    assert again.epoch > epoch
    wait_for(lambda: again.status().epoch == again.epoch, "a version")
    assert again.topology is not None
    assert {one.id for one in again.topology.cameras} == {one.id for one in newest.cameras}


def test_the_size_of_an_event_is_that_of_the_page(tmp_path: Path) -> None:
    stated = int(PAGE.split("An event takes about ")[1].split()[0])
    events, _ = simulate(SimSettings(seed=1, cameras=6, hours=1.0))
    journal, boot = Journal(tmp_path), ulid(1.7e9)
    rows = [
        Entry("event", e.camera, boot, n, to_msgpack(replace(e, boot=boot, seq=n)))
        for n, e in enumerate(events)
    ]
    for first in range(0, len(rows), 20):
        journal.commit(rows[first : first + 20], now=1.7e9)
    size = journal.status().bytes / len(rows)
    journal.close()
    assert 0.8 * stated < size < 1.2 * stated
