"""Events of another program, published with a spool."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import pytest
from fake_bus_daemon import running
from paths import ROOT
from serving import WAIT_SECONDS, free_endpoint, wait_for, walkers

from camtopod.client import BusError, Event, Publisher, Site, StateError

EVENTS = [event for event in walkers(20) if event.camera == "a"]


def test_a_daemon_stores_what_is_published(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with (
        running(tmp_path, endpoint) as daemon,
        Publisher("a", connect=endpoint, state=tmp_path / "state-of-a") as publisher,
    ):
        publisher.publish(*EVENTS[:10])
        publisher.publish(*EVENTS[10:])

        assert publisher.wait_stored(WAIT_SECONDS)
        assert (publisher.waiting, publisher.dropped) == (0, 0)
        wait_for(lambda: daemon.status().events.stored == len(EVENTS), "all events")


def test_events_wait_for_a_daemon_that_comes_later(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with Publisher("a", connect=endpoint, state=tmp_path / "state-of-a") as publisher:
        publisher.publish(*EVENTS[:10])
        assert publisher.waiting == 10
    with (
        Publisher("a", connect=endpoint, state=tmp_path / "state-of-a") as publisher,
        running(tmp_path, endpoint) as daemon,
    ):
        publisher.publish(*EVENTS[10:])

        assert publisher.wait_stored(WAIT_SECONDS)
        wait_for(lambda: daemon.status().events.stored == len(EVENTS), "all events")


@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_what_waits_is_known_after_the_end(tmp_path: Path) -> None:
    with Publisher("a", connect=free_endpoint(), state=tmp_path) as publisher:
        publisher.publish(*EVENTS[:10])

    assert publisher.waiting == 10
    assert not publisher.wait_stored(0.0)


def test_a_forked_child_is_told_at_once_and_takes_nothing_from_its_parent(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    state = tmp_path / "state-of-a"
    with (
        running(tmp_path, endpoint) as daemon,
        Site.connect(connect=endpoint) as site,
        site.predictions() as predictions,
        Publisher("a", connect=endpoint, state=state) as publisher,
    ):
        publisher.publish(*EVENTS[:1])
        for use in (
            lambda: publisher.publish(EVENTS[1]),
            lambda: publisher.wait_stored(WAIT_SECONDS),
            lambda: site.current,
            lambda: predictions.get(WAIT_SECONDS),
            lambda: Site.connect(connect=endpoint),
            lambda: Publisher("b", connect=endpoint, state=state),
        ):
            assert "BusError: this process was forked" in said_by_child(use)
        assert said_by_child(lambda: publisher.close()) == "done", "it is the parent's to close"
        publisher.publish(*EVENTS[1:])
        assert publisher.wait_stored(WAIT_SECONDS)
        wait_for(lambda: daemon.status().events.stored == len(EVENTS), "the parent's events")

        # A worker that lives on does not keep the spool.
        worker = os.fork()
        if worker == 0:
            pause_for_ever()
        try:
            publisher.close()
            Publisher("a", connect=endpoint, state=state).close()
        finally:
            os.kill(worker, signal.SIGKILL)
            os.waitpid(worker, 0)


def pause_for_ever() -> NoReturn:
    while True:
        signal.pause()


def said_by_child(use: Callable[[], object]) -> str:
    """Return the error of ``use`` in a forked child, or "done"."""
    receiving, sending = os.pipe()
    child = os.fork()
    if child == 0:
        said = "another error"
        try:
            use()
            said = "done"
        except BusError as error:
            said = f"{type(error).__name__}: {error}"
        finally:  # whatever it raises, the child must not go on with the tests
            os.write(sending, said.encode())
            os._exit(0)
    os.close(sending)
    with open(receiving) as pipe:
        said = pipe.read()
    os.waitpid(child, 0)
    return said


def test_what_is_wrong_is_refused_before_anything_is_stored(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with pytest.raises(ValueError, match="1 to 64 of the characters"):
        Publisher("the lobby", connect=endpoint, state=tmp_path)
    with pytest.raises(ValueError, match="write it like tcp/"):
        Publisher("a", connect="127.0.0.1", state=tmp_path)
    with Publisher("a", connect=endpoint, state=tmp_path) as publisher:
        with pytest.raises(ValueError, match="this publishes a only"):
            publisher.publish(EVENTS[0], Event("b", "entry", 1.0))
        with pytest.raises(ValueError, match="x"):
            publisher.publish(EVENTS[0], Event("a", "entry", 1.0, 1.5, 0.5))
        with pytest.raises(TypeError, match=r"is no camtopod\.Event"):
            publisher.publish(EVENTS[0], {"camera": "a", "kind": "entry", "t": 1.0})  # type: ignore[arg-type]
        assert publisher.waiting == 0
        with pytest.raises(StateError, match="held by another camtopod process"):
            Publisher("a", connect=endpoint, state=tmp_path)
    publisher.close()
    with pytest.raises(ValueError, match="closed"):
        publisher.publish(EVENTS[0])


def test_a_program_that_never_closes_it_ends_in_peace(tmp_path: Path) -> None:
    program = (
        "from camtopod.client import Event, Publisher\n"
        f"Publisher('a', connect={free_endpoint()!r}, state={str(tmp_path)!r}).publish("
        "Event('a', 'entry', 1.0))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, cwd=ROOT)

    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")
    with Publisher("a", connect=free_endpoint(), state=tmp_path) as publisher:
        assert publisher.waiting == 1
