"""Several daemons share a site: subscriptions, and the merged topology with one version line."""

from __future__ import annotations

import contextlib
import logging
import shutil
import sqlite3
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import msgspec
import pytest
from serving import T0, WAIT_SECONDS, numbered, small_config, wait_for, walkers

from camtopod import codec
from camtopod.cli import exits, main
from camtopod.config.settings import Config, KeepSettings
from camtopod.learn.settings import Settings
from camtopod.records import Event, Topology
from camtopod.serve.bus.session import Bus, BusError, QueryError, dial
from camtopod.serve.bus.single_daemon import OtherDaemons
from camtopod.serve.bus.topology_subscriber import TopologySubscriber
from camtopod.serve.daemon import Daemon
from camtopod.serve.learner_process.messages import ShardUpdate
from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.shards import site_merger as mergers
from camtopod.serve.shards.membership import ShardMembership
from camtopod.serve.shards.shard_exchange import ShardExchange
from camtopod.serve.shards.site_merger import SiteMerger
from camtopod.serve.shards.subscriptions import SMALL_CAMERAS_MAX, Subscriptions
from camtopod.serve.storage.packed_version import Version
from camtopod.sharding.assignment import Sharding
from camtopod.sharding.shard_learner import ShardLearner
from camtopod.sim.settings import SimSettings
from camtopod.sim.simulation import simulate

SETTINGS = Settings(refit_share=0.3)
SHARDING = Sharding(districts=4)
EVENTS = simulate(SimSettings(cameras=6, hours=0.25, seed=4))[0]
NOON = 1_700_000_000.0


class FakeBus:
    """Stores subscriptions."""

    site = "hq"

    def __init__(self) -> None:
        self.keys: list[str] = []
        self.there: list[str] = []

    def subscribe(self, key: str, on_message: object) -> Callable[[], None]:
        self.keys.append(key)
        return lambda: self.keys.remove(key)

    def list_alive(self, role: str) -> list[str]:
        return self.there

    def watch_alive(self, role: str, on_change: Callable[[str, bool], None]) -> None:
        for name in self.there:
            on_change(name, True)

    def announce(self, role: str, name: str) -> None:
        self.there.append(name)


def shards_of(count: int) -> list[ShardLearner]:
    return [ShardLearner(SETTINGS, SHARDING, (number, count), "hq", "e") for number in range(count)]


def told(learner: ShardLearner) -> ShardUpdate:
    """Return a part as a newly started daemon publishes it."""
    return ShardUpdate(*learner.shard, learner.reached(), learner.newest_parts())


class Course(NamedTuple):
    """What ``count`` shards make of the events; learned once and reused."""

    versions: list[Topology]
    """Of the first of them; if it is alone, the site's."""
    steps: list[list[ShardUpdate]]
    """Whenever somebody made a version: what each of them says then."""
    rest: list[ShardUpdate]
    """And at the end."""
    early: ShardUpdate
    """Who made the first version, as if it had just started."""
    after: dict[int, list[ShardUpdate]]
    """Each of them as if it had just started, after so many events."""


THIRD, HALF = len(EVENTS) // 3, len(EVENTS) // 2


@lru_cache
def course(count: int, districts: int = SHARDING.districts) -> Course:
    """Return the course of the shards of a site with so many districts."""
    sharding = msgspec.structs.replace(SHARDING, districts=districts)
    learners = [
        ShardLearner(SETTINGS, sharding, (number, count), "hq", "e") for number in range(count)
    ]
    versions, steps, early, after = (
        list[Topology](),
        list[list[ShardUpdate]](),
        list[ShardUpdate](),
        dict[int, list[ShardUpdate]](),
    )
    for number, event in enumerate(EVENTS, 1):
        for learner in learners:
            learner.receive(event)
        made = [learner.updates() for learner in learners]
        if any(made):
            steps.append(
                [
                    ShardUpdate(*learner.shard, learner.reached(), learner.parts())
                    for learner in learners
                ]
            )
        if not early:
            early = [told(learner) for learner, its in zip(learners, made, strict=True) if its]
        versions += made[0]
        if number in (THIRD, HALF, 2 * THIRD, len(EVENTS)):
            after[number] = [told(learner) for learner in learners]
    rest = [ShardUpdate(*learner.shard, learner.reached(), learner.parts()) for learner in learners]
    return Course(versions, steps, rest, early[0], after)


@pytest.fixture
def alone() -> list[Topology]:
    """Return the versions of one learner with all districts."""
    return course(1).versions


class Site:
    """A running merger in a folder."""

    def __init__(self, folder: Path, shards: int, sharding: Sharding = SHARDING) -> None:
        self.versions: list[Version] = []
        self.merger = SiteMerger(
            folder,
            KeepSettings(),
            SETTINGS,
            "hq",
            sharding,
            shards,
            lambda: NOON,
            lambda version: self.versions.append(version),
        )
        self.stopping = threading.Event()
        self.thread = threading.Thread(target=self.merger.work, args=(self.stopping,))
        self.thread.start()

    def __enter__(self) -> Site:
        return self

    def __exit__(self, *_: object) -> None:
        self.stopping.set()
        self.thread.join()
        self.merger.close()

    def say(self, one: ShardUpdate) -> None:
        self.merger.on_update(f"part/{one.shard}", codec.to_msgpack(one))


def content(topology: Topology) -> object:
    return topology.version, topology.digest


@pytest.mark.parametrize("count", [1, 2, 4])
def test_shards_together_have_the_versions_of_one(
    count: int, tmp_path: Path, alone: list[Topology]
) -> None:
    with Site(tmp_path, count) as site:
        made = 0
        for step in course(count).steps:
            for one in step:
                site.say(one)
            made = len(
                [
                    version
                    for version in alone
                    if version.as_of <= min(one.reached or 0 for one in step)
                ]
            )
        wait_for(lambda: len(site.versions) >= made, f"{made} versions")
    assert made > 3
    assert [content(version.newest.topology) for version in site.versions] == [
        content(one) for one in alone[:made]
    ]
    assert all(version.delta is not None for version in site.versions[1:])


def test_a_merger_that_starts_again_goes_on_with_the_line(tmp_path: Path) -> None:
    for events in (HALF, len(EVENTS)):
        with Site(tmp_path, 2) as site:
            before = site.merger.topology
            assert (before is None) == (events == HALF)
            for one in 2 * course(2).after[events]:  # what has been said is no news
                site.say(one)
            wait_for(lambda: bool(site.versions), "a version")
            first = site.versions[0].newest.topology
            if before is not None:
                assert (first.epoch, first.version) == (before.epoch, before.version + 1)
                assert site.merger.version(before.epoch, before.version) == codec.to_json(before)
    numbers = [version.newest.topology.version for version in site.versions]
    assert numbers == list(range(first.version, first.version + len(numbers)))


def test_no_version_has_two_contents_if_the_newest_snapshot_is_damaged(tmp_path: Path) -> None:
    """Otherwise it would be made again from an older one, of other parts."""
    published: list[Topology] = []
    for events in (THIRD, 2 * THIRD, len(EVENTS)):
        with Site(tmp_path, 1) as site:
            site.say(course(1).after[events][0])
            wait_for(lambda site=site: bool(site.versions), "a version")  # type: ignore[misc]
        published += [version.newest.topology for version in site.versions]
        if events == 2 * THIRD:
            with contextlib.closing(
                sqlite3.connect(tmp_path / "site" / "journal.db", isolation_level=None)
            ) as journal:
                journal.execute(
                    "UPDATE snapshot SET state = x'00' WHERE position = (SELECT MAX(position) FROM snapshot)"
                )
    assert published[-1].epoch > published[0].epoch
    assert len({(one.epoch, one.version) for one in published}) == len(published)


def test_a_new_epoch_begins_with_what_is_known_though_nobody_says_anything(tmp_path: Path) -> None:
    for events in (HALF, len(EVENTS)):
        with Site(tmp_path, 1) as site:
            site.say(course(1).after[events][0])
            wait_for(lambda site=site: bool(site.versions), "a version")  # type: ignore[misc]
    before = site.versions[-1].newest.topology
    with contextlib.closing(
        sqlite3.connect(tmp_path / "site" / "journal.db", isolation_level=None)
    ) as journal:
        journal.execute(
            "UPDATE snapshot SET state = x'00' WHERE position = (SELECT MAX(position) FROM snapshot)"
        )
    with Site(tmp_path, 1) as site:
        wait_for(lambda: bool(site.versions), "a version of what is known")
    first = site.versions[0]
    assert first.newest.topology.epoch > before.epoch
    assert (first.newest.topology.version, first.delta) == (1, None)
    assert first.newest.topology.cameras


def test_no_version_has_two_contents_if_the_journal_comes_back_older(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Otherwise its versions would be made again, of other parts."""
    published: list[Topology] = []
    for events in (THIRD, 2 * THIRD, len(EVENTS)):
        with Site(tmp_path, 1) as site:
            site.say(course(1).after[events][0])
            wait_for(lambda site=site: bool(site.versions), "a version")  # type: ignore[misc]
        published += [version.newest.topology for version in site.versions]
        if events == THIRD:
            shutil.copyfile(tmp_path / "site" / "journal.db", tmp_path / "earlier.db")
        elif events == 2 * THIRD:
            shutil.copyfile(tmp_path / "earlier.db", tmp_path / "site" / "journal.db")
    assert "has come back older than it was" in caplog.text
    assert published[-1].epoch > published[0].epoch
    assert len({(one.epoch, one.version) for one in published}) == len(published)


def test_a_merger_whose_journal_is_gone_says_so(tmp_path: Path) -> None:
    with Site(tmp_path, 1) as site:
        (tmp_path / "site" / "journal.db").unlink()
        wait_for(
            lambda: "journal.db is gone while it is in use" in site.merger.reason, "it to notice"
        )


def test_a_shard_that_is_away_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mergers, "PATIENCE_SECONDS", 0.3)
    first, second = course(2).after[len(EVENTS)]
    with Site(tmp_path, 2) as site:
        site.say(first)
        wait_for(lambda: bool(site.versions), "a version without the other")
        cameras = {camera.id for camera in site.versions[-1].newest.topology.cameras}
        assert cameras == {event.camera for event in EVENTS if shards_of(2)[0].owns(event.camera)}
        site.say(first)
        site.say(second)
        wait_for(
            lambda: (
                {camera.id for camera in site.versions[-1].newest.topology.cameras}
                == {e.camera for e in EVENTS}
            ),
            "both shards' cameras",
        )


def test_who_gets_on_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, alone: list[Topology]
) -> None:
    """One shard publishes everything some time after the other, so something always waits."""
    now, said, made = [0.0], course(2).steps, list[Version]()
    monkeypatch.setattr(mergers, "time", SimpleNamespace(monotonic=lambda: now[0]))
    late = [pair[1] for pair in said]
    with contextlib.closing(
        SiteMerger(tmp_path, KeepSettings(), SETTINGS, "hq", SHARDING, 2, lambda: NOON, made.append)
    ) as merger:
        for first, second in zip([*(pair[0] for pair in said), None], [None, *late], strict=True):
            for one in (first, second):
                if one is not None:
                    merger.add_update(one)
            one_round(merger)
            now[0] += 0.6 * mergers.PATIENCE_SECONDS
    assert len(made) > 5
    assert [content(version.newest.topology) for version in made] == [
        content(one) for one in alone[: len(made)]
    ]


def one_round(merger: SiteMerger) -> None:
    stopping = threading.Event()
    merger.work(stopping, stopping.set)


def test_a_journal_that_cannot_be_read_is_closed_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_: mergers.Journal) -> None:
        raise sqlite3.OperationalError("disk I/O error")

    with monkeypatch.context() as patch:
        patch.setattr(mergers.Journal, "snapshots", fails)
        with pytest.raises(sqlite3.OperationalError, match="disk I/O error"):
            Site(tmp_path, 1)
    with Site(tmp_path, 1) as site:  # nothing holds its lock
        assert site.merger.topology is None


def test_a_site_that_is_dealt_out_anew_has_every_camera_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Also while some shards do not know the new settings."""
    [before], [after] = course(1).after[2 * THIRD], course(1, districts=2).after[len(EVENTS)]
    with Site(tmp_path, 1) as site:
        site.say(before)
        wait_for(lambda: bool(site.versions), "a version")
        old = site.versions[-1].newest.topology
    with Site(tmp_path, 1, Sharding(districts=2)) as site:
        site.say(before)
        site.say(after)
        newest = max(part.topology.as_of for part in after.parts)
        wait_for(
            lambda: bool(site.versions) and site.versions[-1].newest.topology.as_of == newest,
            "the newest parts",
        )
    new = site.versions[-1].newest.topology
    assert (new.epoch, new.version) > (old.epoch, old.version)
    assert [camera.id for camera in new.cameras] == sorted({event.camera for event in EVENTS})
    assert len({zone.id for zone in new.zones}) == len(new.zones)
    assert "different [shards] settings" in caplog.text


def test_of_what_waits_too_long_the_newest_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though the answer to a query may be older than the messages in between."""
    monkeypatch.setattr(mergers, "INBOX_MAX", 1)
    [newest], made = course(1).after[len(EVENTS)], list[Version]()
    with contextlib.closing(
        SiteMerger(tmp_path, KeepSettings(), SETTINGS, "hq", SHARDING, 1, lambda: NOON, made.append)
    ) as merger:
        merger.add_update(newest)
        merger.add_update(course(1).early)
        merger.add_update(msgspec.structs.replace(newest, parts=[]))
        one_round(merger)
    assert course(1).versions[0].links != course(1).versions[-1].links
    assert made[-1].newest.topology.links == course(1).versions[-1].links


def test_too_much_at_a_time_costs_versions_and_nothing_else(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, alone: list[Topology]
) -> None:
    monkeypatch.setattr(mergers, "INBOX_MAX", 2)
    merger = SiteMerger(
        tmp_path, KeepSettings(), SETTINGS, "hq", SHARDING, 2, lambda: NOON, lambda version: None
    )
    for step in [*course(2).steps, course(2).rest]:
        for one in step:
            merger.add_update(one)
    stopping = threading.Event()
    worker = threading.Thread(target=merger.work, args=(stopping,))
    worker.start()
    try:
        wait_for(
            lambda: merger.topology is not None and merger.topology.digest == alone[-1].digest,
            "the end",
        )
        assert merger.topology is not None
        assert merger.topology.version < alone[-1].version
    finally:
        stopping.set()
        worker.join()
        merger.close()


def test_nonsense_changes_nothing(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with Site(tmp_path, 2) as site:
        for one in (ShardUpdate(2, 3, 5.0), ShardUpdate(0, 3, 5.0)):
            site.say(one)
        site.merger.on_update("part/1", codec.to_msgpack(ShardUpdate(0, 2, 5.0)))
        site.merger.on_update("part/1", b"rubbish")
        assert site.merger.topology is None
    assert [record.levelname for record in caplog.records if record.levelno > logging.INFO] == [
        "ERROR"
    ] * 4


def test_what_a_shard_hears() -> None:
    sharding = Sharding(districts=8, guest_turns=6, turn_hours=1.0)
    share = ShardMembership(sharding, (1, 4))
    cameras = [f"cam{number}" for number in range(300)]
    own = {camera for camera in cameras if share.owns(camera)}
    assert 40 < len(own) < 110
    assert all(share.needs(camera, NOON) for camera in cameras)  # none of them is known yet
    share.strangers = frozenset(cameras)
    heard = [
        {camera for camera in cameras if share.needs(camera, NOON + hour * 3600.0)}
        for hour in range(6)
    ]
    assert all(own <= one for one in heard)
    assert set.union(*heard) == set(cameras)
    assert max(map(len, heard)) < 0.7 * len(cameras)
    stranger = min(set(cameras) - heard[0])
    share.strangers -= {stranger}
    assert share.needs(stranger, NOON)


def test_each_camera_is_owned_once() -> None:
    shares = [ShardMembership(SHARDING, (number, 3)) for number in range(3)]
    for number in range(50):
        assert sum(share.owns(f"cam{number}") for share in shares) == 1


def test_subscriptions_follow_turns_and_neighbours() -> None:
    bus, now, said = FakeBus(), [NOON], list[tuple[str, bool]]()
    share = ShardMembership(Sharding(districts=16, guest_turns=12), (0, 16))
    hearing = Subscriptions(
        bus,
        share,
        lambda: now[0],
        lambda key, raw: None,  # type: ignore[arg-type]
        lambda camera, alive: said.append((camera, alive)),
        10_000,
    )
    few = [f"c{number}" for number in range(SMALL_CAMERAS_MAX)]
    hearing.add_cameras(few)
    hearing.update()
    assert hearing.cameras == set(few)  # a small site
    for number in range(500):
        hearing.on_alive(f"cam{number}", True)
    hearing.update()
    assert len(hearing.cameras) == len(few) + 500  # all are new
    share.strangers = frozenset(hearing.cameras)
    hearing.update()
    before = hearing.cameras
    assert sorted(bus.keys) == sorted(f"event/{camera}" for camera in before)
    assert len(before) < 300
    ended = {camera for camera, alive in said if not alive}
    assert {camera for camera, alive in said if alive} - ended == {
        c for c in before if c.startswith("cam")
    }
    said.clear()
    now[0] += 6 * 3600.0
    hearing.update()
    gone = before - hearing.cameras
    assert len(gone) > 20
    assert {camera for camera, alive in said if not alive} == {
        camera for camera in gone if camera.startswith("cam")
    }
    assert all(share.needs(camera, now[0]) for camera in hearing.cameras)
    hearing.on_alive("no/camera", True)
    assert "no/camera" not in hearing.cameras


def test_shards_of_one_site_are_no_rivals() -> None:
    bus = FakeBus()
    first = OtherDaemons(bus, "A", (0, 2))  # type: ignore[arg-type]
    first.appear()
    OtherDaemons(bus, "B", (1, 2)).require_none(0.0, threading.Event())  # type: ignore[arg-type]
    assert first.reason == ""
    for name, shard in (("B", (0, 2)), ("B", (1, 3)), ("B", None)):
        with pytest.raises(OSError, match="another daemon"):
            OtherDaemons(bus, name, shard).require_none(0.0, threading.Event())  # type: ignore[arg-type]
    OtherDaemons(bus, "A", (0, 2)).require_none(0.0, threading.Event())  # type: ignore[arg-type]  # its own trace


def test_what_is_told_travels() -> None:
    one = course(2).after[len(EVENTS)][0]
    assert one.parts
    assert msgspec.msgpack.decode(codec.to_msgpack(one), type=ShardUpdate) == one
    assert codec.read(ShardUpdate, codec.to_msgpack(one), pack=True) == one
    assert isinstance(EVENTS[0], Event)


def shared_config(state: Path, connect: str | None = None) -> Config:
    return msgspec.structs.replace(small_config(state, connect), shards=Sharding(districts=4))


def a_day() -> list[Event]:
    """Return some walkers, and a last event of each camera that advances event time."""
    events = walkers(150)
    return numbered(
        [*events, *(Event(camera, "entry", T0 + 20 * 1200.0, 0.5, 0.5) for camera in "abc")]
    )


@contextlib.contextmanager
def site_of(folder: Path, count: int) -> Iterator[list[Daemon]]:
    """Run all shards of a site; the first is the meeting point."""
    with contextlib.ExitStack() as stack:
        daemons = [stack.enter_context(Daemon(shared_config(folder), shard=(0, count)))]
        daemons += [
            stack.enter_context(
                Daemon(shared_config(folder, daemons[0].endpoint), shard=(number, count))
            )
            for number in range(1, count)
        ]
        yield daemons


@contextlib.contextmanager
def published(folder: Path, endpoint: str, events: list[Event]) -> Iterator[tuple[Bus, Publisher]]:
    """Publish events through their cameras' spools until they are acknowledged."""
    with dial(small_config(folder, endpoint)) as bus:
        spool = Spool(folder / "spool.db", "b1", 100_000)
        publisher = Publisher(spool, 100)
        publisher.attach(bus)
        publisher.publish(*events)
        assert publisher.wait_acknowledged(WAIT_SECONDS)
        yield bus, publisher
        spool.close()


def test_daemons_that_share_a_site_have_one_topology(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It equals that of one learner of all districts; predictions come once, from the
    camera's owner.
    """
    monkeypatch.setattr(mergers, "PATIENCE_SECONDS", WAIT_SECONDS)  # the machine may be busy
    events = a_day()
    alone = ShardLearner(shared_config(tmp_path).learn, Sharding(districts=4))
    for event in events:
        alone.receive(event)
    expected = alone.updates()
    assert expected[-1].links
    with (
        site_of(tmp_path / "state", 2) as daemons,
        published(tmp_path, daemons[0].endpoint, events[:-3]) as (bus, publisher),
    ):
        for daemon in (
            daemons
        ):  # what lets time go on may not overtake anything on the way to the other shard
            wait_for(
                lambda daemon=daemon: daemon.status()["events"]["stored"] == len(events) - 3,
                "all events",
            )  # type: ignore[misc]
        publisher.publish(*events[-3:])
        seen = TopologySubscriber(bus)
        seen.wait_for(len(expected), WAIT_SECONDS)
        assert seen.topology is not None
        assert content(seen.topology) == content(expected[-1])
        wait_for(lambda: daemons[1].topology == seen.topology, "the other shard to know it, too")
        said = [daemon.status() for daemon in daemons]
        assert [status["shard"] for status in said] == ["0/2", "1/2"]
        assert {(one["epoch"], one["version"]) for one in said} == {
            (seen.topology.epoch, seen.topology.version)
        }

        predictions: list[str] = []
        bus.subscribe("prediction/*", lambda key, payload: predictions.append(key))
        later = [
            Event(camera, "exit", T0 + 30_000.0, 0.9, 0.5, boot="b2", seq=1) for camera in "abc"
        ]
        for event in later:
            bus.publish(f"event/{event.camera}", event, "event")
        wait_for(lambda: len(predictions) >= 3, "a prediction for each exit")
        assert sorted(predictions) == [f"prediction/{camera}" for camera in "abc"]
        for camera in "abc":
            assert len(bus.query(f"predict/{camera}", {"x": 0.9, "y": 0.5})) == 1
        assert len(bus.query("topology")) == 1


def _cameras(seen: TopologySubscriber) -> set[str]:
    newest = seen.update() or seen.topology
    return set() if newest is None else {camera.id for camera in newest.cameras}


def test_a_shard_that_was_away_goes_on(tmp_path: Path) -> None:
    """Its cameras' events wait for it in the spool; the other's do not wait."""
    events = a_day()
    half = len(events) // 2
    config, other = (
        shared_config(tmp_path / "state"),
        ShardMembership(Sharding(districts=4), (1, 2)),
    )
    mine = [event for event in events[half:] if not other.owns(event.camera)]
    with Daemon(config, shard=(0, 2)) as first:
        at = shared_config(tmp_path / "state", first.endpoint)
        with dial(at) as bus:
            spool = Spool(tmp_path / "spool.db", "b1", 100_000)
            publisher = Publisher(spool, 100)
            publisher.attach(bus)
            with Daemon(at, shard=(1, 2)):
                publisher.publish(*events[:half])
                assert publisher.wait_acknowledged(WAIT_SECONDS)
            publisher.publish(*events[half:])
            left = len(events) - half - len(mine)
            assert publisher.wait_acknowledged(WAIT_SECONDS, left)
            assert publisher.unacknowledged == left > 0
            with Daemon(at, shard=(1, 2)):
                assert publisher.wait_acknowledged(WAIT_SECONDS)
                seen = TopologySubscriber(bus)
                wait_for(lambda: len(_cameras(seen)) == 3, "all cameras")
            spool.close()


def test_a_shard_does_not_start_beside_itself_or_alone(tmp_path: Path) -> None:
    """All three start at once; each waits a while for the other to end."""
    with (
        Daemon(shared_config(tmp_path / "one"), shard=(0, 2)) as first,
        ThreadPoolExecutor() as at_once,
    ):
        others = [(0, 2), (1, 3), None]
        tried = [
            at_once.submit(
                Daemon(
                    shared_config(tmp_path / f"other-{number}", first.endpoint), shard=shard
                ).start
            )
            for number, shard in enumerate(others)
        ]
        for one in tried:
            with pytest.raises(BusError, match="another daemon"):
                one.result()


def test_what_a_shard_of_many_cameras_has_learned_is_not_too_large(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Each camera takes about 60 kB; the message is invalid, so its arrival shows as a refusal."""
    config = shared_config(tmp_path / "state")
    with (
        Daemon(config, shard=(0, 2)) as first,
        dial(shared_config(tmp_path, first.endpoint)) as bus,
    ):
        bus.publish_raw("part/1", b"x" * (config.bus.message_bytes_max // 2), "part")
        wait_for(lambda: "an update on part/1 is invalid" in caplog.text, "the part")


def test_a_refusal_in_a_shards_place_ends_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def refuse(sharing: ShardExchange) -> ShardUpdate:
        raise QueryError("not now")

    monkeypatch.setattr(ShardExchange, "_answer", refuse)
    with Daemon(shared_config(tmp_path / "state"), shard=(0, 2)) as first:
        wait_for(lambda: caplog.text.count("it is repeated: not now") > 1, "it to ask again")
        assert first.failing() == []


def test_shards_on_the_command_line(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    for given, said in (
        ("2/2", "is not a shard"),
        ("x", "is not a shard"),
        ("1/99", "cannot share 16"),
    ):
        with contextlib.suppress(SystemExit):
            assert main.main(["run", "--shard", given, "--state", str(tmp_path)]) == exits.USAGE
        assert said in capsys.readouterr().err
