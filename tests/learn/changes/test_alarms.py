"""Alarms: each once, in the first version that shows it; silent cameras; none at the start."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from camtopod.learn.changes.alarms import AlarmLog, AlarmState
from camtopod.learn.changes.change_points import ChangePoint
from camtopod.learn.changes.silence import CameraSilences, find_silences, silent_odds
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.learn.snapshot import pack, unpack
from camtopod.records import Camera, Event, Topology
from camtopod.topology import weak_links
from camtopod.topology.versions import ALARMS_KEPT_MAX

ZONES = ["a/1", "b/1", "b/2"]
OPENED, CLOSED = ChangePoint(0, 1, 100.0, 0.0, 0.5, 20.0), ChangePoint(0, 1, 300.0, 0.5, 0.0, 20.0)


def said(log: AlarmLog) -> list[tuple[int, str, str]]:
    return [(alarm.version, alarm.kind, alarm.subject) for alarm in log.state.newest]


# --- links ---


def test_a_change_is_said_once_and_the_next_one_again() -> None:
    log = AlarmLog(AlarmState())
    log.add(5, 200.0, log.links(200.0, [OPENED], ZONES, {(0, 1)}, 0.03))
    log.add(6, 250.0, log.links(250.0, [OPENED._replace(since=90.0)], ZONES, {(0, 1)}, 0.03))
    log.add(7, 400.0, log.links(400.0, [CLOSED], ZONES, set(), 0.03))
    log.add(8, 500.0, log.links(500.0, [CLOSED._replace(since=310.0)], ZONES, set(), 0.03))
    assert said(log) == [(5, "link_opened", "a/1->b/1"), (7, "link_closed", "a/1->b/1")]


@pytest.mark.parametrize(
    ("change", "joined", "kind"),
    [
        (ChangePoint(0, 2, 100.0, 0.3, 0.6, 20.0), True, "link_changed"),
        (ChangePoint(0, 2, 100.0, 0.50, 0.55, 20.0), True, None),  # slight
        (ChangePoint(0, 2, 100.0, 0.3, 0.6, 20.0), False, None),  # no link now
        (ChangePoint(0, 2, 100.0, 0.02, 0.0, 20.0), False, None),  # none before or after
        (ChangePoint(0, 2, 100.0, 0.0, 0.5, 20.0), False, None),  # not published yet
        (ChangePoint(0, 2, 100.0, 0.08, 0.0, 20.0), False, "link_closed"),
        (ChangePoint(0, 2, 100.0, 0.01, 0.08, 20.0), True, "link_opened"),
    ],
)
def test_what_counts_as_which_change(change: ChangePoint, joined: bool, kind: str | None) -> None:
    log = AlarmLog(AlarmState())
    log.add(4, 50.0, log.links(50.0, [], ZONES, {(0, 2)} if change.before >= 0.03 else set(), 0.03))
    log.add(5, 200.0, log.links(200.0, [change], ZONES, {(0, 2)} if joined else set(), 0.03))
    assert [alarm.kind for alarm in log.state.newest] == ([] if kind is None else [kind])


def test_only_the_newest_are_kept() -> None:
    log = AlarmLog(AlarmState())
    for version in range(2 * ALARMS_KEPT_MAX):
        log.add(version, float(version), [("camera_moved", "a", "")])
    assert [alarm.version for alarm in log.state.newest] == list(
        range(ALARMS_KEPT_MAX, 2 * ALARMS_KEPT_MAX)
    )


# --- cameras ---


def heard(*times: NDArray[np.float64]) -> list[CameraSilences]:
    """Return the silences of cameras with events at these times."""
    t, camera = (
        np.concatenate(times),
        np.repeat(np.arange(len(times)), [len(part) for part in times]),
    )
    order = np.argsort(t, kind="stable")
    return find_silences(t[order], camera[order], len(times))


def poisson(rate: float, begin: float, end: float, seed: int) -> NDArray[np.float64]:
    chance = np.random.default_rng(seed)
    return np.sort(chance.uniform(begin, end, chance.poisson(rate * (end - begin))))


def test_a_camera_that_stops_is_silent() -> None:
    busy, lost = poisson(0.1, 0, 40_000, 1), poisson(0.05, 0, 30_000, 2)
    first, second = heard(busy, lost)
    assert first[:2] == ([], False)
    assert second == CameraSilences([(lost[-1], np.inf)], True, lost[-1])
    assert silent_odds([first, second], 0.0, 40_000.0) == pytest.approx([0.0, 1 / 3], rel=0.01)


def test_nobody_is_silent_by_chance_or_at_night() -> None:
    for seed in range(30):
        rates = [0.001, 0.05, 0.001, 0.05]
        day = np.concatenate(
            [poisson(r, 40_000 * k, 40_000 * (k + 1), 9 * seed + k) for k, r in enumerate(rates)]
        )
        quiet = poisson(0.002, 0, 160_000, seed)
        silences = heard(day, day + 0.1, day + 0.2, quiet)
        assert [silence[:2] for silence in silences] == 4 * [([], False)]


def test_a_camera_that_stops_while_an_installation_starts_is_not_said_to_be_silent() -> None:
    """In the first half hour no alarm is raised, as traffic has yet to be learned."""
    log, silent = AlarmLog(AlarmState()), CameraSilences([(100.0, np.inf)], True)
    log.add(1, 900.0, log.cameras([silent], ["a"], 1800.0))
    assert said(log) == []
    log.add(2, 9000.0, log.cameras([CameraSilences([(1900.0, np.inf)], True)], ["a"], 1800.0))
    assert said(log) == [(2, "camera_silent", "a")]


def test_a_camera_is_said_to_be_silent_and_to_be_back_once() -> None:
    log = AlarmLog(AlarmState())
    gone = CameraSilences([(5.0, np.inf)], True, 5.0)
    back = CameraSilences([(5.0, 90.0)], False, 95.0)
    for version, silence in enumerate([CameraSilences([], False), gone, gone, back, back], start=1):
        log.add(
            version,
            10.0 * version,
            log.cameras([CameraSilences([], False), silence], ["a", "b"], 0.0),
        )
    assert said(log) == [(2, "camera_silent", "b"), (4, "camera_back", "b")]
    assert log.state.newest[0].detail == "nothing since 1970-01-01T00:00:05Z", "as in the log"


def test_a_silent_camera_is_not_back_as_its_events_leave_the_window() -> None:
    """Few events prove no silence, however long it is; a new one ends it."""
    steady = poisson(0.1, 0.0, 50_000.0, 3)
    gone = poisson(0.1, 0.0, 10_000.0, 4)
    log = AlarmLog(AlarmState())
    for version, left in enumerate([len(gone), 50, 5, 1, 0], start=1):
        silences = heard(steady[version * 500 :], gone[len(gone) - left :])
        log.add(version, 50_000.0, log.cameras(silences, ["a", "b"], 0.0))
    assert said(log) == [(1, "camera_silent", "b")]
    log.add(6, 50_000.0, log.cameras(heard(steady, steady[-1:]), ["a", "b"], 0.0))
    assert said(log)[1:] == [(6, "camera_back", "b")]


def test_a_clock_is_told_when_it_moves_and_not_when_it_becomes_known() -> None:
    log = AlarmLog(AlarmState())
    for version, (offset, sd) in enumerate(
        [(0.0, None), (30.0, 1.0), (30.9, 0.4), (30.5, 0.2), (30.8, 0.1), (28.0, 0.1), (28.0, 0.1)],
        start=1,
    ):
        cameras = [Camera("a", [], offset, sd), Camera("b", [], 0.0, sd)]
        log.add(version, 10.0 * version, log.clocks(cameras, 0.45))
    assert said(log) == [(6, "clock_changed", "a")]


# --- the whole learner ---


def walkers(begin: float, end: float, way: str, seed: int, way_to: float = 0.8) -> list[Event]:
    """Return objects that leave camera a on its right and may appear at b at ``way`` 8 s later.

    Others come to b independently.
    """
    chance = np.random.default_rng(seed)
    events = []
    places = {"b/left": 0.1, "b/right": 0.9}
    for k, t in enumerate(poisson(0.02, begin, end, seed)):
        x, y = np.clip(0.9 + 0.02 * chance.standard_normal(2), 0, 1)
        events += [
            Event("a", "entry", t - 5, 1 - x, 0.5, f"{way}{k}"),
            Event("a", "exit", t, float(x), float(y), f"{way}{k}"),
        ]
        if chance.random() < way_to:
            events += passage(
                "b", t + float(chance.uniform(7, 9)), places[way], f"{way}{k}", chance
            )
    for number, x in enumerate(places.values(), start=1):
        for k, t in enumerate(poisson(0.01, begin, end, seed + 10 * number)):
            events += passage("b", t, x, f"{way}{number}-{k}", chance)
    return sorted(events, key=lambda event: event.t)


def passage(
    camera: str, t: float, x: float, track: str, chance: np.random.Generator
) -> list[Event]:
    """Return a passage through one view from x to the bottom."""
    noise = 0.02 * chance.standard_normal(4)
    x, y, x2, y2 = (float(v) for v in np.clip(np.array([x, 0.3, 0.5, 0.9]) + noise, 0, 1))
    return [Event(camera, "entry", t, x, y, track), Event(camera, "exit", t + 4, x2, y2, track)]


def versions(events: list[Event]) -> list[Topology]:
    learner = Learner(Settings(version_seconds=300.0, refit_share=0.15), "hq", "01J")
    for event in events:
        learner.receive(event)
    learner.flush()
    return learner.updates()


@pytest.fixture(scope="module")
def rerouted() -> list[Topology]:
    """Return traffic from a to the left of b for three hours, then to the right."""
    return versions(walkers(0, 10_800, "b/left", 1) + walkers(10_800, 18_000, "b/right", 2))


def test_a_way_that_changes_is_told_and_published(rerouted: list[Topology]) -> None:
    last = rerouted[-1]
    left, right = (
        min((z for z in last.zones if z.camera == "b"), key=lambda z: abs((z.x or 0) - x)).id
        for x in (0.1, 0.9)
    )
    alarms = {
        (alarm.kind, alarm.subject.split("->")[1]): alarm
        for alarm in last.alarms or []
        if "link" in alarm.kind
    }
    assert set(alarms) == {("link_closed", left), ("link_opened", right)}
    assert all(10_800 < alarm.t < 14_400 for alarm in alarms.values())
    links = {link.to: link.probability for link in last.links if link.relation != "visible"}
    assert set(links) == {right}
    assert links[right] == pytest.approx(0.8, abs=0.1)
    assert not any(link.to == left and link.from_.startswith("a") for link in weak_links(last))


def test_one_fit_tells_of_a_way_that_changed_within_its_window(rerouted: list[Topology]) -> None:
    learner = Learner(only_last=True)
    for event in walkers(0, 10_800, "b/left", 1) + walkers(10_800, 18_000, "b/right", 2):
        learner.receive(event)
        assert learner.topology is None
    learner.flush()
    [only] = learner.updates()
    kinds = sorted(alarm.kind for alarm in only.alarms or [] if "link" in alarm.kind)
    assert (only.version, kinds, only.score) == (1, ["link_closed", "link_opened"], None)
    assert [link.relation for link in only.links] == [link.relation for link in rerouted[-1].links]


def test_the_start_tells_nothing(rerouted: list[Topology]) -> None:
    early = [version for version in rerouted if version.as_of <= 10_800]
    assert len(early) > 5
    assert not any(version.alarms for version in early)


def test_a_lost_camera_is_told_and_its_links_do_not_close() -> None:
    events = walkers(0, 10_800, "b/left", 1)
    beside = [Event("c", "entry", t, 0.5, 0.5) for t in poisson(0.02, 0, 10_800, 9)]
    last = versions(
        sorted([e for e in events if e.camera == "a" or e.t < 7_200] + beside, key=lambda e: e.t)
    )[-1]
    assert [(alarm.kind, alarm.subject) for alarm in last.alarms or []] == [("camera_silent", "b")]
    assert any(link.from_.startswith("a") and link.to.startswith("b") for link in last.links)


def test_a_door_of_its_own_that_comes_into_use_is_a_new_zone() -> None:
    chance = np.random.default_rng(5)
    events = [
        e
        for k, t in enumerate(poisson(0.02, 0, 14_400, 5))
        for e in passage("a", t, 0.1, f"l{k}", chance)
    ]
    events += [
        e
        for k, t in enumerate(poisson(0.02, 7_200, 14_400, 6))
        for e in passage("a", t, 0.9, f"r{k}", chance)
    ]
    alarms = versions(sorted(events, key=lambda event: event.t))[-1].alarms or []
    assert [(alarm.kind, alarm.subject[:2]) for alarm in alarms] == [("zone_new", "a/")]
    assert 7_200 < alarms[0].t < 9_600


# --- two publishers -------------------------------------------------------------------------------


def of_boots(*boots: str) -> list[Event]:
    """Return events of one camera, a second apart, by the boots of their publishers."""
    return [Event("a", "entry", 1000.0 + k, boot=boot, seq=k) for k, boot in enumerate(boots)]


@pytest.mark.parametrize(
    ("boots", "alarms"),
    [
        (["one"] * 40, 0),
        (["one"] * 20 + ["two"] * 20 + ["three"] * 20, 0),
        (["one"] * 20 + ["two", "one", "one"] + ["two"] * 20, 0),
        (["one", "two"] * 20, 1),
        (["one", "two"] * 20 + ["one", "three"] * 20, 2),
    ],
    ids=["one", "restarts", "an overlap", "two boxes", "and a third"],
)
def test_a_camera_that_two_programs_publish_is_said_once(boots: list[str], alarms: int) -> None:
    learner, halfway = Learner(), Learner()
    for number, event in enumerate(
        [*of_boots(*boots), Event("b", "entry", 9000.0), Event("c", "entry", 9001.0)]
    ):
        if number == len(boots) // 2:
            halfway.load(unpack(pack(learner.save())))
            learner = halfway
        learner.receive(event)
    assert learner.topology is not None
    found = [alarm for alarm in learner.topology.alarms or [] if alarm.kind == "camera_doubled"]
    assert [alarm.subject for alarm in found] == ["a"] * alarms
    if found:
        assert "boots two and one" in found[0].detail or "boots one and two" in found[0].detail
