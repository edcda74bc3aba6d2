"""Subscriptions and queries that one thread reads, instead of callbacks."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from serving import small_config, wait_for

from camtopod.serve.bus import session as buses


@pytest.fixture
def bus(tmp_path: Path) -> Iterator[buses.Bus]:
    with buses.open_daemon_session(small_config(tmp_path)) as one:
        yield one


def taken(subscription: buses.Subscription) -> list[buses.Heard]:
    """Read all messages until it is closed."""
    heard = []
    while (some := subscription.receive()) is not None:
        heard += some
    return heard


def test_what_came_is_there_in_order_also_after_the_end(bus: buses.Bus) -> None:
    subscription = bus.open_subscription("event/*", 5_000)
    said = [(f"event/c{n % 7}", b"%d" % n) for n in range(3_000)]
    for key, payload in said:
        bus.publish_raw(key, payload, "event")
    bus.publish_raw("status/c1", b"", "status")
    subscription.close()
    assert taken(subscription) == [(key, payload, b"") for key, payload in said]
    assert subscription.receive() is None
    assert subscription.receive(wait=False) is None


def test_without_waiting_there_may_be_nothing(bus: buses.Bus) -> None:
    assert bus.open_subscription("event/*", 10).receive(wait=False) == []


@pytest.mark.parametrize("closers", [1, 4])
def test_who_waits_is_told_the_end(bus: buses.Bus, closers: int) -> None:
    """Whether the bus closes or several threads close it at once."""
    subscription, heard = bus.open_subscription("event/*", 10), []
    waiting = threading.Thread(target=lambda: heard.append(taken(subscription)))
    waiting.start()
    if closers == 1:
        bus.close()
    else:
        threads = [threading.Thread(target=subscription.close) for _ in range(closers)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    wait_for(lambda: heard == [[]], "the end")
    waiting.join()
