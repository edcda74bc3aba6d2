"""Events of each camera by the hour."""

from __future__ import annotations

from camtopod.web.hourly_events import HourlyEvents

HOUR = 3600.0
T = 480_000 * HOUR
"""Beginning of an hour."""


def counts(ring: HourlyEvents, camera: str, now: float) -> object:
    told = ring.of(camera, now)
    return None if told is None else told["counts"]


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
