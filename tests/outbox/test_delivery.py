"""Delivery from a spool: each rule by itself."""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Iterator
from pathlib import Path

import pytest

from camtopod.records import Event
from camtopod.serve.outbox.delivery import Delivery
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.requests import Answer, Batch, Hello


class Grabber:
    """A spool with three events and its deliveries to two sites, at a time of its own."""

    def __init__(self, folder: Path) -> None:
        self.now = 1000.0
        sites = ("north", "south")
        self.spool = Spool(folder / "spool.db", "b1", 1000, sites_of=lambda camera: sites)
        numbers = itertools.count(1)
        self.delivery = Delivery("lobby", self.spool.queue(), lambda: f"n{next(numbers)}")
        self.south = Delivery("lobby", self.spool.queue("south"), lambda: f"s{next(numbers)}")
        self.add(3)

    def add(self, count: int, boot: str | None = None, start: int = 1) -> None:
        self.spool.append(
            [
                Event("lobby", "entry", float(n), boot=boot, seq=n if boot else None)
                for n in range(start, start + count)
            ]
        )

    def next(self) -> Hello | Batch:
        """Return the request that is sent now."""
        request = self.delivery.next_request(self.now)
        assert request is not None
        assert self.delivery.next_request(self.now) is None, "one at a time"
        return request

    def batch(self) -> tuple[str, int, list[int], int]:
        """Return boot, after, numbers and more of the batch that is sent now."""
        self.request = self.next()
        assert isinstance(self.request, Batch)
        one = self.request
        return one.boot, one.after, [seq for seq, _ in one.events], one.more

    def hello(self, answer: Answer) -> Hello:
        """Let a hello be sent now and answered."""
        request = self.next()
        assert isinstance(request, Hello)
        self.delivery.on_answer(request, answer, self.now)
        return request

    def answered(self, answer: Answer | None, after: float = 0.1) -> None:
        """Answer the last batch."""
        self.now += after
        self.delivery.on_answer(self.request, answer, self.now)

    def waits(self) -> float:
        """Return the seconds until the next request; none is sent before."""
        seconds = self.delivery.deadline - self.now
        if math.isfinite(seconds):
            assert self.delivery.next_request(self.now + 0.99 * seconds) is None
            self.now += seconds
        return round(seconds, 3)


@pytest.fixture
def grabber(tmp_path: Path) -> Iterator[Grabber]:
    one = Grabber(tmp_path)
    with contextlib.closing(one.spool):
        yield one


def test_a_hello_then_batches_of_older_boots_first_as_many_as_the_answer_says(
    tmp_path: Path,
) -> None:
    with contextlib.closing(Spool(tmp_path / "spool.db", "b0", 1000)) as older:
        older.append([Event("lobby", "entry", 1.0), Event("lobby", "entry", 2.0)])
    grabber = Grabber(tmp_path)

    hello = grabber.hello(Answer({"b0": 1, "b1": 0}, batch=5))
    assert (hello.number, hello.boots) == ("n1", ["b0", "b1"])
    assert grabber.batch() == ("b0", 1, [2], 3)
    grabber.answered(Answer({"b0": 2}, batch=2))
    assert grabber.batch() == ("b1", 0, [1, 2], 1)
    grabber.add(1)
    grabber.answered(Answer({"b1": 2}, batch=500))
    assert grabber.batch() == ("b1", 2, [3, 4], 0)
    grabber.answered(Answer({"b1": 4}, batch=500))
    assert grabber.waits() == math.inf
    grabber.spool.close()


def test_a_daemon_with_less_gets_the_events_again_and_a_hole_is_left_out(grabber: Grabber) -> None:
    grabber.hello(Answer({"b1": 0}, batch=3))
    grabber.batch()
    grabber.answered(Answer({"b1": 3}, batch=3, late=2, refused=1))
    assert (grabber.delivery.late, grabber.delivery.refusals) == (2, 1)
    grabber.add(1)
    grabber.spool._db.execute("UPDATE event SET raw = x'00' WHERE seq = 2")

    assert grabber.batch() == ("b1", 3, [4], 0)
    grabber.answered(Answer({"b1": 1}, batch=3))
    assert grabber.batch() == ("b1", 1, [3, 4], 0)


def test_a_machine_that_was_set_back_begins_another_boot(grabber: Grabber) -> None:
    grabber.hello(Answer({"b1": 0}, batch=1))
    grabber.batch()
    grabber.answered(Answer({"b1": 3}, batch=5))  # two more than were sent

    (boot, *rest) = grabber.batch()
    assert rest == [0, [1, 2, 3], 0]
    assert boot != "b1"
    grabber.answered(Answer({boot: 3}, batch=5))
    grabber.add(1)
    assert grabber.batch() == (boot, 3, [4], 0)

    # Set back again: another name, as the daemon may have this one already.
    grabber.answered(Answer({boot: 9}, batch=5))
    grabber.add(1)
    (third, *_) = grabber.batch()
    assert third not in ("b1", boot)


def test_a_new_boot_at_one_site_is_none_at_another(grabber: Grabber) -> None:
    north, south = grabber.delivery, grabber.south
    grabber.hello(Answer({"b1": 0}, batch=2))
    assert grabber.batch()[:3] == ("b1", 0, [1, 2])
    sent = grabber.request
    grabber.delivery = south
    grabber.hello(Answer({"b1": 7}, batch=5))  # before anything was sent there
    (boot, *rest) = grabber.batch()
    assert rest == [0, [1, 2, 3], 0]
    assert boot != "b1"
    grabber.answered(Answer({boot: 3}))

    grabber.delivery = north
    north.on_answer(sent, Answer({"b1": 2}, batch=5), grabber.now)
    grabber.add(1)
    assert grabber.batch() == ("b1", 2, [3, 4], 0)
    grabber.delivery = south
    assert grabber.batch() == (boot, 3, [4], 0)
    assert grabber.spool.queue("south").boots("lobby") == ["b1", boot]
    assert grabber.spool.queue().boots("lobby") == ["b1"]


def test_the_boot_of_another_program_is_believed(grabber: Grabber) -> None:
    grabber.hello(Answer({"b1": 0}, batch=5))
    grabber.batch()
    grabber.answered(Answer({"b1": 3}, batch=5))
    grabber.add(3, boot="file")

    assert grabber.batch() == ("file", 0, [1, 2, 3], 0)
    grabber.answered(Answer({"file": 7}, batch=5))
    assert grabber.waits() == math.inf


def test_after_150_seconds_a_hello_and_longer_and_longer_waits(grabber: Grabber) -> None:
    grabber.hello(Answer({"b1": 0}, batch=5))
    grabber.batch()

    assert grabber.waits() == 150.0
    assert grabber.delivery.next_request(grabber.now) is None
    seconds = [grabber.waits()]
    for _ in range(5):
        request = grabber.next()
        assert isinstance(request, Hello)
        grabber.delivery.on_answer(request, None, grabber.now)
        seconds.append(grabber.waits())
    assert seconds == [2.0, 4.0, 8.0, 16.0, 30.0, 30.0]


def test_a_token_ends_the_request_and_the_wait_and_a_late_answer_is_ignored(
    grabber: Grabber,
) -> None:
    grabber.hello(Answer({"b1": 0}, batch=5))
    grabber.batch()

    grabber.delivery.on_daemon(grabber.now)
    hello = grabber.next()
    assert isinstance(hello, Hello)
    grabber.answered(Answer({"b1": 3}))  # of the request that was ended
    assert grabber.spool.queue().waiting() == 3

    grabber.delivery.on_answer(hello, None, grabber.now)
    grabber.delivery.on_daemon(grabber.now)
    assert isinstance(grabber.next(), Hello)


@pytest.mark.parametrize("reason", ["busy", "clock", "stopping"])
def test_a_reason_and_an_answer_without_progress_are_waited_after(
    reason: str, grabber: Grabber
) -> None:
    grabber.hello(Answer({"b1": 0}, batch=1))
    grabber.batch()
    grabber.answered(Answer({"b1": 0}, reason=reason))  # type: ignore[arg-type]
    assert grabber.waits() == 2.0
    assert grabber.batch() == ("b1", 0, [1], 2)
    grabber.answered(Answer({"b1": 0}))
    assert grabber.waits() == 4.0
    grabber.batch()
    grabber.answered(Answer({"of nobody": 7}))
    assert grabber.waits() == 8.0
    grabber.batch()
    grabber.answered(Answer({"b1": 1}))
    assert grabber.batch() == ("b1", 1, [2], 1)
    grabber.answered(Answer({}, reason="busy"))
    assert grabber.waits() == 2.0, "again from the beginning"


def test_a_hello_that_is_refused_and_another_hello_s_number_are_followed_by_a_hello(
    grabber: Grabber,
) -> None:
    grabber.hello(Answer({}, reason="clock"))
    assert grabber.waits() == 2.0
    grabber.hello(Answer({"b1": 0}))
    grabber.batch()
    grabber.answered(Answer({}, reason="hello"))
    assert grabber.waits() == 4.0

    assert grabber.hello(Answer({"b1": 0})).number == "n3"


def test_held_is_repeated_without_bytes_and_at_once_if_it_took_long(grabber: Grabber) -> None:
    grabber.hello(Answer({"b1": 0}, batch=2))
    grabber.batch()
    for _ in range(2):
        grabber.answered(Answer({"b1": 0}, batch=2, reason="held"), after=60.0)
        grabber.add(1)
        assert grabber.batch()[:3] == ("b1", 2, [])
    grabber.answered(Answer({"b1": 0}, batch=2, reason="held"), after=1.0)
    assert grabber.waits() == 2.0
    assert grabber.batch() == ("b1", 2, [], 5)
    grabber.answered(Answer({"b1": 2}, batch=9))
    assert grabber.batch() == ("b1", 2, [3, 4, 5], 0)


def test_a_slow_answer_is_followed_at_once_even_by_an_empty_batch(grabber: Grabber) -> None:
    grabber.hello(Answer({"b1": 0}, batch=5))
    grabber.batch()
    grabber.answered(Answer({"b1": 3}), after=5.5)

    assert grabber.batch() == ("b1", 3, [], 0)
    grabber.answered(Answer({"b1": 3}))
    assert grabber.waits() == math.inf


def test_above_cameras_max_it_asks_every_30_seconds(grabber: Grabber) -> None:
    for _ in range(2):
        grabber.hello(Answer({}, reason="cameras", detail="1 camera is the most"))
        assert grabber.delivery.no_room == "1 camera is the most"
        assert grabber.waits() == 30.0
    grabber.hello(Answer({"b1": 0}))
    assert grabber.delivery.no_room == ""
    assert grabber.batch()[2] == [1]
