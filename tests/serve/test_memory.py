"""Freed memory is returned to the system, and garbage is collected seldom."""

from __future__ import annotations

import gc
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from camtopod.records import Event
from camtopod.serve.ingest.camera_registry import Received
from camtopod.serve.ingest.inbox import Message
from camtopod.serve.runtime import memory
from camtopod.serve.storage.journal import Entry

RESIDENT = """
import os, threading, sys, time
from pathlib import Path
from camtopod.serve.runtime import memory
if sys.argv[1] == "tuned":
    memory.tune()

def resident_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
"""

THREADS = f"""{RESIDENT}
def wait_for(steps, number):
    steps[number] = True  # polling allocates nothing, other than a barrier
    while not all(steps):
        time.sleep(0.001)

def work(number):
    fitted = [None] * 300  # a list that grows leaves small blocks between the large ones
    wait_for(started, number)
    for block in range(300):
        fitted[block] = bytearray(60_000)
    wait_for(allocated, number)
    del fitted
    wait_for(freed, number)  # a thread that ends would leave its arena to another

bytearray(30_000_000)  # raises glibc's dynamic threshold, up to which it keeps free memory
started, allocated, freed = ([False] * 3 for _ in range(3))
before = resident_bytes()
threads = [threading.Thread(target=work, args=(number,)) for number in range(3)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
print(resident_bytes() - before)
"""

VERSIONS = f"""{RESIDENT}
bytearray(30_000_000)  # raises glibc's dynamic threshold, up to which it keeps free memory
before, kept = resident_bytes(), []
for size in range(2_000_000, 8_000_000, 500_000):
    version = bytearray(size)
    kept.append(bytearray(10_000))
    del version
print(resident_bytes() - before)
"""

JOURNAL = f"""{RESIDENT}
from camtopod.serve.storage.journal import Journal, Snapshot, StoredVersion
journal = Journal(Path(sys.argv[2]))
before = resident_bytes()
for number in (1, 2):
    version = StoredVersion("E", number, "digest", os.urandom(20_000_000))
    journal.commit([], [version], Snapshot(number, "E", version.content))
del version
print(resident_bytes() - before)
"""


def measured(program: str, how: str, *arguments: str) -> int:
    """Return what the program prints: bytes that it has in memory in addition."""
    command = [sys.executable, "-c", program, how, *arguments]
    return int(subprocess.run(command, capture_output=True, check=True).stdout)


@pytest.mark.skipif(sys.platform != "linux", reason="glibc only")
def test_what_several_threads_have_freed_is_returned() -> None:
    assert measured(THREADS, "tuned") < 8e6
    assert measured(THREADS, "untuned") > 15e6, "else the program tests nothing"


@pytest.mark.skipif(sys.platform != "linux", reason="glibc only")
def test_large_blocks_leave_no_holes_behind() -> None:
    assert measured(VERSIONS, "tuned") < 1e6
    assert measured(VERSIONS, "untuned") > 5e6, "else the program tests nothing"


@pytest.mark.skipif(sys.platform != "linux", reason="glibc only")
def test_what_is_in_the_journal_does_not_stay_in_memory(tmp_path: Path) -> None:
    assert measured(JOURNAL, "tuned", str(tmp_path)) < 10e6


def test_garbage_is_collected_seldom(thresholds: None) -> None:
    passes: list[str] = []
    gc.callbacks.append(lambda phase, info: passes.append(phase))
    memory.tune()
    kept = [[k] for k in range(memory.NEW_OBJECTS_MAX // 2)]
    assert passes == []
    kept += [[k] for k in range(memory.NEW_OBJECTS_MAX)]
    assert passes == ["start", "stop"]


@pytest.fixture
def thresholds() -> Iterator[None]:
    """Restore the collector's thresholds and callbacks."""
    before, callbacks = gc.get_threshold(), gc.callbacks.copy()
    gc.collect()
    yield
    gc.set_threshold(*before)
    gc.callbacks[:] = callbacks


def test_the_garbage_collector_does_not_track_events() -> None:
    """In a flood it would take longer to visit them than to decode them."""
    event, entry = Event("a", "exit", 1.0), Entry("event", "a", None, None, b"raw")
    assert not any(
        gc.is_tracked(one) for one in (event, entry, Received(entry, event), Message("a", b"raw"))
    )
