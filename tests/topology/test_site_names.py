"""Cameras' names within ids and subjects of alarms, and operators' judgements of links."""

from __future__ import annotations

import pytest

from camtopod.admin import Judge
from camtopod.records import Link, Transit
from camtopod.topology.site_names import (
    camera_of,
    judged,
    marked,
    mentions,
    renamed,
    with_new_name,
    without_camera,
)


@pytest.mark.parametrize(
    ("subject", "expected"),
    [
        ("lobby", "door"),
        ("lobby/1", "door/1"),
        ("lobby/1->lobby/12", "door/1->door/12"),
        ("lobby-/1->hall/2", "lobby-/1->hall/2"),
        ("hall/1->lobby/2", "hall/1->door/2"),
        ("lobby2/1", "lobby2/1"),
    ],
)
def test_a_camera_is_renamed_in_every_kind_of_subject(subject: str, expected: str) -> None:
    assert renamed(subject, "lobby", "door") == expected
    assert mentions(subject, ["x", "lobby"]) == (subject != expected)


def test_the_camera_of_a_place() -> None:
    assert (camera_of("lobby/12"), camera_of("lobby")) == ("lobby", "lobby")


def link(source: str, target: str, relation: str = "unseen") -> Link:
    return Link(source, target, relation, 0.5, 9.0, Transit(1, 1, 1, 1, 1, 1), 0.0, 0.1)  # type: ignore[arg-type]


def test_the_last_word_counts_and_none_takes_it_back() -> None:
    said = judged([], Judge("a/1", "b/2", "right"))
    said = judged(said, Judge("a", "b", "right"))
    said = judged(said, Judge("a/1", "b/2", "wrong"))
    assert said == [("a", "b", "right"), ("a/1", "b/2", "wrong")]
    links = [link("a/1", "b/2"), link("a/3", "b/2"), link("b/2", "a/1"), link("a/1", "a/3")]
    assert [one.operator for one in marked(links, said)] == ["wrong", "right", None, None]
    again = marked(marked(links, said), judged(said, Judge("a/1", "b/2", "none")))
    assert [one.operator for one in again] == ["right", "right", None, None]


def test_passages_through_a_view_are_not_judged() -> None:
    links = [link("a/1", "a/2", "visible"), link("a/1", "a/2")]
    assert [one.operator for one in marked(links, [("a", "a", "wrong")])] == [None, "wrong"]


def test_links_without_a_word_are_the_same_objects() -> None:
    links = [link("a/1", "b/2")]
    assert marked(links, []) is links
    assert marked(None, [("a", "b", "right")]) is None


def test_judgements_follow_their_cameras() -> None:
    said = judged(judged([], Judge("a/1", "b/2", "right")), Judge("c", "b", "wrong"))
    assert with_new_name(said, "b", "x") == [("a/1", "x/2", "right"), ("c", "x", "wrong")]
    assert without_camera(said, "a") == [("c", "b", "wrong")]
