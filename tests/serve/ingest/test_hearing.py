"""An event is heard once, for predictions and matches: at its publication or at its delivery."""

from __future__ import annotations

import random
from collections import Counter
from pathlib import Path
from typing import Any, NoReturn, cast

import pytest
from intake_bench import START, IntakeBench, answer_of
from msgspec.structs import replace

from camtopod.admin import Forget, TakeBack
from camtopod.codec import to_msgpack
from camtopod.config import Limits
from camtopod.records import Event, Match, Prediction
from camtopod.serve.ingest import cameras, execute
from camtopod.serve.ingest.intake import HEARD_SECONDS_MAX
from camtopod.serve.live_predictions import FRESH_SECONDS, RECENT_SECONDS, Live, Reader
from camtopod.serve.requests import Batch


class Noting:
    """In place of a version: notes what is observed, and answers everything."""

    def __init__(self) -> None:
        self.predictor = self
        self.walks = NotingWalks()
        self.prepared = self
        self.labels = self
        self.observed: list[Event] = []

    def observe(self, event: Event) -> None:
        self.observed.append(event)

    def answer(self, event: Event) -> Prediction:
        return Prediction(event.camera, None, event.t, event.track, 1, 1.0, [])

    def published(self, prediction: Prediction) -> Prediction:
        return prediction

    def zone_id_of(self, event: Event) -> None: ...

    def name(self, label: object) -> None: ...


class NotingWalks:
    """In place of a version's walks."""

    def __init__(self) -> None:
        self.observed: list[Event] = []

    def observe(self, event: Event, is_matched: bool = True) -> Match | None:
        self.observed.append(event)
        if event.kind == "exit" or not is_matched:
            return None
        return Match(event.camera, event.t, 1, [], 1.0, "", event.track)

    def prepare(self, event: Event, outlooks_max: int) -> bool:
        return True

    def revised(self, now: float, entries_max: int) -> list[Match]:
        return []

    def forget_cameras(self, names: object) -> None: ...


class Scene(IntakeBench):
    """A daemon's path of an event, and its live answers.

    made: the predictions and matches, in order.
    """

    def __init__(self, directory: Path, limits: Limits | None = None) -> None:
        super().__init__(directory, limits)
        self.made: list[Prediction | Match] = []
        self.version = Noting()
        self.live = Live(self.made.append, lambda: self.wall, processor_time=lambda: 0.0)
        self.live.use(cast(Reader, self.version))

    def hear(self, event: Event, is_delivered: bool) -> None:
        self.live.hear(event, is_delivered)

    def work(self) -> None:
        super().work()
        self.live.match(lambda: False)

    def step(self) -> None:
        """Take what has come, while the disk hangs."""
        while self.intake.inbox.has_messages:
            self.intake.step()

    def event(self, camera: str, seq: int, kind: str = "exit", ago: float = 0.0) -> Event:
        """Return an event of the boot ``b1``, ``ago`` seconds before the present."""
        at: Any = kind
        return Event(camera, at, self.wall - ago, track=str(seq), boot="b1", seq=seq)

    def put(self, event: Event, spooled: bool = True) -> None:
        """Publish an event, which its spool delivers as well."""
        content = to_msgpack(replace(event, spooled=spooled))
        self.intake.inbox.on_event(f"event/{event.camera}", content)

    def deliver(self, *events: Event) -> None:
        """Let the spool of a camera deliver events."""
        pairs = [(event.seq or 0, to_msgpack(event)) for event in events]
        self.ask(events[0].camera, Batch("h1", "b1", pairs[0][0] - 1, pairs))

    @property
    def predicted(self) -> list[tuple[str, float]]:
        return [(one.camera, one.t) for one in self.made if isinstance(one, Prediction)]


@pytest.fixture
def scene(tmp_path: Path) -> Scene:
    scene = Scene(tmp_path)
    scene.hello()
    return scene


# --- once, whatever comes first -------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(12))
def test_an_event_is_observed_and_answered_once_however_it_comes(seed: int, tmp_path: Path) -> None:
    """Publications are lost, late or repeated, and deliveries wait, overtake and are repeated."""
    chance = random.Random(seed)
    names = ["a", "b", "c"]
    scene = Scene(tmp_path)
    for name in names:
        scene.hello(name)

    # Draw when each event happens, is published if at all, and is delivered, in its camera's order.
    steps: list[tuple[float, int, str, Event]] = []
    for name in names:
        delivered = 0.0
        t = scene.wall
        for seq in range(1, 40):
            t += chance.expovariate(0.5)
            kind: Any = chance.choice(["entry", "exit"])
            event = Event(name, kind, t, track=str(seq), boot="b1", seq=seq)
            delivered = max(delivered, t + chance.choice([0.01, 0.1, 1.0, 90.0]) * chance.random())
            for _ in range(chance.choice([0, 1, 1, 2])):
                steps.append((t + chance.choice([0.0, 0.2, 2.0]), len(steps), "put", event))
            for late in [0.0, *chance.choice([[], [3.0]])]:
                steps.append((delivered + late, len(steps), "deliver", event))

    expected, first = set(), set()
    for at, _, how, event in sorted(steps):
        scene.tick(max(0.0, at - scene.wall))
        if event not in first and (how == "put" or scene.wall - event.t < FRESH_SECONDS):
            expected.add(event)
        first.add(event)
        if how == "put":
            scene.put(event)
            scene.work()
        else:
            scene.deliver(event)
    scene.tick(120.0)

    assert Counter(event.seq for event in scene.version.observed if event.camera == "a") == Counter(
        range(1, 40)
    )
    numbers = Counter((event.camera, event.seq) for event in scene.version.observed)
    assert len(numbers) == len(names) * 39
    assert set(numbers.values()) == {1}
    assert Counter((e.camera, e.seq) for e in scene.version.walks.observed) == numbers
    answered = Counter((type(one), one.camera, one.track) for one in scene.made)
    kinds = {"entry": Match, "exit": Prediction}
    assert answered == Counter((kinds[e.kind], e.camera, e.track) for e in expected)
    assert len(scene.stored) == len(names) * 39


def test_a_delivery_is_predicted_if_it_is_fresh_and_was_not_heard(scene: Scene) -> None:
    events = [
        scene.event("a", 1, ago=FRESH_SECONDS),
        scene.event("a", 2, ago=FRESH_SECONDS - 0.001),
        scene.event("a", 3),
    ]
    scene.put(events[2])
    scene.deliver(*events)

    assert scene.predicted == [("a", events[2].t), ("a", events[1].t)]
    assert [event.seq for event in scene.version.observed] == [3, 1, 2]


def test_what_is_heard_is_predicted_however_old_it_says_it_is(scene: Scene) -> None:
    """As the clock of its camera may be behind."""
    scene.put(scene.event("a", 1, ago=45.0))
    scene.work()
    assert scene.predicted == [("a", START - 45.0)]


def test_events_of_an_hour_ago_are_no_part_of_walks(scene: Scene) -> None:
    events = [scene.event("a", seq, ago=RECENT_SECONDS - 60.0 * (seq - 1)) for seq in (1, 2)]
    scene.deliver(*events)

    assert [event.seq for event in scene.version.observed] == [1, 2]
    assert [event.seq for event in scene.version.walks.observed] == [2]


def test_what_is_delivered_a_day_later_is_stored_and_not_heard(tmp_path: Path) -> None:
    bench = IntakeBench(tmp_path)
    bench.hello("a")
    bench.store({1: -HEARD_SECONDS_MAX, 2: 1.0 - HEARD_SECONDS_MAX})

    assert bench.intake.counts["stored"] == 2
    assert [event.t - bench.wall for event in bench.heard] == [1.0 - HEARD_SECONDS_MAX]
    bench.intake.event_clock.newest = bench.wall - 9 * HEARD_SECONDS_MAX
    bench.store({3: -9.5 * HEARD_SECONDS_MAX, 4: -10.5 * HEARD_SECONDS_MAX})
    assert len(bench.heard) == 2, "of a recording, the last day"


def test_a_restart_forgets_what_was_heard(tmp_path: Path) -> None:
    bench = IntakeBench(tmp_path)
    event = {"boot": "b1", "seq": 1, "spooled": True}
    bench.publish("a", **event)
    bench.publish("a", **event)
    assert len(bench.heard) == 1
    bench.restart()
    bench.publish("a", **event)
    assert len(bench.heard) == 2


# --- nothing waits for the disk or another camera -------------------------------------------------


def test_exits_are_predicted_while_the_disk_hangs(scene: Scene) -> None:
    for seq in range(1, 31):
        scene.put(scene.event("a", seq))
        scene.step()  # and nothing is stored

    assert len(scene.predicted) == 30
    assert scene.stored == []


def test_exits_are_predicted_while_another_camera_catches_up(scene: Scene) -> None:
    scene.hello("behind")
    scene.send("behind", times={1: -3600.0}, more=1000)
    scene.put(scene.event("a", 1))
    scene.deliver(scene.event("a", 1))

    assert len(scene.predicted) == 1
    assert scene.stored == [("event", "behind", 1), ("event", "a", 1)]


def test_what_is_published_waits_for_no_batch(scene: Scene) -> None:
    """It comes before the next event of a backlog, not after the last."""
    backlog = [scene.event("a", seq, "entry", ago=60.0) for seq in range(1, 501)]
    heard = scene.live.hear

    def hear(event: Event, is_delivered: bool) -> None:
        heard(event, is_delivered)
        if event.seq == 100:
            scene.intake.inbox.on_event("event/b", to_msgpack(Event("b", "exit", scene.wall)))

    scene.intake._hear_event = hear
    scene.deliver(*backlog)

    assert [event.camera for event in scene.version.observed].index("b") == 100


# --- checks, which count nothing ------------------------------------------------------------------


def test_without_a_number_what_is_delivered_as_well_is_heard_then(scene: Scene) -> None:
    scene.publish("a", spooled=True)
    assert scene.version.observed == []


def test_what_is_heard_counts_nothing(scene: Scene) -> None:
    before = scene.intake.counts.copy()
    scene.put(scene.event("a", 1))
    scene.publish("a", spooled=True, boot="b1", seq=2, label=["no", "text"])

    assert scene.intake.counts == before
    assert scene.intake.cameras.status() == {}
    assert not scene.intake.rejects.counts
    assert len(scene.version.observed) == 2


def test_a_flood_is_heard_up_to_its_limit(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cameras, "EVENTS_PER_SECOND_MAX", 2)
    events = [scene.event("a", seq) for seq in range(1, 6)]
    for event in events:
        scene.put(event)
    scene.deliver(*events)

    assert len(scene.predicted) == 2
    assert scene.intake.counts["flood"] == 3, "of those to be stored"


def test_a_stamp_far_ahead_is_not_heard_and_one_a_little_ahead_is(scene: Scene) -> None:
    for seq, ahead in ((1, 61.0), (2, 59.0)):
        scene.put(scene.event("a", seq, ago=-ahead))
    scene.work()

    assert scene.predicted == [("a", START + 59.0)]


def test_cameras_beyond_the_limit_are_not_heard(tmp_path: Path) -> None:
    scene = Scene(tmp_path, Limits(cameras_max=1, commit_seconds=0.0))
    scene.hello("a")
    for name in "ab":
        scene.put(scene.event(name, 1))
        scene.work()

    assert [name for name, _ in scene.predicted] == ["a"]
    assert not scene.intake.rejects.counts


def test_a_forgotten_camera_is_not_heard_and_what_was_heard_of_it_is_forgotten(
    scene: Scene,
) -> None:
    def reset() -> NoReturn:
        raise AssertionError

    def command(one: Forget | TakeBack) -> None:
        execute(scene.intake, one, None, reset, lambda epoch: None)
        scene.live.forget_cameras(scene.intake.names.state.forgotten)

    event = scene.event("a", 1)
    scene.put(event)
    scene.work()
    command(Forget("a", scene.wall))
    scene.put(scene.event("a", 2))
    scene.work()
    assert len(scene.predicted) == 1
    assert scene.live.recent("recent", {}).events == []

    command(TakeBack("a"))
    scene.put(event)
    scene.work()
    assert len(scene.predicted) == 2, "nobody remembers it"


def test_what_others_publish_is_heard_and_stored_once(scene: Scene) -> None:
    for _ in range(2):
        scene.put(scene.event("a", 1), spooled=False)
    scene.work()

    assert len(scene.predicted) == 1
    assert scene.stored == [("event", "a", 1)]


def test_answers_do_not_wait_for_what_is_heard(scene: Scene) -> None:
    scene.put(scene.event("a", 1))
    assert answer_of(scene.send(times={1: 0.0})).have == {"b1": 1}
