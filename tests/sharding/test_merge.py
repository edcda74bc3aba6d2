"""Parts merge into one topology: zones of owners, any order of parts, sound probabilities."""

from __future__ import annotations

from itertools import permutations

import pytest
from msgspec.structs import replace

from camtopod.learn.settings import Settings
from camtopod.predict.predictor import Predictor
from camtopod.records import (
    TOPOLOGY_SCHEMA,
    Alarm,
    Camera,
    CameraModel,
    Context,
    Event,
    Histogram,
    Link,
    Model,
    Onward,
    Outcome,
    SelfScore,
    Topology,
    Transit,
    Zone,
    ZoneModel,
)
from camtopod.sharding.match_zones import OwnedZones
from camtopod.sharding.merge import merge
from camtopod.sharding.parts import Part, part_of
from camtopod.topology.versions import with_digest

SETTINGS = Settings()
TRANSIT = Transit(5.0, 5.0, 1.0, 4.0, 5.0, 6.0)
COV = [[0.001, 0.0], [0.0, 0.001]]
LEFT, RIGHT = (0.1, 0.5), (0.9, 0.5)


def zone(name: str, place: tuple[float, float] | None = None, exits: int = 100) -> Zone:
    x, y = place or (None, None)
    return Zone(name, name.split("/")[0], 100, exits, x, y, COV if place else None)


def link(source: str, target: str, probability: float, transitions: float = 20.0) -> Link:
    return Link(
        source,
        target,
        "unseen",
        probability,
        transitions,
        TRANSIT,
        0.0,
        0.5,
        Histogram(3, [transitions]),
    )


def onward(source: str, leave: float, **to: float) -> Onward:
    rows = [
        Outcome(name.replace("_", "/"), share, Histogram(3, [share]), 0.1)
        for name, share in to.items()
    ]
    return Onward(source, leave, rows)


def part(
    district: int,
    own: set[str],
    zones: list[Zone],
    links: list[Link],
    rows: list[Onward],
    contexts: list[Context] | None = None,
    alarms: list[Alarm] | None = None,
    score: SelfScore | None = None,
) -> Part:
    """Return what a district of the cameras ``own`` has learned."""
    cameras = sorted({one.camera for one in zones})
    model = Model(
        4.0,
        0.1,
        -120.0,
        180.0,
        [ZoneModel(one.id, one.exits, 0.01, []) for one in zones],
        [CameraModel(camera, 1 / len(cameras), 50.0) for camera in cameras],
        onward=rows,
        entered=[],
        contexts=contexts or [],
    )
    topology = Topology(
        TOPOLOGY_SCHEMA,
        "s",
        "e",
        7,
        100.0 + district,
        500,
        "",
        [Camera(camera, [one.id for one in zones if one.camera == camera]) for camera in cameras],
        zones,
        links,
        [],
        [],
        model=model,
        alarms=alarms,
        score=score,
    )
    return part_of(with_digest(topology), district, dict.fromkeys(own, 0.5), 200)


def two_parts() -> list[Part]:
    """Return two parts; camera b's district has camera a's zones in reverse order."""
    mine = part(
        0,
        {"a"},
        [zone("a/1", LEFT), zone("a/2", RIGHT)],
        [],
        [onward("a/1", 0.9), onward("a/2", 0.9)],
    )
    theirs = part(
        1,
        {"b"},
        [zone("a/1", RIGHT), zone("a/2", LEFT), zone("b/1", LEFT)],
        [link("a/1", "b/1", 0.6)],
        [onward("a/1", 0.3, b_1=0.6), onward("a/2", 0.9, b_1=0.05), onward("b/1", 1.0)],
    )
    return [mine, theirs]


def test_what_is_of_others_is_no_part() -> None:
    other = [link("b/1", "a/1", 0.5), link("a/1", "b/1", 0.6)]
    known = part(
        0,
        {"a"},
        [zone("a/1", LEFT), zone("b/1", LEFT), zone("c/1", LEFT)],
        other,
        [onward("a/1", 0.2, b_1=0.6), onward("b/1", 0.4, a_1=0.5), onward("c/1", 0.4, b_1=0.5)],
        alarms=[
            Alarm(1, 9.0, "camera_silent", "b", ""),
            Alarm(1, 9.0, "zone_new", "b/1", ""),
            Alarm(1, 9.0, "link_opened", "a/1->b/1", ""),
            Alarm(2, 9.5, "link_opened", "b/1->a/1", ""),
        ],
    ).topology
    assert [one.id for one in known.cameras] == ["a"]
    assert [one.id for one in known.zones] == ["a/1", "b/1"]
    assert [(one.from_, one.to) for one in known.links] == [("b/1", "a/1")]
    assert known.model is not None
    assert known.model.onward == [onward("a/1", 0.8), onward("b/1", 0.4, a_1=0.5)]
    assert [one.camera for one in known.model.cameras] == ["a"]
    assert [one.subject for one in known.alarms or []] == ["b/1->a/1"]


def test_zones_have_their_owners_names() -> None:
    merged = merge(two_parts(), SETTINGS)
    assert [one.id for one in merged.zones] == ["a/1", "a/2", "b/1"]
    assert [(one.from_, one.to, one.probability) for one in merged.links] == [("a/2", "b/1", 0.6)]
    assert [one.cameras for one in merged.pairs] == [("a", "b")]
    rows = {row.zone: row for row in (merged.model and merged.model.onward) or []}
    assert {to.to: to.share for to in rows["a/2"].next_} == {"b/1": 0.6}
    assert {to.to: to.share for to in rows["a/1"].next_} == {"b/1": 0.05}
    assert rows["a/2"].leave == pytest.approx(0.2)


def test_the_order_of_the_parts_says_nothing() -> None:
    """Also if several have alarms of one moment, or equally likely cameras."""
    third, fourth = (
        part(
            number,
            {name},
            [zone("a/4", (0.12, 0.5)), zone(f"{name}/1", LEFT)],
            [link("a/4", f"{name}/1", 0.3)],
            [onward("a/4", 0.7, **{f"{name}_1": 0.3})],
            alarms=[Alarm(3, 8.0, "camera_moved", name, "")],
        )
        for number, name in ((2, "d"), (3, "c"))
    )
    digests = {
        with_digest(merge(order, SETTINGS)).digest
        for order in permutations([*two_parts(), third, fourth])
    }
    assert len(digests) == 1


def test_several_zones_that_are_one_are_taken_together() -> None:
    mine = part(0, {"a"}, [zone("a/1", LEFT)], [], [onward("a/1", 1.0)])
    theirs = part(
        1,
        {"b"},
        [zone("a/1", (0.08, 0.5), 300), zone("a/2", (0.12, 0.5), 100), zone("b/1", LEFT)],
        [link("a/1", "b/1", 0.4, 120.0), link("a/2", "b/1", 0.8, 80.0)],
        [onward("a/1", 0.6, b_1=0.4), onward("a/2", 0.2, b_1=0.8)],
    )
    merged = merge([mine, theirs], SETTINGS)
    (joined,) = merged.links
    assert (joined.from_, joined.probability, joined.transitions) == ("a/1", 0.5, 200.0)
    assert joined.histogram == Histogram(3, [200.0])
    assert merged.model is not None
    assert merged.model.onward is not None
    (row,) = [row for row in merged.model.onward if row.zone == "a/1"]
    (to,) = row.next_
    assert (to.share, to.doubt, to.hazard.first) == (0.5, 0.1, 3)
    assert [to.hazard.unit * one for one in to.hazard.mass] == [0.5]
    assert row.leave == 0.5


def test_one_zone_that_is_several_stands_for_each() -> None:
    mine = part(
        0,
        {"a"},
        [zone("a/1", (0.08, 0.5)), zone("a/2", (0.12, 0.5))],
        [],
        [onward("a/1", 1.0), onward("a/2", 1.0)],
    )
    theirs = part(
        1,
        {"b"},
        [zone("a/9", (0.09, 0.5)), zone("b/1", LEFT)],
        [link("a/9", "b/1", 0.6)],
        [onward("a/9", 0.4, b_1=0.6)],
    )
    merged = merge([mine, theirs], SETTINGS)
    assert [one.from_ for one in merged.links] == ["a/1"]
    rows = {
        row.zone: [to.share for to in row.next_]
        for row in (merged.model and merged.model.onward) or []
    }
    assert rows == {"a/1": [0.6], "a/2": [0.6]}


def test_a_zone_without_positions_is_its_camera() -> None:
    places = OwnedZones([zone("a/1", exits=5), zone("b/1", LEFT, 10), zone("b/2", RIGHT, 20)])
    assert places.names([zone("a/3"), zone("b/4")]) == {"a/3": ["a/1"], "b/4": ["b/2", "b/1"]}
    assert places.names([zone("b/5", (0.5, 0.9)), zone("c/1", LEFT)]) == {}


def test_links_from_cameras_that_nobody_owns_yet_wait() -> None:
    merged = merge(two_parts()[1:], SETTINGS)
    assert merged.links == []
    assert [one.id for one in merged.zones] == ["b/1"]
    assert [row.zone for row in (merged.model and merged.model.onward) or []] == ["b/1"]


def test_no_more_goes_anywhere_than_leaves() -> None:
    zones = [zone("a/1", LEFT)]
    mine = part(0, {"a"}, zones, [], [onward("a/1", 0.9, a_1=0.1)])
    others = [
        part(
            k,
            {name},
            [*zones, zone(f"{name}/1", LEFT)],
            [link("a/1", f"{name}/1", 0.8)],
            [onward("a/1", 0.2, **{f"{name}_1": 0.8})],
        )
        for k, name in ((1, "b"), (2, "c"))
    ]
    merged = merge([mine, *others], SETTINGS)
    assert sum(one.probability for one in merged.links) == pytest.approx(1.0)
    assert sum(edge.probability for edge in merged.chain or []) == pytest.approx(1.0)
    assert merged.model is not None
    assert merged.model.onward is not None
    (row,) = [row for row in merged.model.onward if row.zone == "a/1"]
    assert row.leave == 0.02
    assert sum(to.share for to in row.next_) == pytest.approx(0.98)
    hazard = row.next_[0].hazard
    assert [hazard.unit * one for one in hazard.mass] == [pytest.approx(0.8 * 0.98 / 1.7, rel=0.01)]


def test_contexts_know_what_all_districts_expect() -> None:
    zones = [zone("a/1", LEFT)]
    mine = part(
        0,
        {"a"},
        zones,
        [],
        [onward("a/1", 0.9, a_1=0.1)],
        [Context("a/1", 40.0, {"a/1": 4.0}, block=3), Context("a/1", 20.0, {"a/1": 2.0}, block=4)],
    )
    theirs = part(
        1,
        {"b"},
        [zone("a/7", LEFT), zone("b/1", LEFT)],
        [],
        [onward("a/7", 0.5, b_1=0.5)],
        [Context("a/7", 10.0, {"b/1": 8.0}, block=3)],
    )
    merged = merge([mine, theirs], SETTINGS)
    rows = {
        row.block: (row.departures, row.to)
        for row in (merged.model and merged.model.contexts) or []
    }
    assert rows == {3: (40.0, {"a/1": 4.0, "b/1": 32.0}), 4: (20.0, {"a/1": 2.0, "b/1": 10.0})}


def test_alarms_and_scores() -> None:
    score = SelfScore(100, 3, 1.0, 0.5, 0.8, 2.0, 0.4)
    mine, theirs = two_parts()
    mine = replace(mine, topology=replace(mine.topology, score=score))
    opened = Alarm(5, 9.0, "link_opened", "a/1->b/1", "share")
    theirs = replace(
        theirs,
        topology=replace(
            theirs.topology, alarms=[opened], score=replace(score, exits=300, top1=0.9)
        ),
    )
    merged = merge([theirs, mine], SETTINGS)
    assert merged.alarms == [replace(opened, version=0, subject="a/2->b/1")]
    assert merged.score == replace(score, exits=400, top1=0.8)
    assert (merged.events, merged.as_of) == (400, 101.0)


def test_it_predicts() -> None:
    predictor = Predictor(merge(two_parts(), SETTINGS))
    said = predictor.predict(Event("a", "exit", 10.0, *RIGHT))
    assert (said.zone, [one.zone for one in said.next_]) == ("a/2", ["b/1"])
    assert said.leave + said.next_[0].probability == pytest.approx(1.0)
    assert said.next_[0].probability == pytest.approx(0.9 * 0.6 / (0.6 + 0.2), rel=0.05)
