"""Cameras without events are forgotten; those that return get their zone numbers back."""

from __future__ import annotations

import random
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable

import msgspec
import numpy as np
import pytest

from camtopod.learn.learner import Learner
from camtopod.learn.retired_cameras import REPLACEABLE_AFTER_SECONDS
from camtopod.learn.settings import Settings
from camtopod.learn.snapshot import pack, unpack
from camtopod.records import Event, Topology

RARE = {"refit_hours": 120.0, "refit_share": 2.0}
"""Few versions, so that a test of many days is quick."""
T0 = 1_700_000_000.0
HOUR, DAY = 3600.0, 86_400.0
PLACES = {"hall": ((0.1, 0.2), (0.9, 0.8)), "yard": ((0.5, 0.1), (0.5, 0.9), (0.1, 0.9))}


def entry(camera: str, t: float, **more: object) -> Event:
    return Event(camera, "entry", t, 0.5, 0.5, **more)  # type: ignore[arg-type]


def passages(start: float, cameras: Iterable[str] = PLACES, number: int = 100) -> list[Event]:
    """Return objects that appear and leave at the places of each camera, one every 20 s."""
    rng = np.random.default_rng(1)
    events = []
    for k in range(number):
        for camera in cameras:
            places = PLACES[camera]
            for kind, at, later in (
                ("entry", places[k % len(places)], 0.0),
                ("exit", places[-1 - k % 2], 4.0),
            ):
                x, y = (
                    float(v) for v in np.clip(np.array(at) + 0.01 * rng.standard_normal(2), 0, 1)
                )
                events.append(Event(camera, kind, start + 20.0 * k + later, x, y, str(k)))  # type: ignore[arg-type]
    return sorted(events, key=lambda event: event.t)


def told(learner: Learner, events: Iterable[Event]) -> list[Topology]:
    for event in events:
        learner.receive(event)
    learner.flush()
    return learner.updates()


def zones_of(topology: Topology, camera: str) -> dict[str, tuple[float, float]]:
    """Return the zones' places, to a tenth."""
    return {
        zone.id: (round(zone.x or 0.0, 1), round(zone.y or 0.0, 1))
        for zone in topology.zones
        if zone.camera == camera
    }


def names_known(learner: Learner) -> set[str]:
    """Return every camera of which the learner has more than its zone numbers."""
    state = learner.save()
    assert len(state.cameras) <= len(state.window.cameras) == len(state.window.seen)
    assert len(state.clocks.clocks.offset) <= len(state.window.cameras)
    intake = {*state.intake.newest, *state.intake.numbers}
    return {*state.window.cameras, *intake, *(event.camera for event in state.intake.held)}


# --- names that have left ---


def test_names_that_have_left_take_no_places() -> None:
    learner = Learner(Settings(cameras_max=50, **RARE))
    verdicts = Counter(
        learner.receive(entry(f"name{k}", T0 + k, boot="b", seq=1)) for k in range(60)
    )
    assert verdicts == {"accepted": 50, "refused": 10}
    told(learner, [entry("name0", T0 + day * DAY) for day in range(1, 40)])
    assert learner.receive(entry("new", T0 + 40 * DAY)) == "accepted"
    learner.flush()
    assert learner.topology is not None
    assert [camera.id for camera in learner.topology.cameras] == ["name0", "new"]
    assert names_known(learner) == {"name0", "new"}
    assert learner.statistics()["cameras"] == 2


@pytest.mark.parametrize(("window_days", "days"), [(3.0, 3), (10.0, 10)])
def test_a_camera_without_events_stays_for_a_while(window_days: float, days: int) -> None:
    """Also if busy cameras have pushed its events out of the window: it is listed without zones."""
    learner = Learner(
        Settings(window_hours=24.0 * window_days, window_events=50, window_camera_events=1, **RARE)
    )
    told(learner, passages(T0, ["yard"], 20))
    told(learner, [entry("hall", T0 + HOUR * hour) for hour in range(1, 24 * days)])
    assert learner.topology is not None
    assert [(c.id, len(c.zones)) for c in learner.topology.cameras] == [("hall", 1), ("yard", 0)]
    told(learner, [entry("hall", T0 + days * DAY + HOUR * hour) for hour in (1, 2)])
    assert [(c.id, len(c.zones)) for c in learner.topology.cameras] == [("hall", 1)]


def test_at_the_limit_the_camera_with_the_fewest_events_gives_its_place() -> None:
    learner = Learner(Settings(cameras_max=4, **RARE))
    told(learner, passages(T0))
    for k, name in enumerate(("door", "invented")):
        learner.receive(entry(name, T0 + 4000 + k))
    learner.receive(entry("door", T0 + 4002))
    start = T0 + 4002 + REPLACEABLE_AFTER_SECONDS
    assert learner.receive(entry("late", start - 60)) == "refused", "none has been silent for long"
    told(learner, [entry("hall", start + 120), entry("hall", start + 240)])
    assert learner.receive(entry("new", start + 250)) == "accepted"
    assert names_known(learner) == {"hall", "yard", "door", "new"}
    assert learner.receive(entry("newer", start + 250)) == "accepted"
    assert names_known(learner) == {"hall", "yard", "new", "newer"}
    told(learner, passages(start + 300, ["hall"]))
    assert learner.topology is not None
    assert len(zones_of(learner.topology, "yard")) == 3, "what was learned of the others stays"


# --- what stays ---


@pytest.mark.parametrize("days", [2.5, 20.0], ids=["weekend", "holiday"])
def test_a_camera_that_returns_has_its_zones_back(days: float) -> None:
    """Whether others went on meanwhile or the whole site was closed."""
    for busy in (False, True):
        learner = Learner(Settings(**RARE))
        told(learner, passages(T0))
        assert learner.topology is not None
        before = {camera: zones_of(learner.topology, camera) for camera in PLACES}
        assert [len(before[camera]) for camera in PLACES] == [2, 3]
        back = T0 + days * DAY
        if busy:
            told(
                learner, [entry("other", T0 + hour * HOUR) for hour in range(2, int(days * 24), 3)]
            )
            assert ("hall" in names_known(learner)) == (days < 14)
        told(learner, passages(back, ["yard", "hall"]))
        assert {camera: zones_of(learner.topology, camera) for camera in PLACES} == before
        told(
            learner,
            [msgspec.structs.replace(e, x=e.y, y=e.x) for e in passages(back + 20 * DAY, ["hall"])],
        )
        assert not before["hall"].keys() - {"hall/1", "hall/2"}


def test_a_camera_that_fell_silent_is_said_to_be_so_and_to_be_back() -> None:
    """Though it has been forgotten since."""
    learner = Learner(Settings(**RARE))
    told(learner, passages(T0))
    told(learner, passages(T0 + 2 * HOUR, ["hall"], 400))
    told(learner, [entry("hall", T0 + hour * HOUR) for hour in range(24, 20 * 24)])
    assert names_known(learner) == {"hall"}
    told(learner, passages(T0 + 20 * DAY))
    assert learner.topology is not None
    alarms = [alarm.kind for alarm in learner.topology.alarms or [] if alarm.subject == "yard"]
    assert alarms == ["camera_silent", "camera_back"]


def test_a_camera_can_be_forgotten_by_name() -> None:
    """Nothing is left of it, not even its zone numbers."""
    learner = Learner(Settings(**RARE))
    told(learner, passages(T0))
    learner.erase({"yard", "never heard of"})
    assert names_known(learner) == {"hall"}
    assert b"yard" not in msgspec.msgpack.encode(learner.save().retired)
    told(learner, passages(T0 + HOUR + 1000))
    assert learner.topology is not None
    assert sorted(zones_of(learner.topology, "yard")) == ["yard/1", "yard/2", "yard/3"]
    told(learner, [entry("hall", T0 + 30 * DAY)])
    assert list(learner.save().retired) == ["yard"]
    learner.erase({"yard"})
    assert learner.save().retired == {}


# --- the same events, the same versions ---


def comings_and_goings(chance: random.Random) -> list[Event]:
    """Return some weeks of events of seven cameras, a few of them at a time."""
    events, t = [], T0
    for _ in range(40):
        t += chance.choice([10.0, 600.0, 9 * HOUR, 3 * DAY])
        camera = chance.choice("abcdefg"[: chance.randint(1, 7)])
        for k in range(chance.choice([1, 4])):
            x = chance.choice([0.2, 0.8])
            kind = chance.choice(["entry", "exit"])
            events.append(Event(camera, kind, t + k, x, x, str(k % 2), "boot", len(events)))  # type: ignore[arg-type]
    return events


@pytest.mark.parametrize(("seed", "cameras_max"), [(1, 2), (2, 3), (1, 5), (2, 7)])
def test_saved_and_loaded_in_between_the_versions_are_the_same(cameras_max: int, seed: int) -> None:
    chance = random.Random(seed)
    events = comings_and_goings(chance)
    rules = Settings(window_hours=24.0, refit_hours=6.0, cameras_max=cameras_max)
    straight, broken, made = Learner(rules, "s", "e"), Learner(rules, "s", "e"), list[Topology]()
    for event in events:
        assert broken.receive(event) == straight.receive(event)
        made += broken.updates()
        if chance.random() < 0.3:
            saved, broken = pack(broken.save()), Learner(rules, "s", "e")
            broken.load(unpack(saved))
        assert len(names_known(straight)) <= cameras_max
    made += told(broken, [])
    assert [(v.version, v.digest) for v in made] == [
        (v.version, v.digest) for v in told(straight, [])
    ]
    assert pack(unpack(pack(broken.save()))) == pack(unpack(pack(straight.save())))
    newest = {event.camera: event.t for event in events}
    lately = {camera for camera, t in newest.items() if t >= events[-1].t - DAY}
    assert names_known(straight) <= lately
    if cameras_max == 7:
        assert names_known(straight) == lately != set(newest)


# --- memory ---

TEN_THOUSAND = """
from pathlib import Path
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.records import Event

def most():  # of this process: resource.getrusage begins with what the process that started it had
    return int(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0]) // 1024

learner = Learner(Settings(refit_share=100.0, refit_hours=100.0))
before, t = most(), 1_700_000_000.0
for k in range(10_000):
    t += 0.5
    learner.receive(Event(f"name{k}", "entry", t, 0.5, 0.5))
    learner.receive(Event("lobby", "entry", t, 0.5, 0.5))
print(most() - before, len(learner.save().window.cameras))
learner.flush()
print(most() - before)
"""


def test_ten_thousand_names_take_little_memory() -> None:
    run = subprocess.run(
        [sys.executable, "-c", TEN_THOUSAND], capture_output=True, text=True, check=True
    )
    learned, names, fitted = (int(figure) for figure in run.stdout.split())
    assert names > 9_000
    assert learned < 100, "MB while they are learned"
    assert fitted < 200, "MB at most, for a version"
