"""The learner's process: it equals the plain learner, and lives and ends with the daemon."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from paths import ROOT, SUPPORT, TESTS
from serving import T0, wait_for
from test_recovery import EVENTS, SETTINGS, Installation, uninterrupted

from camtopod.codec import to_msgpack
from camtopod.records import Event
from camtopod.serve.learner_process import feeder, recovery
from camtopod.serve.learner_process.messages import (
    Begin,
    LearnBatch,
    LearnProgress,
)
from camtopod.serve.learner_process.process import PROGRAM, LearnerEnded, LearnerProcess
from camtopod.serve.storage import Entry

FAULTY = "learners.faulty"


def begun(program: str = PROGRAM) -> LearnerProcess:
    process = LearnerProcess(program)
    process.ask(Begin(SETTINGS, "s", "E", False), LearnProgress)
    return process


@pytest.fixture
def process() -> Iterator[LearnerProcess]:
    one = begun(FAULTY)
    yield one
    one.close()


def event(track: str) -> tuple[str, bytes]:
    return "event", to_msgpack(Event("a", "entry", T0, 0.5, 0.5, track))


def alive(pid: int) -> bool:
    """Return True if there is such a process that has not ended."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    return False


def test_events_that_come_while_it_works_are_learned(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(feeder, "INPUTS_MAX", 8)
    monkeypatch.setattr(feeder, "GATHER_SECONDS", 0.0)
    waiting = iter([EVENTS[first : first + 11] for first in range(0, len(EVENTS), 11)])
    stop = threading.Event()
    with contextlib.closing(Installation(tmp_path)) as one:

        def beat() -> None:
            """Store more than is learned in a step."""
            if more := next(waiting, None):
                one.store(more)
            elif not one.learning.waiting:
                stop.set()

        one.learning.work(stop, beat)
        one.run()
        assert one.published == uninterrupted()


def test_versions_that_one_entry_makes_due_come_one_by_one(tmp_path: Path) -> None:
    """As behind a backlog that was waited for; whoever is killed between them goes on there."""
    waits = [Entry("waits", "", None, None, raw) for raw in (b'["", "b"]', b"[]")]
    with contextlib.closing(Installation(tmp_path)) as one:
        one.journal.commit(waits[:1])
        one.store(EVENTS)
        one.journal.commit(waits[1:])
        inputs = [(entry.kind, entry.raw) for _, entry in one.journal.entries() if entry]
        first = one.process.ask(LearnBatch(0, inputs), LearnProgress)
        assert (first.position, len(first.versions), first.is_paused) == (len(inputs), 1, True)
        one.on_progress(first)
        published = one.published
    with contextlib.closing(Installation(tmp_path)) as one:
        one.run()
        assert len(one.published) > 2
        digests = [digest for _, _, digest in published + one.published]
        assert digests == [digest for _, _, digest in uninterrupted()]


def test_what_the_terminal_and_systemd_tell_the_group_is_not_for_it(
    process: LearnerProcess,
) -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(process.pid, number)

    assert process.ask(LearnBatch(0, [event("1")]), LearnProgress).position == 1


def test_what_cannot_be_read_teaches_nothing_and_is_counted(process: LearnerProcess) -> None:
    answer = process.ask(
        LearnBatch(
            0,
            [
                ("event", b"{}"),
                ("skipped", b""),
                ("advance", repr(T0).encode()),
                event("1"),
                ("event", b'{"camera":"a","kind":"exit","t":1700000000.0}'),
            ],
        ),
        LearnProgress,
    )
    assert (answer.position, answer.unreadable) == (5, 1)
    assert answer.statistics.accepted == 2


def test_it_needs_no_shared_memory_of_the_system() -> None:
    """Where containers have none."""
    program = (
        "import os\n"
        "access, statvfs = os.access, os.statvfs\n"
        "os.access = lambda path, mode: path != '/dev/shm' and access(path, mode)\n"
        "os.statvfs = lambda path: statvfs('/none' if path == '/dev/shm' else path)\n"
        "from camtopod.serve.learner_process.process import LearnerProcess\n"
        "if __name__ == '__main__': LearnerProcess('os').close()\n"
    )
    subprocess.run([sys.executable, "-c", program], check=True, cwd=ROOT)


def test_it_gives_way(process: LearnerProcess) -> None:
    assert os.getpriority(os.PRIO_PROCESS, process.pid) > os.getpriority(os.PRIO_PROCESS, 0)


def test_killed_while_it_had_nothing_to_do_is_nobodys_fault(process: LearnerProcess) -> None:
    process.ask(LearnBatch(0, [event("1")]), LearnProgress)
    os.kill(process.pid, signal.SIGKILL)
    with pytest.raises(LearnerEnded) as ended:
        process.ask(LearnBatch(1, [event("2")]), LearnProgress)
    assert (ended.value.status, ended.value.at) == (-signal.SIGKILL, 0)


def test_an_endless_step_holds_up_no_stop_and_loses_nothing(tmp_path: Path) -> None:
    stop = threading.Event()
    with contextlib.closing(Installation(tmp_path, program=FAULTY)) as one:
        one.learn(EVENTS[:100])
        one.store([msgspec.structs.replace(EVENTS[100], track="lasts")])
        working = threading.Thread(target=one.learning.work, args=(stop,))
        working.start()
        wait_for(lambda: one.process.has_progressed(), "the step to begin")

        stop.set()
        working.join()

        assert recovery.read_failure(one.journal).times == 0, "the entry had no chance"
        before = one.published
    with contextlib.closing(Installation(tmp_path)) as again:
        assert again.learning.waiting == 101 - again.started_at > 0
        again.learn(EVENTS[101:])
        assert [one[:2] for one in before + again.published] == [one[:2] for one in uninterrupted()]


@pytest.mark.parametrize("busy", [False, True])
def test_it_ends_with_the_daemon_even_in_the_middle_of_a_step(busy: bool) -> None:
    script = (
        "import test_learner_process as t, sys, time\n"
        "process = t.begun(t.FAULTY)\n"
        f"if {busy}: process.send(t.LearnBatch(0, [t.event('lasts')]))\n"
        f"while process.has_progressed() != {busy}: time.sleep(0.01)\n"
        "print(process.pid, flush=True)\n"
        "time.sleep(1000)\n"
    )
    here = os.pathsep.join(map(str, (ROOT, TESTS, SUPPORT, TESTS / "serve")))
    above = subprocess.Popen(
        [sys.executable, "-c", script],
        stdout=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": here},
    )
    with above:
        assert above.stdout is not None
        pid = int(above.stdout.readline())
        assert alive(pid)
        above.kill()
    wait_for(lambda: not alive(pid), "it to end")
