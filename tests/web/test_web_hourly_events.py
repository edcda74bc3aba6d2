"""Events of each camera by the hour."""

from __future__ import annotations

import pytest

from camtopod.web import hourly_events
from camtopod.web.hourly_events import HourlyEvents

HOUR = 3600.0
T = 480_000 * HOUR
"""Beginning of an hour."""


def counts(ring: HourlyEvents, camera: str, now: float) -> object:
    told = ring.of(camera, now)
    return None if told is None else told["counts"]


def test_before_the_first_status_there_is_nothing() -> None:
    assert HourlyEvents().of("a", T) is None


def test_what_is_counted_is_what_is_new_since_this_server_began() -> None:
    ring = HourlyEvents()
    ring.note(T + 10.0, {"a": 1000})
    ring.note(T + 20.0, {"a": 1003})
    ring.note(T + 2 * HOUR, {"a": 1010, "b": 2})
    assert counts(ring, "a", T + 2 * HOUR) == [3, 0, 7]
    assert counts(ring, "b", T + 3 * HOUR) == [0, 0, 2, 0], "b is new"
    assert counts(ring, "c", T) == [0]
    assert (ring.of("a", T) or {})["since"] == T + 10.0
    assert (ring.of("a", T) or {})["first"] == T


def test_a_daemon_that_begins_anew_counts_from_nothing() -> None:
    ring = HourlyEvents()
    ring.note(T, {"a": 1000})
    ring.note(T + 1.0, {"a": 4})
    assert counts(ring, "a", T + 1.0) == [4]


def test_only_so_many_hours_and_cameras_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hourly_events, "CAMERAS_MAX", 2)
    ring = HourlyEvents()
    for hour in range(100):
        ring.note(T + hour * HOUR, {"a": hour, "b": hour, "c": hour})
    now = T + 99 * HOUR
    assert counts(ring, "a", now) == [1] * hourly_events.HOURS_MAX
    assert counts(ring, "c", now) == [0] * hourly_events.HOURS_MAX
    assert len(ring._hours["a"]) == hourly_events.HOURS_MAX
