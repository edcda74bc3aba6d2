"""No event is too late: what comes late enters the window at its time."""

from __future__ import annotations

import random
from collections import defaultdict
from functools import lru_cache

import pytest
from synthetic_events import passage

from camtopod.event_time import microseconds
from camtopod.learn.learner import Learner
from camtopod.learn.rewinding import rewind
from camtopod.learn.settings import Settings
from camtopod.learn.window import Window, reorder_buffer
from camtopod.records import Event
from camtopod.sim.settings import SimSettings
from camtopod.sim.simulation import simulate

T0 = 1e6
SITE = SimSettings(cameras=5, hours=0.25, seed=3)
Learned = tuple[list[object], dict[object, tuple[float, float]]]


def learned(events: list[Event]) -> Learner:
    learner = Learner(Settings(refit_share=1.0))
    for event in events:
        learner.receive(event)
    learner.flush()
    return learner


def content(learner: Learner) -> Learned:
    """Return the zones by place, and the links by the places of their ends."""
    topology = learner.topology
    assert topology is not None
    place = {zone.id: (zone.camera, zone.x, zone.y) for zone in topology.zones}
    zones = [(*place[zone.id], zone.entries, zone.exits) for zone in topology.zones]
    links = {
        (place[link.from_], place[link.to], link.relation): (link.probability, link.transitions)
        for link in topology.links
    }
    return sorted(zones, key=str), links  # type: ignore[return-value]


@lru_cache
def in_order() -> tuple[list[Event], Learned]:
    events = list(simulate(SITE)[0])
    zones, links = content(learned(events))
    assert len(links) > 20
    return events, (zones, links)


@pytest.mark.parametrize("stretch", [1, 30, 10_000])
def test_any_interleaving_of_the_cameras_ends_with_the_same(stretch: int) -> None:
    """Cameras come one after the other, in stretches, or event by event."""
    chance = random.Random(stretch)
    events, (zones, links) = in_order()
    waiting: dict[str, list[Event]] = defaultdict(list)
    for event in events:
        waiting[event.camera].append(event)
    mixed: list[Event] = []
    while waiting:
        camera = chance.choice(sorted(waiting))
        mixed += waiting[camera][:stretch]
        waiting[camera] = waiting[camera][stretch:]
        if not waiting[camera]:
            del waiting[camera]

    learner = learned(mixed)
    assert learner.statistics()["learned"] == len(events)
    assert content(learner)[0] == zones
    found = content(learner)[1]
    assert found.keys() == links.keys()
    assert all(found[link] == pytest.approx(links[link], abs=1e-6) for link in links)


def test_late_events_make_a_version_due_and_are_only_counted_as_late() -> None:
    events, _ = in_order()
    early, late = ([e for e in events if (e.camera == "cam01") is is_it] for is_it in (False, True))
    learner = Learner(Settings(refit_share=0.1))
    for event in early:
        learner.receive(event)
    before = learner.updates()[-1]
    assert "cam01" not in {camera.id for camera in before.cameras}
    for event in late:
        learner.receive(event)
    learner.advance(events[-1].t + 60.0)
    [version] = learner.updates()[-1:]
    assert "cam01" in {camera.id for camera in version.cameras}
    assert version.events == len(events)
    assert learner.statistics()["late"] > 0.8 * len(late)
    assert learner.next_deadline() is None


def test_backlogs_are_waited_for_and_events_in_memory_are_limited(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    events, (zones, _) = in_order()
    early, late = ([e for e in events if (e.camera == "cam01") is is_it] for is_it in (False, True))

    def learn(until_done: list[Event]) -> Learner:
        learner = Learner(Settings(refit_share=1.0))
        learner.wait_for({"", "cam01"})
        for event in early:
            learner.receive(event)
        assert not until_done or not learner.updates(), "this waits"
        for event in until_done:
            learner.receive(event)
        learner.wait_for(set())
        return learner

    waited, plain = learn(late), learned(events)
    waited.flush()
    assert waited.statistics()["late"] == 0
    assert [t.digest for t in waited.updates()] == [t.digest for t in plain.updates()]
    assert content(waited)[0] == zones

    monkeypatch.setattr(reorder_buffer, "HELD_EVENTS_MAX", 200)
    assert learn([]).updates()


def test_held_events_are_looked_at_a_few_times_however_many_ticks_are_released(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    learner = Learner(Settings(version_seconds=1.0, refit_hours=24.0))
    learner.wait_for({""})
    for k in range(300):
        learner.receive(Event("ab"[k % 2], "entry", T0 + k))
    calls = 0

    def counted(t: float) -> int:
        nonlocal calls
        calls += 1
        return microseconds(t)

    monkeypatch.setattr(reorder_buffer, "microseconds", counted)
    learner.wait_for(set())
    assert learner.statistics()["learned"] > 290
    assert calls < 20 * 300


def test_a_clock_that_is_set_back_takes_event_time_back_while_backlogs_are_waited_for() -> None:
    """What the wrong clock has stamped makes nothing late, though the watermark is before it."""
    learner = learned([])
    day = 86_400.0
    for k in range(100):
        learner.receive(Event("ab"[k % 2], "entry", T0 + k))
    learner.wait_for({"", "a"})
    for k in range(100, 200):
        learner.receive(Event("b", "entry", T0 + k + day))

    state = rewind(learner.save(), T0 + 300.0)
    learner = Learner()
    learner.load(state)
    assert not learner.event_time().waited
    for k in range(300, 600):
        learner.receive(Event("ab"[k % 2], "entry", T0 + k))
    assert learner.statistics()["late"] == 0
    assert learner.statistics()["watermark"] == pytest.approx(T0 + 600.0, abs=10.0)


def test_a_passage_that_comes_late_is_one_passage() -> None:
    window = Window(100)
    events = [*passage("a", T0, 5.0, "1"), *passage("b", T0 + 20.0, 5.0, "2")]
    late = passage("c", T0 + 3.0, 9.0, "3")
    for batch in (events[:3], late[:1], events[3:], late[1:]):
        window.append([(microseconds(event.t), event) for event in batch])
    assert [t - microseconds(T0) for t in window.column("t").tolist()] == [
        microseconds(t) for t in (0.0, 3.0, 5.0, 12.0, 20.0, 25.0)
    ]
    entries = window.entries_of_exits().tolist()
    assert [entries[row] for row in (2, 3, 5)] == [0, 1, 4]
    assert not window.state.open
    assert [window.rows_of_camera(camera).tolist() for camera in range(3)] == [
        [0, 2],
        [4, 5],
        [1, 3],
    ]


def test_an_event_without_a_number_that_comes_again_counts_once() -> None:
    events = [Event("ab"[k % 2], "entry", T0 + k, 0.1 * (k % 7), 0.5) for k in range(200)]
    learner = learned(events)
    for event in events[:190]:
        learner.receive(event)
    learner.flush()
    counts = learner.statistics()
    assert counts["learned"] == counts["accepted"] == 200
    assert (counts["duplicate"], counts["late"]) == (190, 0)
