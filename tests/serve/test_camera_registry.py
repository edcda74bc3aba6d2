"""Wrong clocks, floods and too many cameras: which are trusted, delayed, refused."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from serving import T0, small_config, wait_for

from camtopod.codec import event_from_bytes, to_msgpack
from camtopod.config.settings import Limits
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.learn.snapshot import pack
from camtopod.records import Event
from camtopod.serve.bus import session as buses
from camtopod.serve.bus.session import BusError
from camtopod.serve.bus.single_daemon import NAMED_MAX, OtherDaemons
from camtopod.serve.daemon import Daemon
from camtopod.serve.ingest.camera_registry import (
    DOUBLED_SECONDS,
    EARLY_SECONDS_MAX,
    FLOOD_SECONDS_KEPT,
    IDLE_SECONDS,
    LEADS_SECONDS,
    REFUSED_SECONDS,
    REWIND_SECONDS,
    TRUSTED_SECONDS,
    CameraRegistry,
    Received,
)
from camtopod.serve.ingest.inbox import Inbox, Message
from camtopod.serve.ingest.receiver import Receiver
from camtopod.serve.runtime.clock import steady_clock_for, wall
from camtopod.serve.runtime.rejects import SAMPLES_MAX, Rejects
from camtopod.serve.storage.journal import Entry, Journal

DAY = 86_400.0


def at(camera: str, t: float) -> Event:
    return Event(camera, "entry", t)


def received(event: Event) -> Received:
    return Received(Entry("event", event.camera, None, None, b""), event)


def admitted(*names: str, **limits: float) -> CameraRegistry:
    cameras = CameraRegistry(Limits(**limits))  # type: ignore[arg-type]
    for name in names:
        assert cameras.register(name, 0.0)
    return cameras


# --- clocks ---------------------------------------------------------------------------------------


def test_an_event_that_is_early_waits_and_so_does_what_its_camera_sends_after_it() -> None:
    cameras = admitted("a", "b")
    early, behind, other = received(at("a", T0 + 50)), received(at("a", T0)), received(at("b", T0))
    assert cameras.release_due([early, behind, other], T0, 100.0) == [other]
    assert cameras.waiting == 2
    assert cameras.release_due([], T0 + 48, 148.9) == []
    assert cameras.release_due([received(at("b", T0 + 49))], T0 + 49, 149.0) == [
        early,
        behind,
        received(at("b", T0 + 49)),
    ]
    assert cameras.waiting == 0
    assert cameras.release_due([received(at("a", T0 + 51))], T0 + 50, 150.0) == [
        received(at("a", T0 + 50 + EARLY_SECONDS_MAX))
    ]


def test_an_early_event_waits_by_the_clock_that_does_not_step() -> None:
    cameras = admitted("a")
    early = received(at("a", T0 + 30))
    assert cameras.release_due([early], T0, 0.0) == []
    assert cameras.release_due([], T0 - 86_400, 28.0) == []
    assert cameras.release_due([], T0 - 86_400, 29.0) == [early], (
        "although the clock was set back by a day"
    )


def test_no_more_wait_than_may() -> None:
    cameras = admitted("a", held_events_max=2)
    cameras.release_due([received(at("a", T0 + 30 + n)) for n in range(2)], T0, 0.0)
    assert cameras.is_full("a")


def test_one_wild_camera_is_the_wild_one_and_many_mean_that_this_clock_is_behind() -> None:
    cameras = admitted("a", "b", "c", "d")
    assert not any(cameras.is_future(at(camera, T0), T0, 0.0, True) for camera in "abc")
    assert cameras.is_future(at("d", T0 + 3600), T0, 2.0, True)
    assert cameras.clock_behind == 0.0
    for now in (4.0, 6.0):  # this machine's clock is set back by an hour
        future = [cameras.is_future(at(camera, T0), T0 - 3600, now, True) for camera in "abc"]
    assert future == [False] * 3
    assert cameras.clock_behind == 3600.0
    assert cameras.is_future(at("d", T0 + 3600), T0 - 3600, 8.0, True)
    for now in (10.0, 12.0):  # and is right again
        assert not any(cameras.is_future(at(camera, T0), T0, now, True) for camera in "abc")
    assert cameras.clock_behind == 0.0


def test_two_cameras_are_too_few_to_doubt_the_clock() -> None:
    cameras = admitted("a", "b")
    for now in (0.0, 2.0):
        assert all(cameras.is_future(at(camera, T0), T0 - 3600, now, True) for camera in "ab")
    assert not cameras.is_future(at("a", T0), T0, 4.0, True), "not for ever"


@pytest.mark.parametrize("boxes", [{}, dict.fromkeys(("yard", "gate", "shed"), "nvr")])
def test_the_cameras_of_one_box_have_one_vote_and_the_box_is_named(boxes: dict[str, str]) -> None:
    good, wild = ["hall", "lobby", "stairs"], ["gate", "shed", "yard"]
    cameras = CameraRegistry(Limits(), boxes=boxes)
    for name in [*good, *wild]:
        cameras.register(name, 0.0)
    assert not any(cameras.is_future(at(name, T0), T0, 0.0, True, name) for name in good)
    for year in (62.0, 64.0, 66.0):  # in a minute in which nobody else speaks
        ahead = [
            cameras.is_future(at(name, T0 + 365 * DAY), T0 + year, year, True, "a box")
            for name in wild
        ]
        assert ahead == [True] * 3
        assert cameras.clock_behind == 0.0
    said = cameras.fast_clocks_reason(66.0)
    assert (
        f"the clock of cameras gate, shed, yard (one box: {boxes.get('gate', 'a box')}) is about 315359"
        in said
    )
    assert not any(cameras.is_future(at(name, T0 + 67), T0 + 67, 67.0, True, name) for name in good)
    assert cameras.fast_clocks_reason(67.0 + LEADS_SECONDS) == "", "only while it sends"


def test_a_camera_that_two_programs_publish_is_named_for_a_while() -> None:
    cameras = admitted("a", "b")
    for n in range(8):
        for camera, boot in (("a", f"boot-{n % 2}"), ("b", f"boot-{n}")):
            cameras.is_future(
                Event(camera, "entry", T0 + n, boot=boot, seq=n), T0 + n, float(n), True
            )
    assert "two programs at the same time publish camera a:" in cameras.double_publishers_reason(
        8.0
    )
    assert cameras.double_publishers_reason(8.0 + DOUBLED_SECONDS) == ""


def test_as_far_as_the_clock_is_before_what_was_stored_last_it_is_behind() -> None:
    cameras = CameraRegistry(Limits(), behind=7200.0)
    cameras.register("a", 0.0)
    assert not cameras.is_future(at("a", T0 + 7000), T0, 0.0, True)
    assert cameras.clock_behind == 7000.0
    assert cameras.is_future(at("a", T0 + 7300), T0, 2.0, True)


def test_event_time_that_is_ahead_is_taken_back_when_that_has_lasted() -> None:
    cameras = admitted("a")
    assert cameras.rewind_to(None, T0, 0.0) is None
    assert cameras.rewind_to(T0 + 60, T0, 0.0) is None, "that much is usual"
    assert cameras.rewind_to(T0 + DAY, T0, 1.0) is None
    assert (
        cameras.rewind_to(T0 + DAY, T0 + REWIND_SECONDS, 1.0 + REWIND_SECONDS)
        == T0 + REWIND_SECONDS
    )
    assert cameras.rewind_to(T0 + DAY, T0 + 20, 20.0) is None, "once"


def test_event_time_is_not_taken_back_to_a_clock_that_may_be_wrong() -> None:
    cameras = admitted("a")
    cameras.release_due([], T0 + DAY, 0.0)
    cameras.release_due([], T0 + 1, 1.0)  # set back by a day
    for now in (2.0, 1.0 + TRUSTED_SECONDS):
        assert cameras.rewind_to(T0 + DAY, T0 + now, now) is None, "no camera says which is right"
    cameras.is_future(at("a", T0 + 700), T0 + 700, 700.0, True)
    assert cameras.rewind_to(T0 + DAY, T0 + 700, 700.0) is None
    for now in (1000.0, 700.0 + TRUSTED_SECONDS):
        cameras.is_future(at("a", T0 + now), T0 + now, now, True)
    assert cameras.rewind_to(T0 + DAY, T0 + 1300, 700.0 + TRUSTED_SECONDS) == T0 + 1300


def test_a_clock_that_was_set_back_is_noticed_however_few_the_cameras_are() -> None:
    for names in ("a", "ab", "abcd"):
        cameras = admitted(*names)
        assert not any(cameras.is_future(at(camera, T0), T0, 0.0, True) for camera in names)
        future = [cameras.is_future(at(camera, T0 + 1), T0 - 3599, 1.0, True) for camera in names]
        assert future == [False] * len(names), "not even the first event after it"
        assert cameras.clock_behind == 3600.0
        assert cameras.is_future(at("a", T0 + 200), T0 - 3598, 2.0, False), (
            "but no more than it was set back"
        )
        assert not cameras.is_future(at("a", T0 + 3), T0 + 3, 3.0, True)
        assert cameras.clock_behind == 0.0, "and is right again"


def test_a_clock_that_was_wrong_and_is_set_back_to_the_right_time_is_believed() -> None:
    cameras = admitted("a", "b")
    assert not any(cameras.is_future(at(camera, T0), T0 + 3600, 0.0, True) for camera in "ab")
    assert cameras.is_future(at("b", T0 + 3600), T0 + 1, 1.0, True)
    assert not cameras.is_future(at("a", T0 + 1), T0 + 1, 1.0, True)
    assert cameras.clock_behind == 0.0


@pytest.mark.parametrize("names", ["a", "ab", "abcd"])
def test_cameras_that_share_a_clock_which_jumps_forward_do_not_take_event_time_along(
    names: str,
) -> None:
    """Event time only rises: later events would be late for as long as the jump was."""
    cameras = admitted(*names)
    assert not any(cameras.is_future(at(name, T0), T0, 0.0, True) for name in names)
    for now in (1.0, 3.0, 120.0):
        wall = T0 + DAY + now
        assert all(cameras.is_future(at(name, wall), wall, now, True) for name in names)
        assert (cameras.clock_ahead, cameras.clock_behind) == (DAY, -DAY)
    wall = T0 + 121
    assert cameras.is_future(at(names[0], wall + DAY), wall, 121.0, True), (
        "one that was still under way"
    )
    for now in (121.0, 123.0, 200.0):
        assert not any(cameras.is_future(at(name, T0 + now), T0 + now, now, True) for name in names)
        assert (cameras.clock_ahead, cameras.clock_behind) == (0.0, 0.0)


def test_those_still_under_way_when_a_clock_is_right_again_do_not_say_that_it_is_behind() -> None:
    cameras = admitted(*"abcd")
    for now, step in ((0.0, 0.0), (1.0, DAY)):
        for name in "abcd":
            cameras.is_future(at(name, T0 + step + now), T0 + step + now, now, True, name)
    for now in (2.0, 4.0, 6.0):
        assert all(
            cameras.is_future(at(name, T0 + DAY + 1), T0 + now, now, True, name) for name in "abcd"
        )
    for later in (7.0 + LEADS_SECONDS, 9.0 + LEADS_SECONDS):
        future = [
            cameras.is_future(at(name, T0 + 3600 + later), T0 + later, later, True, name)
            for name in "abcd"
        ]
    assert future == [False] * 4, "not for ever"


def test_a_jump_forward_is_believed_when_it_has_lasted() -> None:
    cameras = admitted("a", "b", "c")
    for name in "abc":
        cameras.is_future(at(name, T0), T0, 0.0, True)
    for now in (1.0, TRUSTED_SECONDS):
        assert cameras.is_future(at("a", T0 + DAY), T0 + DAY + now, now, True)
    lasted = TRUSTED_SECONDS + 1.0
    assert cameras.release_due([], T0 + DAY + lasted, lasted) == []
    assert (cameras.clock_ahead, cameras.clock_behind) == (0.0, 0.0), "although no event came"
    assert not cameras.is_future(at("a", T0 + DAY + lasted), T0 + DAY + lasted, lasted, True)


def test_each_jump_forward_has_to_last_by_itself() -> None:
    cameras = admitted("a")
    for now, step in ((0.0, 0.0), (1.0, 100.0), (500.0, 300.0), (601.0, 300.0)):
        cameras.release_due([], T0 + step + now, now)
    assert cameras.clock_ahead == 200.0
    cameras.release_due([], T0 + 150.0 + 700.0, 700.0)
    assert cameras.clock_ahead == 50.0, "what is set back is the newest"
    cameras.release_due([], T0 + 150.0 + 1100.0, 1100.0)
    assert cameras.clock_ahead == 0.0


def test_a_jump_forward_to_where_the_cameras_are_is_believed_at_once() -> None:
    """The clock was behind and is now right."""
    for names in ("a", "ab", "abcd"):
        cameras = admitted(*names)
        for name in names:
            cameras.is_future(at(name, T0), T0 - 3600, 0.0, True)
        assert not any(cameras.is_future(at(name, T0 + 1), T0 + 1, 1.0, True) for name in names)
        assert (cameras.clock_ahead, cameras.clock_behind) == (0.0, 0.0)


def test_cameras_with_clocks_of_their_own_notice_nothing_of_a_jump_forward() -> None:
    cameras = admitted("a", "b", "c")
    for now, step in ((0.0, 0.0), (1.0, DAY), (3.0, DAY), (5.0, 0.0)):
        for name in "abc":
            event = at(name, T0 + now)
            assert not cameras.is_future(event, T0 + now + step, now, True)
            assert cameras.release_due([received(event)], T0 + now + step, now) == [received(event)]


def test_an_event_a_little_ahead_of_a_clock_that_jumped_forward_waits() -> None:
    cameras = admitted("a")
    assert cameras.release_due([], T0, 0.0) == []
    jumped = received(at("a", T0 + 31))
    assert cameras.release_due([jumped], T0 + 31, 1.0) == []
    assert cameras.release_due([], T0 + 59, 29.0) == []
    assert cameras.release_due([], T0 + 60, 30.0) == [jumped]


def test_why_what_comes_is_not_learned() -> None:
    cameras = admitted("a")
    assert cameras.clock_reason(0.0, T0) == cameras.clock_reason(T0 + 60, T0) == ""
    assert "event time is 3600 s ahead of this machine's clock" in cameras.clock_reason(
        T0 + 3600, T0
    )
    for now, step in ((0.0, 0.0), (1.0, 30.0)):
        cameras.release_due([], T0 + step + now, now)
    assert cameras.clock_reason(T0, T0 + 31) == "", "nothing is set aside"
    cameras.release_due([], T0 + DAY + 2, 2.0)
    assert f"was set forward by {DAY:.0f} s" in cameras.clock_reason(T0, T0 + DAY)
    cameras.release_due([], T0 + 3, 3.0)
    assert cameras.clock_reason(T0, T0 + 3) == ""
    cameras.is_future(at("a", T0 + 4), T0 - 3596, 4.0, True)
    assert cameras.clock_reason(T0 + 4, T0 - 3596) == "", "it is known that the clock is behind"


def test_who_has_not_been_heard_since_the_start_does_not_vote() -> None:
    cameras = admitted(*"abcdefgh")
    for camera in "abc":
        cameras.is_future(at(camera, T0), T0 - 3600, 1.0, True, camera)
    cameras.is_future(at("a", T0), T0 - 3600, 3.0, True, "a")
    assert cameras.clock_behind == 3600.0


def test_who_is_heard_through_its_spool_keeps_its_place() -> None:
    cameras = admitted("a", "b", cameras_max=2)
    assert cameras.register("a", IDLE_SECONDS)
    assert cameras.register("c", IDLE_SECONDS)
    assert ("a" in cameras, "b" in cameras, "c" in cameras) == (True, False, True)


def test_the_status_says_how_far_ahead_a_camera_is() -> None:
    """Events of a camera that is behind are stored but not learned, which somebody
    has to notice.
    """
    cameras = admitted("a", "b")
    cameras.is_future(at("a", T0 - 20), T0, 0.0, True)
    cameras.is_future(at("b", T0 - 3600), T0, 0.0, False)
    for camera in "ab":
        cameras.count_event(at(camera, T0 - 20))
    ahead = {name: status.ahead for name, status in cameras.status().items()}
    assert ahead == {"a": -20.0, "b": None}, "what comes out of a spool says nothing about a clock"


def test_old_events_from_spools_say_nothing_about_clocks() -> None:
    cameras = admitted(*"abcd")
    for now in (0.0, 2.0):
        for camera in "abc":
            cameras.is_future(at(camera, T0), T0 - 3600, now, True, camera)
        cameras.is_future(at("d", T0 - 7200), T0 - 3600, now, False)
    assert cameras.clock_behind == 3600.0


def test_whoever_makes_up_the_time_makes_it_up_for_all() -> None:
    def made_up() -> float:
        return 5.0

    assert steady_clock_for(made_up) is made_up
    before = steady_clock_for(wall)()
    assert before <= steady_clock_for(wall)()


class Nowhere:
    """A bus without clients."""

    def publish(self, key: str, noun: Any, schema: str) -> None:
        """Discard the message."""


def test_setting_the_clock_forward_does_not_move_event_time(tmp_path: Path) -> None:
    """Otherwise later events would be late for as long as the step was."""
    steady, step = 0.0, 0.0
    journal = Journal(tmp_path)
    receiver = Receiver(
        journal,
        Nowhere(),
        Limits(),
        lambda: T0 + steady + step,  # type: ignore[arg-type]
        lambda batch: None,
        lambda: 1000,
        lambda version: None,
        lambda *seen: None,
        steady=lambda: steady,
    )

    def advances() -> list[float]:
        receiver._round([])
        return [
            one.advance for one in receiver._queue.take(10, 0.0, 0.0) if one.advance is not None
        ]

    receiver._round([Message("a", to_msgpack(at("a", T0)))])
    receiver.on_deadline(T0 + 5.0)
    step = 3600.0
    assert advances() == []
    steady = 14.9
    assert advances() == []
    steady = 15.0
    assert advances() == [T0 + 5.0]
    journal.close()


def test_learning_goes_on_after_a_jump_forward_and_a_replay_learns_the_same(tmp_path: Path) -> None:
    """Events that were set aside are marked in the journal; no clock is consulted again."""
    steady, step, live = 0.0, 0.0, Learner(Settings(), "site", "epoch")
    journal = Journal(tmp_path)

    def learn(batch: list[Received]) -> None:
        for one in batch:
            if one.event is not None:
                live.receive(one.event)

    receiver = Receiver(
        journal,
        Nowhere(),
        Limits(),
        lambda: T0 + steady + step,  # type: ignore[arg-type]
        learn,
        lambda: 1000,
        lambda version: None,
        lambda *seen: None,
        steady=lambda: steady,
    )
    for second in range(900):
        steady, step = float(second), DAY if 300 <= second < 420 else 0.0
        camera = "abc"[second % 3]
        event = Event(camera, "entry", T0 + steady + step, 0.5, 0.5, boot="boot", seq=second // 3)
        receiver._round([Message(camera, to_msgpack(event))])
        assert receiver._store(receiver._queue.take(1000, 0.0, 0.0), threading.Event())
    assert (receiver.counts["stored"], receiver.counts["future"]) == (780, 120)
    statistics = live.statistics()
    assert (statistics["accepted"], statistics["late"]) == (780, 0)
    kinds = [entry.kind for _, entry in journal.entries() if entry is not None]
    assert (kinds.count("event"), kinds.count("future"), len(kinds)) == (780, 120, 900), (
        "nothing is lost"
    )
    again = Learner(Settings(), "site", "epoch")
    for _, entry in journal.entries():
        if entry is not None and entry.kind == "event":
            again.receive(event_from_bytes(entry.raw))
    assert pack(again.save()) == pack(live.save())
    journal.close()


# --- floods ---------------------------------------------------------------------------------------


def test_a_camera_has_so_many_events_a_second_and_no_more() -> None:
    cameras = admitted("a", "b", camera_events_per_second_max=3)
    assert [cameras.count_event(at("a", T0 + 0.1 * n)) for n in range(5)] == [True] * 3 + [
        False
    ] * 2
    assert cameras.count_event(at("b", T0))
    assert cameras.count_event(at("a", T0 + 1))
    for second in range(FLOOD_SECONDS_KEPT + 10):
        cameras.count_event(at("a", T0 + second))
    assert len(cameras._cameras["a"].seconds) == FLOOD_SECONDS_KEPT


def test_too_many_cameras_are_refused_until_one_has_been_silent_for_long() -> None:
    cameras = admitted("a", "b", cameras_max=2)
    assert not cameras.register("c", 10.0)
    assert cameras.register("a", 10.0)
    cameras.is_future(at("a", T0), T0, IDLE_SECONDS, True)
    assert not cameras.register("c", IDLE_SECONDS - 1)
    assert cameras.register("c", IDLE_SECONDS)
    assert ("a" in cameras, "b" in cameras, "c" in cameras) == (True, False, True)


def test_a_camera_whose_grabber_was_seen_takes_the_place_of_a_name_that_merely_sends() -> None:
    """It takes the place of the one with the fewest events, and never loses its own
    to such a name.
    """
    cameras, grabbers = (
        admitted("good", "busy", "one", "two", cameras_max=4),
        {"good", "new", "newer"},
    )
    for name, events in (("busy", 5), ("one", 1), ("two", 2)):
        for second in range(events):
            cameras.count_event(at(name, T0 + second))
    assert not cameras.register("other", 1.0, grabbers)
    assert cameras.register("new", 1.0, grabbers)
    assert ("one" in cameras, "good" in cameras) == (False, True)
    cameras.release_due([received(at("two", T0 + 50))], T0, 1.0)
    assert cameras.register("newer", 2.0, grabbers)
    assert ("two" in cameras, "busy" in cameras) == (True, False), (
        "of one something waits for its time"
    )
    assert not cameras.register("late", 2.0, {*grabbers, "late", "two"}), (
        "all that are left have a grabber"
    )
    assert cameras.register("other", IDLE_SECONDS + 0.5, grabbers)
    assert {name for name in ("good", "new", "newer", "two", "other") if name in cameras} == {
        "other",
        "new",
        "newer",
        "two",
    }


def test_who_takes_the_places_is_said_as_long_as_a_camera_is_refused() -> None:
    cameras = admitted("good", "lobby", *(f"name{k}" for k in range(20)), cameras_max=22)
    for name in ("lobby", "lobby", "name1"):
        cameras.count_event(at(name, T0))
    assert cameras.refused_reason(0.0) == ""
    assert not cameras.register("gate", 10.0)
    said = cameras.refused_reason(10.0, {"good"})
    assert "camera gate is refused, as limits.cameras_max (22) is reached" in said
    assert "the cameras with the fewest events are name0 (0), name10 (0), name11 (0):" in said
    assert "raise limits.cameras_max" in said
    for k in range(1000):
        assert not cameras.register(f"further{k}", 11.0)
    assert "camera further999 and at least 99 others are refused" in cameras.refused_reason(11.0)
    assert not cameras.register("gate", 65.0)
    assert "camera gate and at least 99 others are" in cameras.refused_reason(70.0)
    assert "camera gate is" in cameras.refused_reason(72.0)
    assert cameras.refused_reason(65.0 + REFUSED_SECONDS) != ""
    assert cameras.refused_reason(66.0 + REFUSED_SECONDS) == ""


def test_a_refusal_is_quick_however_many_cameras_there_are() -> None:
    """A refused name may send thousands of events; silent cameras are not searched
    for each time.
    """
    cameras = admitted(*(f"name{k}" for k in range(3)), cameras_max=3)
    assert not cameras.register("other", 10.0)
    cameras._cameras[
        "name1"
    ].heard = -IDLE_SECONDS  # nobody's clock goes back: so it would not be looked at
    assert not cameras.register("other", IDLE_SECONDS - 1.0)
    assert cameras.register("other", IDLE_SECONDS)


def test_the_longest_queue_gives_way() -> None:
    inbox = Inbox(6, 4, 2, known=lambda camera: camera in "abcd")
    for n in range(6):
        inbox.put(Message("a", b"%d" % n))
    assert (len(inbox), inbox.dropped) == (4, {"a": 2})
    for camera in ("b", "b", "c", "d"):
        inbox.put(Message(camera, b""))
    assert len(inbox) == 6
    assert inbox.dropped == {"a": 4}
    assert [message.camera for message in inbox.take(4)] == ["a", "a", "b", "b"]
    assert [message.camera for message in inbox.take(4)] == ["c", "d"]
    assert inbox.take(4) == []


def test_made_up_names_share_one_queue() -> None:
    inbox = Inbox(100, 3, 2, known=lambda camera: False)
    for n in range(10):
        inbox.put(Message(f"name{n}", b""))
    assert (len(inbox), inbox.dropped) == (3, {"": 7})
    inbox.wait(60.0)


def test_a_few_of_each_reason_are_kept() -> None:
    rejects = Rejects()
    for n in range(10):
        rejects.add("odd", "event/a", "why", f"rtsp://user:word@host {n}")
    assert rejects.counts == {"odd": 10}
    [kept] = rejects.samples().values()
    assert len(kept) == SAMPLES_MAX
    assert "9" in kept[-1]
    assert "word" not in "".join(kept)


# --- another daemon -------------------------------------------------------------------------------


@pytest.fixture
def meeting_point(tmp_path: Path) -> Iterator[buses.Bus]:
    with buses.open_daemon_session(small_config(tmp_path)) as bus:
        yield bus


def test_more_cameras_than_the_learner_takes_are_said(tmp_path: Path) -> None:
    """Their events are stored and acknowledged, so nothing else shows that they are not learned."""
    config = small_config(tmp_path)
    config = msgspec.structs.replace(
        config, learn=msgspec.structs.replace(config.learn, cameras_max=2)
    )
    with (
        Daemon(config) as daemon,
        buses.dial(small_config(tmp_path / "other", daemon.endpoint)) as bus,
    ):
        for camera in "ab":
            bus.publish(f"event/{camera}", at(camera, T0), "event")
        wait_for(lambda: daemon.status().learner["accepted"] == 2, "two cameras to be learned")
        assert daemon.unready() == []
        bus.publish("event/c", at("c", T0), "event")
        wait_for(
            lambda: "more cameras than learn.cameras_max" in daemon.status().reason,
            "the third to be missed",
        )
        assert daemon.unready() == [daemon.status().reason]
        assert daemon.status().events["stored"] == 3
    with Daemon(config) as daemon:
        assert daemon.status().reason == "", "nothing has been refused since"


def test_a_daemon_does_not_start_beside_another(meeting_point: buses.Bus, tmp_path: Path) -> None:
    config = small_config(tmp_path / "one", meeting_point.endpoint)
    quick = msgspec.structs.replace(config.bus, connect_seconds=0.3)
    with Daemon(config):
        other = msgspec.structs.replace(small_config(tmp_path / "two"), bus=quick)
        with pytest.raises(BusError, match=r"another daemon .* serves site site on this bus"):
            Daemon(other).start()
    with Daemon(other) as after:
        assert after.status().reason == ""


def test_two_that_find_each_other_later_both_say_so(
    meeting_point: buses.Bus, tmp_path: Path
) -> None:
    with Daemon(small_config(tmp_path / "one", meeting_point.endpoint)) as daemon:
        other = OtherDaemons(meeting_point, "other")
        other.appear()
        wait_for(lambda: "another daemon (other)" in daemon.status().reason, "the first to see it")
        wait_for(lambda: other.reason != "", "the second to see it")
        assert daemon.status().state == "degraded"


class Watched:
    """A bus on which the test makes daemons appear."""

    site = "site"

    def __init__(self) -> None:
        self.on_change: Any = None

    def watch_alive(self, role: str, on_change: Any) -> None:
        self.on_change = on_change

    def announce(self, role: str, name: str) -> None:
        """Do nothing."""


def test_made_up_daemons_fill_neither_memory_nor_log(caplog: pytest.LogCaptureFixture) -> None:
    bus = Watched()
    rivals = OtherDaemons(bus, "mine")  # type: ignore[arg-type]
    rivals.appear()
    for number in range(1000):
        bus.on_change(f"other{number}", True)
    assert len(rivals.reason) < 1000
    assert len(caplog.records) == NAMED_MAX
    for number in range(1000):
        bus.on_change(f"other{number}", False)
    assert rivals.reason == ""
