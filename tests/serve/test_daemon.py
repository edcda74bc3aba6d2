"""The daemon on a real bus in the test's process: input, output, queries."""

from __future__ import annotations

import logging
import os
import random
import signal
import sqlite3
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
import serving
from fake_bus import OneBus
from msgspec.structs import replace
from serving import (
    T0,
    WAIT_SECONDS,
    all_out,
    closing_event,
    numbered,
    small_config,
    wait_for,
    walkers,
)
from synthetic_topology import synthetic_topology

from camtopod import codec
from camtopod.learn.learner import Learner
from camtopod.learn.settings import TopologySettings
from camtopod.records import (
    Between,
    CameraFigures,
    DaemonStatus,
    Event,
    Match,
    Prediction,
    Topology,
    VersionModel,
)
from camtopod.serve import bus as buses, daemon as daemons
from camtopod.serve.bus import Bus, BusError, QueryError
from camtopod.serve.bus.topology_subscriber import TopologySubscriber
from camtopod.serve.daemon import Daemon
from camtopod.serve.ingest.intake import SILENT_SECONDS
from camtopod.serve.outbox.publisher import SpoolPublisher
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.runtime.clock import ulid
from camtopod.serve.storage.journal import Journal
from camtopod.serve.storage.sqlite_file import StateError
from camtopod.topology import map_of, version_model, with_digest
from camtopod.topology.versions import digest_of

NOW = T0 + 20 * serving.SPAN_SECONDS


class Site:
    """A daemon and clients on its bus; the clock stands still unless it is moved."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.now = NOW
        self._open: list[Any] = []

    def daemon(self, **limits: float) -> Daemon:
        daemon = Daemon(small_config(self.directory / "state", **limits), clock=lambda: self.now)
        daemon.start()
        self._open.append(daemon.stop)
        return daemon

    def client(self, daemon: Daemon) -> Bus:
        bus = buses.dial(small_config(self.directory, daemon.endpoint))
        self._open.append(bus.close)
        return bus

    def publisher(self, name: str = "spool") -> SpoolPublisher:
        spool = Spool(self.directory / f"{name}.db", f"boot-{name}", 100_000)
        publisher = SpoolPublisher(spool)
        self._open += [spool.close, publisher.close]
        return publisher

    def close(self) -> None:
        for close in reversed(self._open):
            close()


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    one = Site(tmp_path)
    yield one
    one.close()


def put(bus: Bus, *events: Event) -> None:
    for event in events:
        bus.publish(f"event/{event.camera}", event, "event")


def stored(daemon: Daemon, count: int) -> None:
    wait_for(lambda: daemon.status().events.stored >= count, f"{count} stored events")
    assert daemon.status().events.stored == count


def caught_up(view: TopologySubscriber, version: int) -> Topology:
    """Wait until a view has at least a version; return what it has."""

    def there() -> bool:
        view.update()
        return view.topology is not None and view.topology.version >= version

    wait_for(there, f"version {version}")
    assert view.topology is not None
    return view.topology


def learned(events: list[Event]) -> Topology:
    """Return the newest version of the plain learner over the same events."""
    learner = Learner(small_config(Path()).learn, site="site", epoch="any")
    for event in sorted(events, key=lambda event: event.t):
        learner.receive(event)
    assert learner.topology is not None
    return learner.topology


def journal_of(site: Site) -> list[tuple[str, str, str | None, int | None]]:
    journal = Journal(site.directory / "state")
    rows = [(e.kind, e.camera, e.boot, e.seq) for _, e in journal.entries() if e is not None]
    journal.close()
    return rows


# --- events in, versions out ----------------------------------------------------------------------


def test_events_are_stored_once_and_learned_as_the_plain_learner_does(site: Site) -> None:
    daemon = site.daemon()
    bus = site.client(daemon)
    events = [*numbered(walkers(40)), closing_event()]
    view = TopologySubscriber(bus)
    expected = learned(events)
    put(bus, *events, *events[:50])
    caught_up(view, expected.version)
    assert view.topology is not None
    assert (view.topology.version, view.topology.digest) == (expected.version, expected.digest)
    assert view.topology.epoch == daemon.epoch
    wait_for(lambda: daemon.status().events.duplicate == 50, "duplicates")
    stored(daemon, len(events))
    late = TopologySubscriber(site.client(daemon))
    assert caught_up(late, 1) == view.topology, "a late joiner gets the whole"
    status = daemon.status()
    assert (status.alarms, status.score) == ([], expected.score)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_daemon_whose_learner_is_killed_fails_and_goes_on_where_it_was(site: Site) -> None:
    daemon = site.daemon()
    events = [*numbered(walkers(40)), closing_event()]
    put(site.client(daemon), *events[:100])
    wait_for(
        lambda: daemon.status().events.stored == 100 and not daemon.status().events.waiting,
        "learning",
    )
    assert daemon._process is not None
    os.kill(daemon._process.pid, signal.SIGKILL)
    assert daemon.wait(WAIT_SECONDS)
    assert daemon.failing() == ["a part of the daemon has failed"]
    daemon.stop()
    again = site.daemon()
    assert again.epoch == daemon.epoch
    put(site.client(again), *events[100:])
    expected = learned(events)
    wait_for(
        lambda: again.topology is not None and again.topology.version == expected.version,
        "the last version",
    )
    assert again.topology is not None
    assert again.topology.digest == expected.digest


def test_old_versions_can_be_asked_for(site: Site) -> None:
    daemon = site.daemon()
    bus = site.client(daemon)
    events = [*numbered(walkers(40)), closing_event()]
    last = learned(events).version
    put(bus, *events)
    wait_for(
        lambda: daemon.topology is not None and daemon.topology.version == last, "the last version"
    )

    def asked(**parameters: object) -> Topology:
        map_ = codec.read(Topology, bus.query("topology", parameters)[0][1], pack=True)
        assert map_.model is None
        answer = bus.query("topology/model", parameters)[0][1]
        return replace(map_, model=codec.read(VersionModel, answer, pack=True).model)

    first = asked(version=1)
    assert (first.version, first.digest) == (1, digest_of(first))
    assert asked(version=1, epoch=daemon.epoch) == first
    assert asked() == asked(version=last)
    assert daemon.topology is not None
    assert asked().digest == daemon.topology.digest
    for nonsense in ({"version": 999}, {"version": "x"}, {"version": 1, "epoch": "other"}):
        with pytest.raises(QueryError, match="is not kept"):
            bus.query("topology", nonsense)
    before = daemon.status().journal
    daemon.stop()
    again = site.daemon()
    assert asked_of(site, again, first.version) == map_of(first)
    assert again.status().journal.entries == before.entries


def asked_of(site: Site, daemon: Daemon, version: int) -> Topology:
    return codec.read(
        Topology, site.client(daemon).query("topology", {"version": version})[0][1], pack=True
    )


def test_epochs_sort_by_time_whatever_the_clock_does() -> None:
    first = ulid(NOW)
    assert len(first) == 26
    assert ulid(NOW - 1000.0) < first < ulid(NOW + 0.001)
    assert first < ulid(NOW, after=first) < ulid(NOW + 0.002)
    assert first < ulid(NOW - 1e6, after=first)


def test_a_camera_is_alive_as_soon_as_its_grabber_is_there_and_away_when_that_is_known(
    site: Site,
) -> None:
    daemon = site.daemon()
    put(site.client(daemon), *numbered([Event(camera, "entry", NOW) for camera in "abc"]))
    stored(daemon, 3)
    bus = site.client(daemon)
    bus.query("admin/forget", {"camera": "c"}, one=True)
    bus.query("admin/rename", {"old": "b", "new": "yard"}, one=True)
    daemon.stop()

    # After a start nothing is said of a quiet camera until its grabber has come back.
    daemon = site.daemon()
    assert daemon.status().cameras == {}
    site.publisher().attach(site.client(daemon), ["b"])
    wait_for(lambda: bool(daemon.status().cameras), "the grabber")
    assert daemon.status().cameras == {"yard": CameraFigures(alive=True)}

    site.now += daemons.RETURN_SECONDS
    assert daemon.status().cameras == {"a": CameraFigures(), "yard": CameraFigures(alive=True)}


def test_a_walk_goes_on_after_a_start_and_is_not_told_again(site: Site) -> None:
    daemon = site.daemon()
    put(site.client(daemon), *(events := [*numbered(walkers(60)), closing_event()]))
    wait_for(lambda: all_out(daemon, len(events)), "what it learned to be used")
    first = Event("a", "entry", NOW - 15.0, 0.1, 0.5, "p")
    put(site.client(daemon), first, Event("a", "exit", NOW - 10.0, 0.9, 0.5, "p"))
    stored(daemon, len(events) + 2)
    daemon.stop()

    again = site.daemon()
    bus = site.client(again)
    matches: list[Match] = []
    bus.subscribe("match/*", lambda key, payload: matches.append(codec.read(Match, payload, True)))
    bus.query("topology")
    put(bus, Event("b", "entry", NOW - 1.0, 0.1, 0.5, "q"))
    wait_for(lambda: bool(matches), "the match")
    assert [(one.camera, one.track, one.walk) for one in matches] == [
        ("b", "q", f"a@{first.t:.0f}")
    ]
    assert (matches[0].from_[0].track, matches[0].from_[0].t) == ("p", NOW - 10.0)

    again.stop()
    kept = [path.read_bytes() for path in (site.directory / "state").rglob("*") if path.is_file()]
    assert not any(matches[0].walk.encode() in content for content in kept), "in memory only"
    assert any(b"track\xa1q" in content for content in kept), "the event is stored"


def test_the_status_says_how_many_are_between_cameras_since_the_start(site: Site) -> None:
    daemon = site.daemon()
    bus = site.client(daemon)
    assert daemon.status().between is None, "nothing has been learned yet"
    put(bus, *(events := [*numbered(walkers(60)), closing_event()]))
    wait_for(lambda: all_out(daemon, len(events)), "what it learned to be used")
    assert daemon.status().between == Between(site.now, site.now, 0.0, 0, 0), "that was before"

    site.now = NOW + 3.0
    put(bus, *(Event("a", "exit", NOW + 1.0 + k, 0.9, 0.5, str(k)) for k in range(2)))
    stored(daemon, len(events) + 2)
    told = daemon.status().between
    assert told is not None
    assert (told.t, told.since) == (NOW + 3.0, NOW)
    assert 1.5 < told.number < 2.0
    assert told.low < told.number < told.high
    assert {(one.from_, one.to) for one in told.pairs[:2]} == {("a", "b"), ("a", "c")}
    [one] = daemon.status(pairs_max=1).between.pairs  # type: ignore[union-attr]
    [(_, raw)] = bus.query("status/daemon", {"pairs": "all"})
    asked = codec.read(DaemonStatus, raw, pack=True).between
    assert asked is not None
    assert asked.pairs[0] == one

    daemon.stop()
    assert site.daemon().status().between == Between(site.now, site.now, 0.0, 0, 0)


def test_every_exit_is_predicted_and_questions_are_answered(site: Site) -> None:
    daemon = site.daemon()
    bus = site.client(daemon)
    put(bus, *(events := [*numbered(walkers(60)), closing_event()]))
    wait_for(lambda: all_out(daemon, len(events)), "what it learned to be used")
    assert daemon.topology is not None
    assert len(daemon.topology.links) > 0
    predictions: list[Prediction] = []
    bus.subscribe(
        "prediction/*", lambda key, raw: predictions.append(codec.read(Prediction, raw, pack=True))
    )
    t = T0 + 11 * serving.SPAN_SECONDS
    put(bus, Event("a", "exit", t, 0.9, 0.5, "x1"), Event("a", "entry", t + 1, 0.1, 0.5))
    put(bus, Event("a", "exit", t + 2, 0.9, 0.5))
    wait_for(lambda: len(predictions) == 2, "predictions")
    assert [(p.camera, p.t, p.track) for p in predictions] == [("a", t, "x1"), ("a", t + 2, None)]
    assert daemon.topology is not None
    assert predictions[0].version == daemon.topology.version
    assert {following.camera for following in predictions[0].next} <= {"b", "c", "a"}
    assert sum(following.probability for following in predictions[0].next) + predictions[
        0
    ].leave == pytest.approx(1)

    [(key, raw)] = bus.query("predict/a", {"x": 0.9, "y": 0.5, "t": t})
    asked = codec.read(Prediction, raw, pack=True)
    assert (key, asked.camera, asked.zone) == ("predict/a", "a", predictions[0].zone)
    [(_, raw)] = bus.query("predict/a", {"zone": asked.zone, "t": t, "format": "application/json"})
    assert codec.read(Prediction, raw).zone == asked.zone
    for parameters in ({"zone": "b/1"}, {"x": 0.5}, {"t": "noon"}, {"zone": "a/99"}):
        with pytest.raises(QueryError):
            bus.query("predict/a", parameters)
    asked_again(bus, daemon, t + 100)

    [(key, raw)] = bus.query("topology", {"format": "application/json"})
    assert codec.read(Topology, raw).digest == daemon.topology.digest
    [(key, raw)] = bus.query("status/*")
    assert key == "status/daemon"
    assert msgspec.msgpack.decode(raw)["state"] == "running"


def asked_again(bus: Bus, daemon: Daemon, t: float) -> None:
    """Predict again for an object that left a at ``t``, and usually appears at b or c 9 s later."""

    def said(**parameters: object) -> Prediction:
        return codec.read(
            Prediction, bus.query("predict/a", {"t": t, **parameters})[0][1], pack=True
        )

    def at(prediction: Prediction, camera: str) -> float:
        return sum(
            following.probability for following in prediction.next if following.camera == camera
        )

    place = {"x": 0.9, "y": 0.5}
    at_exit = said(**place)
    assert said(**place, now=t) == at_exit
    assert min(at(at_exit, "b"), at(at_exit, "c")) > 0.2
    for where in (place, {"zone": at_exit.zone}):
        none_came = said(**where, now=t + 60)
        assert at(none_came, "b") + at(none_came, "c") < 0.1 < 0.8 < none_came.leave
    put(bus, Event("a", "exit", t, 0.9, 0.5), Event("b", "entry", t + 9, 0.1, 0.5))
    wait_for(lambda: at(said(**place, now=t + 20), "b") > 0.9, "the arrival at b to count")
    came = said(**place, now=t + 20)
    assert came.next[0].q10 <= 9 <= came.next[0].q90 < 20
    assert said(**place, now=t + 8).leave < 0.5, "it had not come by then"
    for now, why in (
        (t - 1, "now is .*: give the time of the exit"),
        ("nan", "now is nan"),
        ("noon", "and now are num"),
    ):
        for where in (place, {"zone": at_exit.zone}):
            with pytest.raises(QueryError, match=why):
                said(**where, now=now)
    assert daemon.status().questions_refused == 10


def test_nothing_learned_yet_is_an_answer(site: Site) -> None:
    bus = site.client(site.daemon())
    for key in ("topology", "predict/a"):
        with pytest.raises(QueryError, match="nothing has been learned yet"):
            bus.query(key)


def test_time_goes_on_without_events(site: Site) -> None:
    """When the events of a live site stop, the events held back are learned all the same."""
    daemon = site.daemon(settle_seconds=1.0)
    events = numbered(walkers(10))
    shift = NOW - 5.0 - events[-1].t
    events = [msgspec.structs.replace(event, t=event.t + shift) for event in events]
    put(site.client(daemon), *events)
    stored(daemon, len(events))
    assert daemon.topology is None
    site.now += 4 * serving.SPAN_SECONDS
    wait_for(lambda: daemon.topology is not None, "a version")
    assert daemon.topology is not None
    wait_for(lambda: daemon.status().learner.learned == len(events), "every event to be learned")
    wait_for(lambda: all_out(daemon, len(events)), "its versions")
    before = daemon.topology
    daemon.stop()
    assert site.daemon().topology == before, "the passing of time is in the journal too"


# --- what does not fit ----------------------------------------------------------------------------


def test_garbage_is_counted_quoted_once_and_survived(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    daemon = site.daemon()
    bus = site.client(daemon)
    chance = random.Random(7)
    with caplog.at_level(logging.WARNING):
        for _ in range(300):
            bus.publish_raw("event/lobby", chance.randbytes(chance.randrange(0, 80)), "event")
        bus.publish_raw("event/lobby", b"\xff" * 5000, "event")
        bus.publish_raw(
            "event/lobby",
            b'{"camera":"lobby","kind":"entry","t":1,"track":"rtsp://u:p@ss@h"',
            "event",
        )
        put(bus, Event("hall", "entry", T0))
        bus.publish("event/lobby", Event("hall", "entry", T0), "event")
        good = Event("lobby", "entry", T0)
        bus.publish_raw("event/lobby", codec.to_json(good), "event")
        stored(daemon, 2)
    counts = daemon.status().rejects
    assert sum(counts.values()) == 303
    assert counts["wrong-camera"] == 1
    assert counts["too-long"] == 1
    quoted = [record for record in caplog.records if record.getMessage().startswith("rejected")]
    assert len(quoted) == len(counts)
    assert '{"camera":"hall","kind":"entry"' in caplog.text, "MessagePack is quoted as text"
    assert "p@ss" not in caplog.text
    assert daemon.status().state == "running"
    daemon.stop()
    assert journal_of(site) == [("event", "hall", None, None), ("event", "lobby", None, None)]


def test_a_clock_behind_the_newest_event_is_said_with_what_to_do(site: Site) -> None:
    first = site.daemon()
    put(site.client(first), *(Event(camera, "entry", NOW) for camera in "ab"))
    wait_for(lambda: first.status().learner.accepted == 2, "the events to be learned")
    first.stop()

    site.now = NOW - 86_400.0
    again = site.daemon()

    status = again.status()
    assert status.state == "degraded"
    assert "clock is 86400 s behind the newest event: nothing is taken" in status.reason
    assert status.reason in again.unready()
    assert again.failing() == [], "to start it again changes nothing"
    site.now = NOW
    wait_for(lambda: (again.status().reason, again.unready()) == ("", []), "it to be ready")


# --- the bus itself -------------------------------------------------------------------------------


def test_nobody_there_is_said_with_what_to_do(tmp_path: Path) -> None:
    config = small_config(tmp_path, "tcp/127.0.0.1:1")
    config = msgspec.structs.replace(
        config, bus=msgspec.structs.replace(config.bus, connect_seconds=0.3)
    )
    with pytest.raises(
        BusError, match=r"cannot reach the bus at tcp/127.0.0.1:1: is `camtopod run` running"
    ):
        buses.dial(config)


def test_a_second_daemon_at_the_same_endpoint_is_refused(site: Site, tmp_path: Path) -> None:
    daemon = site.daemon()
    config = small_config(tmp_path / "other")
    config = msgspec.structs.replace(
        config, bus=msgspec.structs.replace(config.bus, listen=(daemon.endpoint,))
    )
    with pytest.raises(BusError, match="another daemon may be running there"):
        Daemon(config).start()
    other = Daemon(small_config(tmp_path / "other"))
    other.start()
    other.stop()


class StopAtTheFirstWait(threading.Event):
    """A request to stop that comes while the other daemon is waited for."""

    def wait(self, timeout: float | None = None) -> bool:
        self.set()
        return True


def test_a_daemon_that_is_stopped_while_another_is_there_never_joins_it(
    site: Site, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    daemon = site.daemon()
    config = small_config(tmp_path / "other", daemon.endpoint)

    other = Daemon(config)

    assert not other.start(StopAtTheFirstWait())
    assert not other.started
    assert daemon.bus.list_alive("daemon") == [daemon._rivals.name]
    assert "serves the same site" not in caplog.text


def test_a_start_that_cannot_read_the_journal_leaves_it_to_the_next(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(journal: Journal, key: str) -> str | None:
        raise sqlite3.OperationalError("disk I/O error")

    with monkeypatch.context() as context:
        context.setattr(Journal, "meta", fail)
        with pytest.raises(StateError, match="disk I/O error; the file was not modified"):
            Daemon(small_config(tmp_path)).start()
    Journal(tmp_path).close()


def test_what_nobody_takes_for_its_size_is_said_once(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    config = small_config(tmp_path)
    config = msgspec.structs.replace(
        config, bus=msgspec.structs.replace(config.bus, message_bytes_max=1000)
    )
    with buses.open_daemon_session(config) as bus:
        bus.answer_queries("topology", lambda key, parameters: "y" * 2000, "topology")
        for size in (990, 1500, 1600):
            bus.publish_raw("event/a", b"x" * size, "event")
        bus.query("topology")
    said = [record.getMessage() for record in caplog.records if record.levelno == logging.ERROR]
    assert [line.partition(",")[0] for line in said] == [
        "a message on event/a has 1500 bytes",
        "a message on topology has 2003 bytes",
    ]


def test_a_view_takes_each_newer_version_and_any_of_a_new_epoch(site: Site) -> None:
    versions: list[Topology] = []
    learner = Learner(small_config(Path()).learn, site="site", epoch="01A")
    for event in [*walkers(40), closing_event()]:
        learner.receive(event)
        versions += learner.updates()
    assert len(versions) >= 4
    bus = buses.open_daemon_session(small_config(site.directory))
    whole = versions[0]
    bus.answer_queries("topology", lambda key, parameters: whole, "topology")
    bus.announce("daemon", "site")
    client = buses.dial(small_config(site.directory, bus.endpoint))
    view = TopologySubscriber(client)
    assert caught_up(view, 1) == versions[0]

    def publish(version: Topology) -> Callable[[], bool]:
        """Publish until it is taken: of two at once a full link drops the second."""

        def is_taken() -> bool:
            bus.publish("topology", version, "topology")
            return view.update() is not None

        return is_taken

    wait_for(publish(versions[1]), "the next version")
    assert view.topology == versions[1]
    wait_for(publish(versions[3]), "a version, though one is missing")
    assert view.topology == versions[3]
    bus.publish("topology", versions[2], "topology")
    renamed = [msgspec.structs.replace(version, epoch="01B") for version in versions]
    wait_for(publish(renamed[1]), "a version of a new epoch")
    assert view.topology == renamed[1]
    client.close()
    bus.close()


def test_a_view_that_missed_a_version_fetches_it_when_the_status_names_a_newer_version() -> None:
    versions: list[Topology] = []
    learner = Learner(small_config(Path()).learn, site="site", epoch="01A")
    for event in [*walkers(40), closing_event()]:
        learner.receive(event)
        versions += learner.updates()
    bus = OneBus()
    bus.kept[1] = versions[0]
    view = TopologySubscriber(bus)  # type: ignore[arg-type]
    assert view.update() == versions[0]
    bus.kept[2] = versions[1]

    def told_and_updated() -> bool:
        bus.publish("status/daemon", {"epoch": "01A", "version": 2, "state": "running"})
        return view.update() == versions[1]

    wait_for(told_and_updated, "the whole to be fetched")
    assert view.fetch_count == 2
    told_and_updated()
    assert view.fetch_count == 2


def test_a_view_goes_on_with_the_version_before_until_map_and_model_are_there() -> None:
    """In whichever order they come; a model of another version is none of a map."""
    first, second, third = (
        with_digest(replace(synthetic_topology(4, version=number), epoch="01A"))
        for number in (1, 2, 3)
    )
    bus = OneBus()
    bus.kept[1] = first
    view = TopologySubscriber(bus)  # type: ignore[arg-type]
    assert view.update() == first

    bus.publish("topology", msgspec.to_builtins(map_of(second)))
    assert (view.update(), view.topology) == (None, first)
    bus.publish("topology/model", version_model(second))
    assert view.update() == second
    bus.publish("topology/model", version_model(third))
    assert (view.update(), view.topology) == (None, second)
    bus.publish("topology", msgspec.to_builtins(map_of(third)))
    assert view.update() == third
    assert digest_of(third) == third.digest
    assert view.fetch_count == 1


def test_a_grabber_of_an_older_version_is_in_the_status(site: Site) -> None:
    daemon = Daemon(small_config(site.directory / "state"), clock=lambda: site.now)
    site._open.append(daemon.stop)
    daemon.start()
    client = site.client(daemon)
    client.announce("grabber", "lobby")
    wait_for(lambda: "lobby" in daemon._intake.alive, "its token")
    put(client, Event("lobby", "entry", NOW, boot="b1", seq=1))
    wait_for(lambda: daemon.status().events.stored == 1, "its event")

    assert daemon.status().warnings == []
    site.now += SILENT_SECONDS
    words = "camera lobby: its grabber is too old for this daemon: upgrade it"
    wait_for(lambda: daemon.status().warnings == [words], "the warning")


def test_names_that_no_camera_has_are_said_after_ten_minutes(site: Site) -> None:
    known = TopologySettings(neighbours=(("a", "b"), ("a", "lobbi")))
    config = replace(small_config(site.directory / "state"), topology=known)
    daemon = Daemon(config, clock=lambda: site.now)
    site._open.append(daemon.stop)
    daemon.start()
    put(site.client(daemon), *(Event(camera, "entry", NOW) for camera in "ab"))
    wait_for(lambda: daemon.status().learner.accepted == 2, "the events to be learned")

    assert daemon.status().warnings == []
    site.now += 600.0
    assert daemon.status().warnings == ["[topology] names cameras that are not there: lobbi"]
