"""ONVIF: kinds in all their forms, and what a camera tells about the ids of its objects."""

from __future__ import annotations

import contextlib
import json
from datetime import UTC, datetime
from typing import Any

import pytest

from camtopod.adapt.adapter import Adapter
from camtopod.adapt.onvif import Onvif
from camtopod.codec import Rejected
from camtopod.records import Event

T = 1_700_000_000.0
TOPIC = "gate/onvif-mj/VideoAnalytics/1/people "
Frames = dict[int, tuple[dict[int, float], str]]
"""By tenths of a second: positions x by id, and the rest of the frame in XML."""


def thing(number: int, x: float, inside: str = "", attributes: str = "", kind: str = "") -> str:
    left, right = 2 * x - 1.04, 2 * x - 0.96
    return (
        f'<Object ObjectId="{number}" {attributes}><Appearance><Shape><BoundingBox left="{left}" '
        f'top="0.2" right="{right}" bottom="-0.6"/></Shape>{kind}</Appearance>{inside}</Object>'
    )


def frame(tenth: int, inside: str) -> bytes:
    time = datetime.fromtimestamp(T + tenth / 10, UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    return (
        f'<MetadataStream><VideoAnalytics><Frame UtcTime="{time}">{inside}</Frame>'
        "</VideoAnalytics></MetadataStream>"
    ).encode()


def events_of(adapter: Adapter, inside: dict[int, str], tenths: int = 300) -> list[Event]:
    events = []
    for tenth in range(tenths):
        events += adapter.receive(frame(tenth, inside.get(tenth, "")))
    return events + adapter.close()


def short(events: list[Event]) -> list[tuple[str, float, float | None]]:
    return sorted((e.kind, round(e.t - T, 1), e.x) for e in events)


def walk(number: int, first: int, last: int, begin: float = 0.02) -> dict[int, str]:
    """Return the frames of an object that moves by a hundredth of the picture in each."""
    return {tenth: thing(number, begin + 0.01 * (tenth - first)) for tenth in range(first, last)}


def joined(*parts: dict[int, str]) -> dict[int, str]:
    return {
        tenth: "".join(part.get(tenth, "") for part in parts)
        for tenth in sorted({tenth for part in parts for tenth in part})
    }


def tree(inside: str) -> str:
    return f"<ObjectTree>{inside}</ObjectTree>"


def ids(tag: str, *numbers: int) -> str:
    return "".join(f'<{tag} ObjectId="{number}"/>' for number in numbers)


# --- kinds ---


@pytest.mark.parametrize(
    "kind",
    [
        '<Type Likelihood="0.6">Human</Type><Type Likelihood="0.3">Face</Type>',
        "<ClassCandidate><Type>Face</Type><Likelihood>0.1</Likelihood></ClassCandidate>"
        "<ClassCandidate><Type>Human</Type><Likelihood>0.9</Likelihood></ClassCandidate>",
        "<ClassCandidate><Type>Other</Type><Likelihood>0.9</Likelihood></ClassCandidate>"
        "<Extension><OtherTypes><Type>Human</Type><Likelihood>0.4</Likelihood></OtherTypes></Extension>",
        "<OtherTypes><Type>Human</Type><Likelihood>0.4</Likelihood></OtherTypes>",
        "<ClassCandidate><Type>Other</Type><Likelihood>0.9</Likelihood></ClassCandidate>"
        '<Type Likelihood="0.2">Human</Type>',
    ],
)
def test_the_kind_is_the_likeliest_of_all_forms(kind: str) -> None:
    inside = {
        n: thing(7, 0.02 + 0.01 * (n - 20), kind=f"<Class>{kind}</Class>") for n in range(20, 70)
    }
    events = events_of(Onvif("gate", ["Human"]), inside)
    assert [(e.kind, e.label) for e in events] == [("entry", "human"), ("exit", "human")]
    assert events_of(Onvif("gate", ["Face"]), inside) == []


@pytest.mark.parametrize(
    "kind",
    [
        {"Type": [{"#text": "Face", "@Likelihood": 0.9}]},
        {"Type": "Face"},
        {"ClassCandidate": {"Type": "Face", "Likelihood": 0.9}},
        {"ClassCandidate": [{"Type": {"#text": "Face"}, "Likelihood": {"#text": "0.9"}}]},
        {"OtherTypes": [{"Type": "Face", "Likelihood": "0.9"}]},
    ],
)
def test_the_same_in_json(kind: dict[str, Any]) -> None:
    box = {"@left": -0.1, "@top": 0.2, "@right": 0.1, "@bottom": -0.6}
    for labels, count in (([], 0), (["Face"], 2)):
        adapter = Onvif(None, labels)
        events = []
        for second in range(12):
            look = {"Shape": {"BoundingBox": box}, "Class": kind}
            seen = [{"@ObjectId": 1, "Appearance": look}] if 3 < second < 8 else []
            time = f"2023-11-14T22:13:{20 + second}Z"
            message = {"Frame": {"@UtcTime": time, "Object": seen}}
            events += adapter.receive((TOPIC + json.dumps(message)).encode())
        assert len(events) == count


# --- ids that are explained ---


@pytest.mark.parametrize("silent", [False, True])
def test_an_object_that_stands_still_is_not_gone(silent: bool) -> None:
    inside = joined(
        walk(7, 20, 60),
        {60: thing(7, 0.42, "<Behaviour><Idle/></Behaviour>")},
        walk(7, 200, 240, 0.5),
    )
    adapter = Onvif("gate")
    events = []
    for tenth in range(300):
        if silent and 60 < tenth < 200:
            events += adapter.silent(tenth / 10)
        else:
            events += adapter.receive(frame(tenth, inside.get(tenth, "")))
    assert short(events) == [("entry", 2.0, 0.02), ("exit", 23.9, 0.89)]


def test_one_that_stands_still_leaves_when_it_is_deleted() -> None:
    idle = {60: thing(7, 0.42, "<Behaviour><Idle/></Behaviour>")}
    inside = joined(walk(7, 20, 60), idle, {150: tree(ids("Delete", 7))})
    assert short(events_of(Onvif("gate"), inside)) == [("entry", 2.0, 0.02), ("exit", 6.0, 0.42)]


@pytest.mark.parametrize("deleted", ["", ids("Delete", 7)])
def test_a_renamed_object_is_the_same(deleted: str) -> None:
    change = {60: tree(f"<Rename>{ids('from', 7)}{ids('to', 9)}</Rename>{deleted}")}
    inside = joined(walk(7, 20, 60), change, walk(9, 60, 110, 0.42), walk(7, 80, 130))
    events = events_of(Onvif("gate"), inside)
    assert short(events) == [
        ("entry", 2.0, 0.02),
        ("entry", 8.0, 0.02),
        ("exit", 10.9, 0.91),
        ("exit", 12.9, 0.51),
    ]
    assert [e.track for e in events if round(e.t - T, 1) in (2.0, 10.9)] == ["7", "7"]
    assert len({e.track for e in events}) == 2, "the id is another object's now"


@pytest.mark.parametrize("wrong", [36_000, -36_000])
def test_a_rename_is_followed_after_a_wrong_time(wrong: int) -> None:
    """A frame far ahead is dropped; a clock that is set back counts from there."""
    adapter = Onvif("gate")
    change = {60: tree(f"<Rename>{ids('from', 7)}{ids('to', 9)}</Rename>")}
    inside = joined(walk(7, 20, 60), change, walk(9, 60, 110, 0.42))
    for tenth in (0, 1) if wrong > 0 else range(-wrong, 1 - wrong):
        adapter.receive(frame(tenth, ""))
    if wrong > 0:
        adapter.receive(frame(wrong, ""))

    events = []
    for tenth in range(-40, 300) if wrong < 0 else range(2, 300):
        with contextlib.suppress(Rejected):
            events += adapter.receive(frame(tenth, inside.get(tenth, "")))

    assert short(events) == [("entry", 2.0, 0.02), ("exit", 10.9, 0.91)]


def test_merged_objects_that_are_gone_are_forgotten() -> None:
    """A camera that starts again counts its objects from 1 again."""
    merge = f"<Merge>{ids('from', 7, 8)}{ids('to', 8)}</Merge>"
    inside = joined(
        walk(7, 20, 60),
        walk(8, 20, 60),
        {60: tree(merge)},
        walk(8, 60, 80, 0.42),
        walk(7, 150, 190),
        walk(8, 160, 240),
    )
    assert short(events_of(Onvif("gate"), inside)) == [
        ("entry", 2.0, 0.02),
        ("entry", 2.0, 0.02),
        ("entry", 15.0, 0.02),
        ("entry", 16.0, 0.02),
        ("exit", 7.9, 0.61),
        ("exit", 7.9, 0.61),
        ("exit", 18.9, 0.41),
        ("exit", 23.9, 0.81),
    ]


@pytest.mark.parametrize("merged", [7, 8, 9])
@pytest.mark.parametrize("deleted", [None, 60, 63])
def test_merged_objects_leave_where_the_one_leaves(merged: int, deleted: int | None) -> None:
    merge = f"<Merge>{ids('from', 7, 8)}{ids('to', merged)}</Merge>"
    gone = ids("Delete", *{7, 8} - {merged})
    inside = joined(
        walk(7, 20, 60),
        walk(8, 30, 60),
        {60: tree(merge + gone * (deleted == 60))},
        {63: tree(gone * (deleted == 63))},
        walk(merged, 60, 110, 0.42),
    )
    assert short(events_of(Onvif("gate"), inside)) == [
        ("entry", 2.0, 0.02),
        ("entry", 3.0, 0.02),
        ("exit", 10.9, 0.91),
        ("exit", 10.9, 0.91),
    ]


@pytest.mark.parametrize("after", [(9, 10), (7, 8), (11, 12)])
def test_what_is_split_again_goes_on(after: tuple[int, int]) -> None:
    one, two = after
    inside = joined(
        walk(7, 20, 60),
        walk(8, 30, 60),
        {60: tree(f"<Merge>{ids('from', 7, 8)}{ids('to', 9)}</Merge>")},
        walk(9, 60, 80, 0.42),
        {80: tree(f"<Split>{ids('from', 9)}{ids('to', one, two)}</Split>")},
        walk(one, 80, 100, 0.62),
        walk(two, 80, 115, 0.62),
    )
    events = events_of(Onvif("gate"), inside)
    assert short(events) == [
        ("entry", 2.0, 0.02),
        ("entry", 3.0, 0.02),
        ("exit", 9.9, 0.81),
        ("exit", 11.4, 0.96),
    ]
    assert sorted(str(e.track) for e in events) == ["7", "7", "8", "8"]


def test_what_comes_as_one_and_is_split_does_not_enter_in_mid_view() -> None:
    inside = joined(
        walk(7, 20, 60),
        {60: tree(f"<Split>{ids('from', 7)}{ids('to', 8, 9)}</Split>")},
        walk(8, 60, 90, 0.42),
        walk(9, 60, 100, 0.42),
    )
    assert short(events_of(Onvif("gate"), inside)) == [
        ("entry", 2.0, 0.02),
        ("exit", 8.9, 0.71),
        ("exit", 9.9, 0.81),
    ]


def test_parts_of_an_object_are_not_counted_beside_it_and_what_enters_it_leaves_with_it() -> None:
    whole = walk(1, 20, 110)
    part = {n: thing(2, 0.02 + 0.01 * (n - 20), attributes='Parent="1"') for n in range(30, 100)}
    assert short(events_of(Onvif("gate"), joined(whole, part))) == [
        ("entry", 2.0, 0.02),
        ("exit", 10.9, 0.91),
    ]
    walker = walk(3, 40, 60, 0.1)
    inside = {n: thing(3, 0.02 + 0.01 * (n - 20), attributes='Parent="1"') for n in range(60, 63)}
    assert short(events_of(Onvif("gate"), joined(whole, walker, inside))) == [
        ("entry", 2.0, 0.02),
        ("entry", 4.0, 0.1),
        ("exit", 10.9, 0.91),
        ("exit", 10.9, 0.91),
    ]


def test_modules_without_a_source_are_told_apart_by_the_topic() -> None:
    """Their objects have the same numbers."""
    box = {"@top": 0.2, "@bottom": -0.6}
    adapter = Onvif()
    events = []
    for n in range(140):
        for module, begin in (("1/people", 20), ("1/cars", 50)):
            seen = []
            if begin <= n < begin + 50:
                x = -0.9 + 0.02 * (n - begin)
                sides = {**box, "@left": x - 0.05, "@right": x + 0.05}
                seen = [{"@ObjectId": 1, "Appearance": {"Shape": {"BoundingBox": sides}}}]
            time = datetime.fromtimestamp(T + n / 10, UTC).isoformat()
            message = json.dumps({"Frame": {"@UtcTime": time, "Object": seen}})
            events += adapter.receive(f"gate/onvif-mj/VideoAnalytics/{module} {message}".encode())
    assert sorted((e.kind, round(e.t - T, 1)) for e in events) == [
        ("entry", 2.0),
        ("entry", 5.0),
        ("exit", 6.9),
        ("exit", 9.9),
    ]
    assert len({e.track for e in events}) == 2
