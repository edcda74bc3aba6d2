"""For whom the learner waits, whatever happens meanwhile to the cameras and the daemon."""

from __future__ import annotations

from pathlib import Path

import pytest
from intake_bench import LATENESS, IntakeBench, event_bytes

from camtopod.admin import Command, Forget, Rename, Reset
from camtopod.codec import to_msgpack
from camtopod.serve.ingest import backlogs, execute, intake
from camtopod.serve.requests import Batch


@pytest.fixture
def bench(tmp_path: Path) -> IntakeBench:
    return IntakeBench(tmp_path)


def test_killed_while_it_waits_for_a_backlog_it_waits_for_nobody_after_the_next_start(
    bench: IntakeBench,
) -> None:
    """However long that start takes, and though the camera does not come back."""
    bench.hello("a")
    bench.send("a", times={1: -3600.0}, more=1000)
    bench.restart()
    bench.tick(60.0)
    assert bench.waits == [["", "a"], []]


def test_backlogs_that_come_one_after_another_are_all_waited_for(bench: IntakeBench) -> None:
    """However long it takes until the last camera has delivered its first events."""
    names = [f"c{number}" for number in range(6)]
    for name in names:
        bench.hello(name)
    for name in names:
        bench.send(name, times={1: -3600.0, 2: -1800.0}, more=2)
        bench.tick(backlogs.SETTLE_SECONDS - 1.0)
        for other in names[: names.index(name)]:
            bench.send(other, boot="b2", after=0, times={}, more=2)  # it is still there
    for name in names:
        bench.send(name, after=2, times={3: -1700.0, 4: -1600.0})

    assert bench.intake.counts["stored"] == 24
    assert bench.intake.counts["late"] == 0


def test_a_request_that_a_busy_daemon_has_not_taken_yet_counts(
    bench: IntakeBench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(intake, "TAKEN_AT_ONCE_MAX", 1)
    for name in "ab":
        bench.hello(name)
    bench.send("a", times={1: -3600.0}, more=1000)
    bench.tick(0.0)
    bench.now += 2 * backlogs.SETTLE_SECONDS
    for name, after in (("b", 0), ("a", 1)):
        content = to_msgpack(
            Batch("h1", "b1", after, [(after + 1, event_bytes(name, bench.wall))], 0)
        )
        bench.intake.inbox.on_request(f"store/{name}", content, lambda answer: None)
    bench.intake.step()

    assert bench.intake.inbox.has_request("a")
    assert "a" in bench.intake.backlogs.waited_cameras
    bench.work()
    bench.tick(backlogs.SETTLE_SECONDS + 1.0)
    assert bench.waits[-1] == []


def test_a_slow_grabber_that_is_there_is_waited_for_as_long_as_its_trial(
    bench: IntakeBench,
) -> None:
    bench.intake.on_alive("a", True)
    bench.hello("a")
    bench.send("a", times={1: -3600.0}, more=1000)
    bench.tick(backlogs.TRIAL_SECONDS - 1.0)
    assert bench.intake.backlogs.waited_cameras == {"a"}
    bench.tick(2.0)
    assert bench.intake.backlogs.waited_cameras == set(), "it gains nothing"


@pytest.mark.parametrize(("hours", "is_waited"), [(1, True), (24, False)])
def test_a_backlog_of_a_day_at_three_times_real_time_keeps_no_version_waiting(
    hours: int, is_waited: bool, bench: IntakeBench
) -> None:
    for name in ("a", "live"):
        bench.intake.on_alive(name, True)
        bench.hello(name)
    bench.send("a", times={1: -3600.0 * hours}, more=1000)
    bench.send("live", times={1: 0.0})
    bench.tick(backlogs.TRIAL_SECONDS - 1.0)
    times = {2: -3600.0 * hours + 3.0 * backlogs.TRIAL_SECONDS}
    bench.send("a", after=1, times=times, more=1000)
    bench.tick(2.0)
    assert ("a" in bench.intake.backlogs.waited_cameras) == is_waited


def test_cameras_that_come_back_again_and_again_hold_nobody_up_for_ever(
    bench: IntakeBench,
) -> None:
    """On a large site with a bad network somebody is always away for half a minute."""
    bench.hello("live")
    for second in range(0, 600, 4):
        bench.tick(4.0)
        bench.send("live", after=second, times={second + 1: -0.1})
        camera = f"c{second}"
        bench.hello(camera)
        bench.store({seq: 3.0 * seq - 31.0 for seq in range(1, 11)}, camera=camera)
        behind = bench.wall - bench.intake.event_clock.watermark
        assert behind < LATENESS + backlogs.UNSETTLED_SECONDS_MAX + 10.0


def operate(bench: IntakeBench, command: Command) -> None:
    execute(bench.intake, command, None, Reset, lambda epoch: None)


@pytest.mark.parametrize(
    ("command", "waits"), [(Rename("a", "yard"), ["yard"]), (Forget("a"), []), (Reset(), ["a"])]
)
def test_a_camera_is_waited_for_under_its_present_name(
    bench: IntakeBench, command: Command, waits: list[str]
) -> None:
    """Else the learner would never hear of it again, and stay where it is."""
    bench.hello("a")
    bench.hello("live")
    bench.send("a", times={1: -3600.0}, more=1000)
    bench.send("live", times={1: -0.1})
    operate(bench, command)
    for seq in range(2, 12):
        bench.tick(1.0)
        bench.send("a", after=seq - 1, times={seq: -3600.0 + 20.0 * seq}, more=1000)
    assert bench.waits[-1] == waits
    if isinstance(command, Rename):
        watermark = bench.intake.event_clock.watermark
        assert watermark == pytest.approx(bench.wall - 3600.0 + 220.0, abs=1.0), "it goes on"


def test_nothing_but_numbers_is_stored_of_a_forgotten_camera(bench: IntakeBench) -> None:
    bench.hello("a")
    bench.store({1: -1.0})
    operate(bench, Forget("a"))
    bench.store({2: 0.0, 3: 9999.0}, after=1)
    bench.ask("a", Batch("h1", "b1", 3, [(4, b"no event")], 0))
    entries = [entry for _, entry in bench.journal.entries() if entry and entry.camera == "a"]
    assert [(one.kind, one.seq, one.raw) for one in entries[1:]] == [
        ("refused", seq, b"") for seq in (2, 3, 4)
    ]
