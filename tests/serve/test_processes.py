"""Publishers, daemon and subscribers as processes, and what is left when one of them is killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import serving
from paths import SUPPORT
from serving import camtopod, closing_event, free_endpoint, small_config, wait_for, walkers

from camtopod.codec import to_json
from camtopod.learn.learner import Learner
from camtopod.records import Event
from camtopod.serve.bus.session import Bus, dial
from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.storage.journal import Journal


class Installation:
    """A daemon's process on a port of its own, and others; all processes end with it."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.endpoint = free_endpoint()
        self.config = directory / "camtopod.toml"
        self.config.write_text(
            f'[bus]\nlisten = ["{self.endpoint}"]\nconnect_seconds = {serving.WAIT_SECONDS}\n'
            f'[state]\ndirectory = "{directory}/state"\n'
            f"[learn]\nlateness_seconds = {2 * serving.SPAN_SECONDS}\nrefit_share = 0.5\n"
            "[limits]\nstatus_seconds = 0.1\n"
        )
        self._started: list[subprocess.Popen[bytes]] = []
        self._buses: list[Bus] = []

    def start(self, *arguments: str, **popen: Any) -> subprocess.Popen[bytes]:
        process = camtopod("--config", str(self.config), *arguments, **popen)
        self._started.append(process)
        return process

    def daemon(self) -> subprocess.Popen[bytes]:
        process = self.start("run", stderr=subprocess.PIPE)
        assert process.stderr is not None
        said = b""
        while b"ready at" not in said:
            said = process.stderr.readline()
            assert said, "the daemon ended instead of becoming ready"
        threading.Thread(target=process.stderr.read, daemon=True).start()
        return process

    def ingest(self, name: str, events: list[Event]) -> subprocess.Popen[bytes]:
        path = self.directory / f"{name}.jsonl"
        path.write_bytes(b"".join(to_json(event) + b"\n" for event in events))
        state = str(self.directory / f"state-{name}")
        return self.start("ingest", "jsonl", str(path), "--state", state, stderr=subprocess.DEVNULL)

    def subscriber(self) -> Subscriber:
        script = SUPPORT / "subscribe.py"
        environment = {
            **os.environ,
            "PYTHONPATH": f"{script.parent.parent}{os.pathsep}{script.parent}",
        }
        process = subprocess.Popen(
            [sys.executable, str(script), self.endpoint],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
        )
        self._started.append(process)
        return Subscriber(process)

    def client(self) -> Bus:
        bus = dial(small_config(self.directory, self.endpoint))
        self._buses.append(bus)
        return bus

    def status(self, bus: Bus) -> dict[str, Any]:
        answers = bus.query("status/daemon", one=True)
        return (
            msgspec.msgpack.decode(answers[0][1])
            if answers
            else {"events": {"stored": -1}, "version": -1}
        )

    def rows(self) -> list[tuple[str, str | None, int | None]]:
        journal = Journal(self.directory / "state")
        rows = [
            (e.camera, e.boot, e.seq)
            for _, e in journal.entries()
            if e is not None and e.kind == "event"
        ]
        journal.close()
        return rows

    def close(self) -> None:
        for bus in self._buses:
            bus.close()
        for process in self._started:
            if process.poll() is None:
                process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout, process.stderr):
                if pipe is not None:
                    pipe.close()


class Subscriber:
    """Reads the output of a subscriber's process."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self.process = process
        self.versions: list[dict[str, Any]] = []
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.versions.append(json.loads(line))

    @property
    def newest(self) -> tuple[int, str, int]:
        if not self.versions:
            return (0, "", 0)
        newest = self.versions[-1]
        return (newest["version"], newest["digest"], newest["events"])


@pytest.fixture
def installation(tmp_path: Path) -> Iterator[Installation]:
    one = Installation(tmp_path)
    yield one
    one.close()


def test_three_publishers_one_daemon_two_subscribers_and_a_late_one(
    installation: Installation,
) -> None:
    events = walkers(60)
    learner = Learner(small_config(Path()).learn, site="site", epoch="any")
    for event in [*events, closing_event()]:
        learner.receive(event)
    assert learner.topology is not None
    expected = (learner.topology.version, learner.topology.digest, learner.topology.events)

    daemon = installation.daemon()
    subscribers = [installation.subscriber() for _ in range(2)]
    publishers = [
        installation.ingest(camera, [e for e in events if e.camera == camera]) for camera in "abc"
    ]
    for publisher in publishers:
        assert publisher.wait(serving.WAIT_SECONDS) == 0, (
            "ends when all of its events are acknowledged"
        )
    bus = installation.client()
    bus.publish("event/late", closing_event(), "event")
    for subscriber in subscribers:
        wait_for(lambda one=subscriber: one.newest == expected, "the last version")  # type: ignore[misc]
    late = installation.subscriber()
    wait_for(lambda: late.newest == expected, "the last version at the late joiner")
    assert len(late.versions) == 1, "it got the whole, not every version"
    assert {v["epoch"] for s in (*subscribers, late) for v in s.versions} == {
        late.versions[0]["epoch"]
    }
    assert installation.status(bus)["events"]["stored"] == len(events) + 1

    started = time.monotonic()
    daemon.terminate()
    assert daemon.wait(serving.WAIT_SECONDS) == 0
    assert time.monotonic() - started < 5.0
    rows = installation.rows()
    assert len(rows) == len(set(rows)) == len(events) + 1
    for camera in "abc":
        assert sum(where == camera for where, _, _ in rows) == sum(
            e.camera == camera for e in events
        )

    again = installation.daemon()
    for subscriber in (*subscribers, late):
        assert subscriber.newest == expected
    wait_for(
        lambda: installation.status(bus)["version"] == expected[0],
        "the daemon to be back at its version",
    )
    again.send_signal(signal.SIGINT)
    assert again.wait(serving.WAIT_SECONDS) == 0


def test_a_killed_daemon_has_lost_nothing_it_acknowledged(installation: Installation) -> None:
    """kill -9 during a stream of events, twice; events published in between come from the spool."""
    installation.daemon()
    spool = Spool(installation.directory / "spool.db", "boot-1", 100_000)
    publisher = Publisher(spool)
    publisher.attach(installation.client())
    stop = threading.Event()
    published = 0

    def publish() -> None:
        nonlocal published
        while not stop.wait(0.001):
            published += 1
            publisher.publish(Event("lobby", "entry", serving.T0 + 0.01 * published))

    streaming = threading.Thread(target=publish)
    streaming.start()
    try:
        for _ in range(2):
            safe = published
            wait_for(lambda before=safe: published - publisher.waiting > before + 200, "answers")  # type: ignore[misc]
            killed = installation._started[-1]
            killed.kill()
            killed.wait()
            gone = published
            wait_for(
                lambda before=gone: published > before + 200, "events while there is no daemon"
            )  # type: ignore[misc]
            installation.daemon()
    finally:
        stop.set()
        streaming.join()
    assert publisher.wait_stored(serving.WAIT_SECONDS), "the rest is stored"
    publisher.close()
    spool.close()
    last = installation._started[-1]
    last.terminate()
    assert last.wait(serving.WAIT_SECONDS) == 0
    assert installation.rows() == [("lobby", "boot-1", seq) for seq in range(1, published + 1)]


def test_commands_say_that_the_bus_is_not_there(installation: Installation) -> None:
    for command in (["ingest", "jsonl", os.devnull], ["watch", "--once"]):
        config = installation.config.read_text()
        patient = f"connect_seconds = {serving.WAIT_SECONDS}"
        installation.config.write_text(config.replace(patient, "connect_seconds = 0.2"))
        process = installation.start(*command, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        out, err = process.communicate(timeout=serving.WAIT_SECONDS)
        assert (process.returncode, out) == (69, b"")
        assert b"is `camtopod run` running there?" in err
        assert b"Traceback" not in err
        installation.config.write_text(config)
