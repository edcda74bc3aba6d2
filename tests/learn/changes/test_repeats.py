"""Recordings that are played in a loop are noticed, and nothing else is taken for one."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from camtopod.learn.changes import AlarmLog, AlarmState
from camtopod.learn.changes.repeats import KNOWN_MAX, repeats_of
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.records import Event, Topology
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.topology import POSITION_ONE, camera_of, weak_links

LOOPED = {"cam01": 80.0, "cam02": 113.6, "cam03": 150.0}
"""Cameras that play a recording, and its length in seconds."""
START = 1_700_000_000.3
PLACES = ((0.05, 0.8), (0.95, 0.8), (0.5, 0.3))
Rng = np.random.Generator


def played(recording: list[Event], t: float, rng: Rng) -> Iterator[Event]:
    """Yield the events of one play that begins at ``t``, as a grabber sees them again."""
    for event in recording:
        if event.x is None or event.y is None or rng.random() < 0.05:
            continue
        x, y = np.clip(rng.normal((event.x, event.y), 0.005), 0, 1)
        seen = t + event.t + float(rng.normal(0, 0.04))
        yield Event(event.camera, event.kind, seen, float(x), float(y))


def half_an_hour(pause: tuple[float, float], seed: int) -> list[Event]:
    """Return half an hour of three cameras that play recordings, and of two real ones.

    pause (seconds): range of the pauses between two plays; with pauses, the second camera plays the
        recording of the first, at the same times.
    """
    real, _ = simulate(SimSettings(5, 0.5, seed, start=START, objects_per_second=0.1))
    events = [event for event in real if event.camera not in LOOPED]
    for number, (camera, length) in enumerate(LOOPED.items()):
        shared = camera == "cam02" and pause[1] > 0
        source, seconds = ("cam01", LOOPED["cam01"]) if shared else (camera, length)
        recording = [
            Event(camera, e.kind, e.t - START - 600.0, e.x, e.y)
            for e in real
            if e.camera == source and 600.0 <= e.t - START < 600.0 + seconds
        ]
        rng = np.random.default_rng((seed, number - shared))
        t = START
        while t < START + 1_800.0 - seconds:
            events += played(recording, t, rng)
            t += seconds + float(rng.uniform(*pause))
    return sorted(events, key=lambda event: event.t)


def learned(events: list[Event]) -> Topology:
    learner = Learner(Settings(refit_share=0.8))  # few versions: each takes a while
    for event in events:
        learner.receive(event)
    learner.flush()
    assert learner.topology is not None
    return learner.topology


@pytest.mark.parametrize("pause", [(0.0, 0.0), (10.0, 45.0)], ids=["no pauses", "random pauses"])
def test_recordings_in_a_loop_are_said_and_their_links_are_provisional(
    pause: tuple[float, float],
) -> None:
    topology = learned(half_an_hour(pause, seed=4))
    assert topology.links
    alarms = [alarm for alarm in topology.alarms or [] if alarm.kind == "camera_repeats"]

    assert sorted(alarm.subject for alarm in alarms) == sorted(LOOPED), "each once, no real one"
    assert all("a recording in a loop?" in alarm.detail for alarm in alarms)
    if pause == (0.0, 0.0):
        assert {alarm.detail.split(" s:")[0] for alarm in alarms} == {
            f"repeats itself every {length:.1f}" for length in LOOPED.values()
        }
    links = [*topology.links, *weak_links(topology)]
    looped = [link for link in links if {camera_of(link.from_), camera_of(link.to)} & {*LOOPED}]
    assert looped
    assert all("repeats itself every" in link.provisional for link in looped)
    assert [link for link in links if link.provisional] == looped


# --- what is no loop


def passing(t: float, way: tuple[int, int], stay: float, rng: Rng) -> list[tuple[float, ...]]:
    """Return entry and exit of somebody: time, 1 for an entry, position."""
    begin, end = (np.clip(rng.normal(PLACES[place], 0.01), 0, 1) for place in way)
    return [(t, 1, *begin), (t + stay, 0, *end)]


def buses(rng: Rng) -> Iterator[tuple[float, ...]]:
    """Yield a bus every ten minutes, to within half a second."""
    for k in range(150):
        yield from passing(600.3 * k + rng.normal(0, 0.5), (0, 1), rng.normal(20, 0.5), rng)


def guard(rng: Rng) -> Iterator[tuple[float, ...]]:
    """Yield a guard's round every half an hour, each leg to within a second."""
    legs = ((0, (0, 1)), (40, (1, 2)), (90, (2, 0)), (150, (0, 2)), (200, (2, 1)), (260, (1, 0)))
    for k in range(40):
        t = 1_800.3 * k + rng.normal(0, 60)
        for after, way in legs:
            yield from passing(t + after + rng.normal(0, 1.0), way, rng.normal(12, 0.3), rng)


def door(rng: Rng) -> Iterator[tuple[float, ...]]:
    """Yield somebody every ten seconds through one door, to within half a second."""
    for k in range(300):
        yield from passing(10.01 * k + rng.normal(0, 0.5), (0, 0), rng.normal(5, 0.5), rng)


def sign(rng: Rng) -> Iterator[tuple[float, ...]]:
    """Yield a sign that is switched on and off every half minute, exactly."""
    for k in range(300):
        yield from [(30.01 * k, 1, *PLACES[0]), (30.01 * k + 10.0, 0, *PLACES[0])]


def lamp(rng: Rng) -> Iterator[tuple[float, ...]]:
    """Yield people, and what a lamp with a timer shows at five places at once."""
    for t in np.cumsum(rng.exponential(120, 200)):
        yield from passing(float(t), (0, 1), rng.gamma(9, 0.6), rng)
    for t in np.cumsum(rng.exponential(600, 40) + 70):
        for k in range(5):
            yield from [(t + 0.05 * k, 1, 0.1 + 0.15 * k, 0.5)]
            yield from [(t + 60 + 0.05 * k, 0, 0.1 + 0.15 * k, 0.5)]


def traffic_lights(rng: Rng) -> Iterator[tuple[float, ...]]:
    """Yield cars that start one after the other, every ninety seconds; times in half seconds."""
    for k in range(60):
        for m in range(rng.integers(3, 10)):
            stay = 8 + rng.normal(0, 0.5)
            for t, *rest in passing(90 * k + 2.1 * m + rng.normal(0, 0.4), (0, 1), stay, rng):
                yield (round(2 * t) / 2, *rest)


@pytest.mark.parametrize(
    "events", [buses, guard, door, sign, lamp, traffic_lights], ids=lambda events: events.__name__
)
def test_a_rhythm_is_no_loop(events: Callable[[Rng], Iterator[tuple[float, ...]]]) -> None:
    t, entry, x, y = np.array(sorted(events(np.random.default_rng(1)))).T
    px, py = (np.round(values * POSITION_ONE).astype(np.int32) for values in (x, y))
    for n in np.linspace(40, len(t), 12).astype(int):
        newest = slice(max(n - KNOWN_MAX, 0), n)
        assert repeats_of(t[newest], entry[newest] > 0, px[newest], py[newest]) == ""


def test_a_camera_is_free_of_its_loop_when_those_events_have_left_the_window() -> None:
    log = AlarmLog(AlarmState())
    found = "repeats itself every 80.0 s"
    kinds = [
        [kind for kind, *_ in log.repeats(t, oldest, ["a"], [one])]
        for t, oldest, one in [
            (100.0, 0.0, found),
            (200.0, 0.0, found),
            (300.0, 199.0, ""),
            (400.0, 201.0, ""),
            (500.0, 201.0, found),
        ]
    ]
    assert kinds == [["camera_repeats"], [], [], [], ["camera_repeats"]]
