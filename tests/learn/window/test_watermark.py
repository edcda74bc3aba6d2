"""The watermark beside its definition, written plainly."""

from __future__ import annotations

import random

import pytest

from camtopod.event_time import MICROSECONDS, EventTime, EventTimeState

CAMERAS = ["a", "b", "c", "d"]


def defined(state: EventTimeState, lateness_us: int, apart_us: int) -> int | None:
    """Return the watermark of a state whose event time has moved, by going over all cameras."""
    assert state.newest_us is not None
    event_us = state.newest_us
    if state.second_us is not None:
        event_us = max(state.second_us, event_us - apart_us)
    times = list(state.waited.values())
    if None in times:
        return state.watermark_us
    least = min([event_us - lateness_us, *(t_us for t_us in times if t_us is not None)])
    return least if state.watermark_us is None else max(state.watermark_us, least)


@pytest.mark.parametrize("seed", range(50))
def test_the_watermark_is_that_of_its_definition(seed: int) -> None:
    """Also while cameras are waited for, and after some of them are forgotten."""
    chance = random.Random(seed)
    time, now = EventTime(5.0, 60.0), 0
    for _ in range(200):
        now += chance.randrange(4 * MICROSECONDS)
        before = time.state.watermark_us
        if chance.random() < 0.9:
            t_us = now - chance.choice([0, 0, chance.randrange(60 * MICROSECONDS)])
            has_moved = time.note(t_us, chance.choice(CAMERAS))
        else:
            time.wait_for(set(chance.sample(["", *CAMERAS], chance.randrange(4))))
            has_moved = time.state.newest_us is not None
        after, time.state.watermark_us = time.state.watermark_us, before
        assert after == (
            defined(time.state, 5 * MICROSECONDS, 60 * MICROSECONDS) if has_moved else before
        )
        time.state.watermark_us = after
        if chance.random() < 0.05:
            time.state.waited.pop(chance.choice(CAMERAS), None)
