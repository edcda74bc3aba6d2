"""Freed memory is returned to the system, and the collector does not scan permanent objects."""

from __future__ import annotations

import gc
import subprocess
import sys
import weakref
from collections.abc import Iterator
from pathlib import Path

import pytest

from camtopod.records import Event
from camtopod.serve.ingest.camera_registry import Received
from camtopod.serve.ingest.inbox import Message
from camtopod.serve.runtime import memory
from camtopod.serve.storage.journal import Entry

RESIDENT = """
import os, threading, sys
from pathlib import Path
from camtopod.serve import memory
if sys.argv[1] == "limited":
    memory.limit_arenas()

def resident_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
"""

COME_AND_GO = f"""{RESIDENT}
def work(kept):
    mine = [bytearray(3000) for _ in range(20000)]
    kept.append(mine[::100])

kept = []
for _ in range(6):
    threads = [threading.Thread(target=work, args=(kept,)) for _ in range(4)]
    [thread.start() for thread in threads]
    [thread.join() for thread in threads]
if sys.argv[1] == "limited":
    memory.give_back()
print(resident_bytes())
"""

FIT = f"""{RESIDENT}
def work():
    fitted = [bytearray(60_000) for _ in range(300)]
    del fitted
    all_done.wait()  # as long as others live, a thread that ends leaves its arena to nobody

bytearray(30_000_000)  # from now on glibc keeps as much in hand
before, all_done = resident_bytes(), threading.Barrier(3)
threads = [threading.Thread(target=work) for _ in range(3)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
memory.give_back()
print(resident_bytes() - before)
"""

VERSIONS = f"""{RESIDENT}
if sys.argv[1] == "limited":
    memory.keep_large_apart()
bytearray(30_000_000)  # from now on glibc keeps as much in hand
before, kept = resident_bytes(), []
for size in range(2_000_000, 8_000_000, 500_000):
    version = bytearray(size)
    kept.append(bytearray(10_000))
    del version
print(resident_bytes() - before)
"""

JOURNAL = f"""{RESIDENT}
from camtopod.serve.storage.journal import Journal, Snapshot, StoredVersion
journal = Journal(Path(sys.argv[1]))
before = resident_bytes()
for number in (1, 2):
    version = StoredVersion("E", number, "digest", os.urandom(20_000_000))
    journal.commit([], [version], Snapshot(number, "E", version.content))
del version
memory.give_back()
print(resident_bytes() - before)
"""


def measured(program: str) -> dict[str, int]:
    """Return the program's output, bytes: with limited arenas, and with glibc's default."""
    return {
        how: int(
            subprocess.run(
                [sys.executable, "-c", program, how], capture_output=True, check=True
            ).stdout
        )
        for how in ("limited", "as it is")
    }


@pytest.mark.skipif(sys.platform != "linux", reason="glibc only")
def test_threads_that_come_and_go_leave_less_behind() -> None:
    resident = measured(COME_AND_GO)
    assert resident["limited"] < 0.8 * resident["as it is"]


@pytest.mark.skipif(sys.platform != "linux", reason="glibc only")
def test_what_a_fit_took_in_any_thread_is_given_back() -> None:
    kept = measured(FIT)
    assert kept["limited"] < 2_000_000
    assert kept["as it is"] > 5_000_000, "the canary: the end of another arena than the first stays"


class Circle:
    """Refers to itself."""

    def __init__(self) -> None:
        self.itself = self


@pytest.fixture
def thawed() -> Iterator[None]:
    yield
    gc.unfreeze()


@pytest.mark.skipif(sys.platform != "linux", reason="glibc only")
def test_what_is_large_leaves_no_holes_behind() -> None:
    bytes_more = measured(VERSIONS)
    assert bytes_more["limited"] < 1e6 < 5e6 < bytes_more["as it is"]


@pytest.mark.skipif(sys.platform != "linux", reason="glibc only")
def test_what_is_in_the_journal_does_not_stay_in_memory(tmp_path: Path) -> None:
    ran = subprocess.run(
        [sys.executable, "-c", JOURNAL, str(tmp_path)], capture_output=True, check=True
    )
    assert int(ran.stdout) < 10e6


@pytest.mark.usefixtures("thawed")
def test_the_collector_does_not_go_through_what_is_kept() -> None:
    began = []

    def collecting(phase: str, info: dict[str, int]) -> None:
        began.append((phase, info["generation"]))

    with memory.kept():
        gc.callbacks.append(collecting)
        made = [[number] for number in range(100_000)]  # enough for each generation to be collected
        gc.callbacks.remove(collecting)
    assert began == []
    assert gc.isenabled()
    known = {id(one) for one in gc.get_objects()}
    assert not known & {id(one) for one in made}


@pytest.mark.usefixtures("thawed")
def test_circles_among_what_was_kept_go_when_it_is_thorough() -> None:
    with memory.kept():
        circle = Circle()
    gone = weakref.ref(circle)
    del circle
    gc.collect()
    assert gone() is not None
    with memory.kept(thorough=True):
        pass
    assert gone() is None


@pytest.mark.usefixtures("thawed")
def test_a_program_that_does_not_collect_goes_on_without() -> None:
    gc.disable()
    try:
        with memory.kept():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_the_collector_does_not_go_through_events_on_their_way() -> None:
    """In a flood that would take longer than decoding them."""
    event, entry = Event("a", "exit", 1.0), Entry("event", "a", None, None, b"raw")
    assert not any(
        gc.is_tracked(one) for one in (event, entry, Received(entry, event), Message("a", b"raw"))
    )


def test_the_collector_looks_seldom(threshold: None) -> None:
    passes: list[str] = []
    gc.callbacks.append(lambda phase, info: passes.append(phase))
    memory.collect_rarely()
    kept = [[k] for k in range(memory.YOUNG_MAX // 2)]
    assert not passes
    kept += [[k] for k in range(memory.YOUNG_MAX)]
    assert passes == ["start", "stop"], "it looks, though"


@pytest.fixture
def threshold() -> Iterator[None]:
    """Restore the collector's threshold."""
    before, told = gc.get_threshold(), gc.callbacks.copy()
    gc.collect()
    yield
    gc.set_threshold(*before)
    gc.callbacks[:] = told
