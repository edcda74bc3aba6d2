"""The events of the window with their zones: departures, arrivals and passages."""

from __future__ import annotations

import numpy as np
import pytest

from camtopod.event_time import microseconds
from camtopod.learn.links.visible_links import visible_transitions
from camtopod.learn.traffic.labelled_events import Scene, label_events
from camtopod.learn.window.sliding_window import Window
from camtopod.learn.zones.cells import cell_sums, cells_of, fixed_point
from camtopod.learn.zones.zone_map import ZoneMap, find_zones
from camtopod.records import Event
from camtopod.topology.lag_bins import LagBins

STAYS = LagBins(0.0, 120.0)
LEFT, RIGHT = (0.1, 0.5), (0.9, 0.5)


def made(seed: int, n: int, tracked: float = 0.8) -> list[Event]:
    """Return n passages through each of two cameras with positions and one without.

    Some have no track, some are clutter.
    """
    rng = np.random.default_rng(seed)
    events = []
    for camera in ("a", "b", "door"):
        for k in range(n):
            t, track = float(rng.uniform(0, 30.0 * n)), str(k) if rng.random() < tracked else None
            places = (LEFT, RIGHT) if rng.random() < 0.7 else (RIGHT, LEFT)
            for kind, when, place in (
                ("entry", t, places[0]),
                ("exit", t + float(rng.uniform(2, 6)), places[1]),
            ):
                x, y = np.clip(np.array(place) + 0.02 * rng.standard_normal(2), 0, 1)
                at = {} if camera == "door" else {"x": float(x), "y": float(y)}
                events.append(Event(camera, kind, when, **at, track=track))  # type: ignore[arg-type]
        events += [
            Event("a", "exit", float(rng.uniform(0, 30 * n)), *rng.random(2).tolist())
            for _ in range(3)
        ]
    for k, place in enumerate(
        ((0.5, 0.05), (0.45, 0.95), (0.55, 0.3))
    ):  # begun where there is no zone
        t = float(rng.uniform(0, 30.0 * n))
        events += [
            Event("a", "entry", t, *place, f"x{k}"),
            Event("a", "exit", t + 4.0, *RIGHT, f"x{k}"),
        ]
    return sorted(events, key=lambda e: e.t)


def seen(events: list[Event], forget: int = 0) -> tuple[Window, list[ZoneMap], Scene]:
    window = Window(10_000)
    window.append([(microseconds(e.t), e) for e in events])
    if forget:
        window.forget_old(microseconds(events[forget].t))
    maps = []
    for rows in window.rows_of_cameras():
        placed = rows[window.has_position()[rows]]
        px, py = (window.column(name)[placed].astype(np.int64) for name in ("px", "py"))
        maps.append(find_zones(cell_sums(px, py)))
    return window, maps, label_events(window, maps)


@pytest.mark.parametrize("forget", [0, 37])
def test_scene_equals_a_walk_over_the_events(forget: int) -> None:
    events = made(0, 40)
    window, maps, scene = seen(events, forget)
    kept = events[forget:]
    departures, arrivals, passages, opened = [], [], [], {}
    for event in kept:
        camera = window.cameras.index(event.camera)
        if event.x is None or event.y is None:
            zone = (camera, 1)
        else:
            index = maps[camera].cells.flat[cells_of(*fixed_point((event.x, event.y)))]
            zone = (camera, maps[camera].zones[index].number) if index >= 0 else None
        began = (
            opened.pop((event.camera, event.track), None)
            if event.kind == "exit" and event.track
            else None
        )
        if event.kind == "entry" and event.track:
            opened[event.camera, event.track] = event.t, zone
        if zone is None:
            continue
        if event.kind == "entry":
            arrivals.append((event.t, zone))
        else:
            departures.append((event.t, zone, began[0] if began else -np.inf))
            if began and began[1]:
                passages.append((began[1], zone, began[0], event.t))
    names = [(z.camera, z.number) for z in scene.zones]
    d, a, p = scene.departures, scene.arrivals, scene.departures.passages()
    found = list(zip(d.t.round(6), (names[z] for z in d.zone), d.since, strict=True))
    assert [row[:2] for row in found] == [(round(t, 6), z) for t, z, _ in departures]
    assert d.since == pytest.approx([since for *_, since in departures])
    assert d.camera.tolist() == [zone[0] for _, zone, _ in departures]
    assert list(zip(a.t.round(6), (names[z] for z in a.zone), strict=True)) == [
        (round(t, 6), z) for t, z in arrivals
    ]
    assert a.camera.tolist() == [zone[0] for _, zone in arrivals]
    assert [(names[u], names[v]) for u, v in zip(a.zone[p.own], p.zone, strict=True)] == [
        row[:2] for row in passages
    ]
    assert p.since == pytest.approx([row[2] for row in passages])
    assert p.t == pytest.approx([row[3] for row in passages])
    assert scene.entries.tolist() == [sum(zone == name for _, zone in arrivals) for name in names]
    assert scene.exits.tolist() == [
        sum(zone == name for _, zone, _ in departures) for name in names
    ]
    assert (scene.first, scene.last) == (pytest.approx(kept[0].t), pytest.approx(kept[-1].t))
    assert len(scene.zones) == 5
    assert len(passages) > 50


def test_a_camera_is_tracked_when_most_exits_have_their_entry() -> None:
    for tracked, expected in ((1.0, True), (0.9, True), (0.2, False), (0.0, False)):
        _, _, scene = seen(made(2, 60, tracked))
        assert scene.is_tracked.tolist() == [expected] * 3


def test_passages_are_counted_where_tracks_tie_them() -> None:
    _, _, scene = seen(made(4, 60, 1.0))
    found = visible_transitions(scene, STAYS, 10**6)
    p = scene.departures.passages()
    assert sorted(found.lag) == pytest.approx(sorted(p.t - p.since))
    assert (found.weight == 1).all()


def test_passages_are_joined_where_they_do_not() -> None:
    """Their number, zones and mean dwell time are right."""
    _, _, truth = seen(made(4, 150, 1.0))
    _, _, scene = seen(made(4, 150, 0.0))
    found = visible_transitions(scene, STAYS, 10**6)
    for u in range(len(scene.zones)):
        for v in range(len(scene.zones)):
            p = truth.departures.passages()
            true = (truth.arrivals.zone[p.own] == u) & (p.zone == v)
            here = (found.source == u) & (found.target == v)
            assert found.weight[here].sum() == pytest.approx(true.sum(), abs=0.12 * true.sum() + 8)
    assert np.average(found.lag, weights=found.weight) == pytest.approx(4.0, abs=0.5)
