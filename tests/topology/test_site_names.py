"""Cameras' names within ids and subjects of alarms."""

from __future__ import annotations

import pytest

from camtopod.topology.site_names import camera_of, mentions, renamed


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
