"""Event time that advances without events."""

from __future__ import annotations

from camtopod.serve.ingest.idle_time import IdleEventTime


def test_time_follows_the_clock_when_the_learner_waits_for_it_and_is_told_once() -> None:
    """If ticks were repeated while it learns, it would find thousands of them in the journal."""
    time = IdleEventTime()
    assert time.advance_to(100.0, 10.0) is None
    time.note([1000.0, 1004.0, 5000.0], 1005.0, 100.0, 60.0)
    assert time.advance_to(200.0, 10.0) is None, "nobody waits"
    time.deadline = 1050.0
    assert time.advance_to(154.0, 10.0) is None
    assert time.advance_to(156.0, 10.0) == 1051.0
    assert time.advance_to(160.0, 10.0) is None, "it has not said yet what it waits for now"
    time.deadline = 1052.0
    assert time.advance_to(161.0, 10.0) == 1056.0
