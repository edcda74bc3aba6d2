"""Cameras that are delayed against each other, and batches that are repeated: one result.

Each camera's own events come in the order of their numbers. The requests go to the daemon's path of
an event, with a real journal; what comes out of it goes to a plain learner.
"""

from __future__ import annotations

import contextlib
import itertools
import random
import statistics
import time
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
import pytest
from grabber import Delays, learned_state, publisher_on
from intake_bench import LATENESS, IntakeBench, Request
from real_daemon import OPEN, RealDaemon, readiness, script, status_over
from serving import T0, free_endpoint, numbered, wait_for, walkers
from sizes import size

from camtopod.codec import to_msgpack
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.records import Event
from camtopod.serve.ingest import backlogs
from camtopod.serve.requests import Batch

SPAN_SECONDS = 600.0
CLOSING = [Event(camera, "entry", T0 + 100 * SPAN_SECONDS) for camera in "yz"]
EVENTS = numbered([*walkers(14, seconds=SPAN_SECONDS), *CLOSING])
HOUR_BEHIND = 3590.0
"""How far a slow camera is behind, seconds; said to be 60 minutes."""
SOON_SECONDS = 1.0
"""From an exit to its prediction, and to its place on the disk, beside a camera that is behind."""
LEARN = Settings(version_seconds=20.0, refit_share=0.3, lateness_seconds=LATENESS)
Deliver = Callable[[Path, random.Random], bool]


@pytest.fixture(autouse=True)
def _time_for_backlogs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here the daemon waits for backlogs as it does in service."""
    monkeypatch.setattr(backlogs, "SETTLE_SECONDS", 5.0)


def versions(inputs: Sequence[Event | frozenset[str] | None]) -> list[tuple[int, str]]:
    """Return number and digest of the versions of a plain learner.

    inputs: events, and the cameras that the learner waits for from there on.
    """
    learner = Learner(LEARN, "site", "e")
    for one in inputs:
        if isinstance(one, Event):
            learner.receive(one)
        elif one is not None:
            learner.wait_for(one)
    return [(version.version, version.digest) for version in learner.updates()]


EXPECTED = versions(EVENTS)


def batch(events: list[Event], more: int = 0) -> Batch:
    """Return a request with events that follow each other."""
    pairs = [(event.seq or 0, to_msgpack(event)) for event in events]
    return Batch("h1", "b1", pairs[0][0] - 1, pairs, more)


def is_one_result(bench: IntakeBench, requests: list[Request]) -> bool:
    """Check that each event was stored once, and all is answered; compare what was learned."""
    stored = bench.stored
    bench.stop()
    seqs = {camera: 0 for _, camera, _ in stored}
    for _, camera, seq in stored:
        assert seq == seqs[camera] + 1
        seqs[camera] = seq
    assert sum(seqs.values()) == len(EVENTS)
    assert all(request.answer for request in requests)
    return versions([received.event or received.waited for received in bench.learned]) == EXPECTED


def greeted(directory: Path, wall: float) -> IntakeBench:
    """Return a daemon's path of an event to which all cameras have said hello."""
    bench = IntakeBench(directory, wall=wall)
    for camera in sorted({event.camera for event in EVENTS}):
        bench.hello(camera, ["b1"])
    return bench


def delayed(directory: Path, chance: random.Random, seconds_max: float = LATENESS) -> bool:
    """Deliver each event up to ``seconds_max`` after it happened, some together, some again.

    Returns True if the result is the expected one.
    """
    # Draw when each event arrives: not before the earlier ones of its camera.
    last: dict[str, float] = {}
    arrivals: list[tuple[float, str, Event]] = []
    for event in EVENTS:
        at = max(last.get(event.camera, 0.0), event.t + chance.uniform(0.0, 0.999 * seconds_max))
        last[event.camera] = at
        arrivals.append((at, event.camera, event))
    arrivals.sort(key=lambda arrival: arrival[0])

    # Send them; some requests are repeated later.
    bench = greeted(directory, EVENTS[0].t)
    sent: list[tuple[str, Batch]] = []
    requests = []
    for camera, run in itertools.groupby(arrivals, key=lambda arrival: arrival[1]):
        together = list(run)
        bench.tick(max(0.0, together[0][0] - bench.wall))
        sent.append((camera, batch([event for _, _, event in together])))
        again = chance.choices(sent, k=chance.choice((0, 0, 1, 2)))
        requests += [bench.ask(*one) for one in (sent[-1], *again)]
    bench.tick(1.0)
    return is_one_result(bench, requests)


def caught_up(directory: Path, chance: random.Random) -> bool:
    """Deliver everything long after it happened, by requests in any interleaving.

    Returns True if the result is the expected one.
    """
    bench = greeted(directory, EVENTS[-1].t + 1_000.0)
    left: dict[str, deque[Event]] = {}
    for event in EVENTS:
        left.setdefault(event.camera, deque()).append(event)
    pending: dict[str, Request] = {}
    requests = []
    while any(left.values()):
        free = [c for c in left if left[c] and (c not in pending or pending[c].answer)]
        if free and chance.random() < 0.9:
            camera = chance.choice(free)
            waiting = left[camera]
            events = [waiting.popleft() for _ in range(min(len(waiting), chance.randint(1, 9)))]
            pending[camera] = bench.ask(camera, batch(events, len(waiting)))
            requests.append(pending[camera])
        else:
            bench.tick(0.5)
    bench.tick(6.0)
    return is_one_result(bench, requests)


@pytest.mark.parametrize("deliver", [delayed, caught_up])
def test_any_order_gives_one_result(deliver: Deliver, quick_path: Path) -> None:
    for seed in range(2):
        assert deliver(quick_path / str(seed), random.Random(seed)), f"seed {seed}"


def test_a_slow_catch_up_delays_nobody(quick_path: Path) -> None:
    """An hour behind, at 1.05 times real time; other cameras' exits are heard, and stored."""
    bench = IntakeBench(quick_path)
    for camera in ("slow", "live"):
        bench.hello(camera)
    began, reached = bench.wall, -3600.0
    for second in range(1, 421):
        bench.tick(1.0)
        reached += 1.05
        ago = reached - (bench.wall - began)
        bench.send("slow", after=second - 1, times={second: ago}, more=10_000)
        bench.publish("live", kind="exit", boot="b1", seq=second, spooled=True)
        assert bench.heard[-1].camera == "live"
        assert bench.store({second: 0.0}, camera="live", after=second - 1).have == {"b1": second}
    assert len(bench.heard) == 2 * 420
    assert bench.waits == [["", "slow"], ["slow"], []], "a minute's trial"
    reason = bench.intake.cameras.behind_reason(bench.wall, bench.now)
    assert reason.startswith("camera slow catches up and is 60 min behind:")
    bench.stop()


@pytest.mark.campaign
@pytest.mark.timeout(600)
def test_a_camera_an_hour_behind_delays_nobody(quick_path: Path) -> None:
    """A daemon, a camera that catches up at 1.05 times real time, and others that are live."""
    learned_state(quick_path / "state", 20)
    (quick_path / "spool").mkdir()
    *live, slow = [f"cam{number:04d}" for number in range(4)]
    health = free_endpoint().removeprefix("tcp/")
    words = f"camera {slow} catches up and is 60 min behind: its events are learned as they come"
    with contextlib.ExitStack() as stack:
        daemon = RealDaemon(quick_path, f'{OPEN}[health]\nlisten = "{health}"\n')
        stack.callback(daemon.stop)
        bus = stack.enter_context(daemon.dial())
        publisher = stack.enter_context(publisher_on(bus, quick_path / "spool", live))
        delays, stored = Delays(bus), []
        figures = (daemon.endpoint, slow, HOUR_BEHIND, 1.05, size("BEHIND_SECONDS", 20))
        process = stack.enter_context(script("traffic.py", "behind", *figures))
        stack.callback(process.kill)
        wait_for(lambda: words in status_over(bus)["reason"], "the status to name the camera")
        status, [reason] = readiness(health)
        assert (status, words in reason) == (503, True)

        while process.poll() is None:
            began = time.monotonic()
            delays.walk(publisher, live, len(live), 1000.0)
            assert publisher.wait_stored(SOON_SECONDS), f"not stored within {SOON_SECONDS} s"
            stored.append(time.monotonic() - began)
        seconds = delays.await_all()
        delivered = int(process.communicate()[0])
        cameras = status_over(bus)["cameras"]

    print(
        f"{len(seconds)} exits beside {delivered} events of the past:"
        f" predicted after {statistics.median(seconds):.4f} s, {max(seconds):.4f} at most;"
        f" stored after {statistics.median(stored):.4f} s, {max(stored):.4f} at most"
    )
    assert [cameras[name]["events"] for name in (*live, slow)] == [*[len(stored)] * 3, delivered]
    assert delivered > 0
    assert len(seconds) == len(live) * len(stored) > 0
    assert max(seconds) < SOON_SECONDS
    assert words in "".join(daemon.said)


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("deliver", [delayed, caught_up])
def test_campaign_of_orders(deliver: Deliver, tmp_path_factory: pytest.TempPathFactory) -> None:
    first = size("SEED", 100)
    for seed in range(first, first + size("DISORDER", 200)):
        assert deliver(tmp_path_factory.mktemp("order"), random.Random(seed)), f"seed {seed}"


def test_there_is_something_to_get_wrong(quick_path: Path) -> None:
    """The canaries: one event in another place shows, and so do delays beyond the lateness."""
    assert len(EXPECTED) >= 3
    elsewhere = msgspec.structs.replace(EVENTS[10], x=0.5)
    assert versions([*EVENTS[:10], elsewhere, *EVENTS[11:]]) != EXPECTED
    assert not delayed(quick_path, random.Random(1), seconds_max=10 * LATENESS)
