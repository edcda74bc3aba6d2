"""The client library with a real daemon on a real bus: what it stores, publishes and waits for."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from fake_bus_daemon import LEFT, NOW, LearnedDaemon, later, learned, put, running, there
from serving import (
    SPAN_SECONDS,
    T0,
    WAIT_SECONDS,
    closing_event,
    free_endpoint,
    numbered,
    small_config,
    wait_for,
    walkers,
)
from synthetic_topology import synthetic_topology

from camtopod.client import Answers, BusError, Gate, NothingLearned, Site, UnknownPlace
from camtopod.client.site_view import SiteView
from camtopod.codec import read
from camtopod.config.settings import BusSettings, Config, TlsSettings
from camtopod.keys import rules
from camtopod.keys.authority import Authority
from camtopod.records import Event, Prediction
from camtopod.serve.bus import dial, open_daemon_session


@pytest.fixture
def site(learned_daemon: LearnedDaemon) -> Iterator[Site]:
    with Site.connect(connect=learned_daemon.daemon.endpoint) as one:
        yield one


# --- what is held ---------------------------------------------------------------------------------


class BeginningAnew(SiteView):
    """A view: the daemon begins anew as soon as the version held is looked at."""

    versions = (5, 5, 1, 1)

    def __init__(self) -> None:
        self._gates = iter([Gate(synthetic_topology(3, version=n)) for n in self.versions])

    @property
    def _gate(self) -> Gate | None:  # type: ignore[override]
        return next(self._gates)


def test_a_version_that_is_waited_for_is_no_lower_one_of_a_daemon_that_begins_anew() -> None:
    version = BeginningAnew()._at_least(5)
    assert version is None or version.version >= 5


class ClosedTwice(Answers[Prediction]):
    """Answers: another thread closes them when this one has seen that they are open."""

    @property
    def closed(self) -> bool:
        closed = self._news.is_closed
        if not closed:
            self._news.is_closed = True
            self._unsubscribe()
        return closed


def test_two_threads_may_close_a_subscription_at_once(tmp_path: Path) -> None:
    with open_daemon_session(small_config(tmp_path)) as bus:
        answers = ClosedTwice(bus, Prediction, None, None)
        answers.close()
        assert answers.closed


def test_what_has_been_learned_is_there_at_once(learned_daemon: LearnedDaemon, site: Site) -> None:
    assert site.current is not None
    assert site.current.version >= 1

    def same() -> bool:
        newest = learned_daemon.daemon.topology
        assert site.current is not None
        assert newest is not None
        return site.current.digest == newest.digest

    wait_for(same, "what other tests have put")

    assert (site.site, site.version, site.stale_since) == ("site", site.current.version, None)
    assert site.wait_for(1, 0.0) is site.current
    assert next(site.versions()) is site.current


def test_versions_come_by_themselves(tmp_path: Path) -> None:
    with (
        running(tmp_path, endpoint := free_endpoint()) as daemon,
        dial(small_config(tmp_path, endpoint)) as bus,
        Site.connect(connect=endpoint) as site,
    ):
        assert (site.current, site.version, site.stale_since) == (None, 0, None)
        with pytest.raises(
            TimeoutError,
            match=r"no version 1 of site site within 0\.1 s, .* 0; the daemon is there",
        ):
            site.wait_for(1, 0.1)
        with pytest.raises(NothingLearned, match="nothing has been learned yet"):
            site.predict(**LEFT)
        with pytest.raises(LookupError):
            site.gate("a/1", 0.0, "b", 8.0)
        events = [*numbered(walkers(60)), closing_event()]
        put(bus, *events)
        seen = [next(site.versions(20.0))]
        last = learned(daemon, events)
        for version in site.versions(20.0):
            seen.append(version)
            if version.version >= last.version:
                break
        numbers = [one.version for one in seen]
        assert numbers == sorted(numbers)
        assert site.wait_for(last.version, 10.0).digest == last.digest, "the same as the daemon's"
        site.observe(Event("a", "entry", NOW, 0.1, 0.5, "7"))
        put(bus, *later(walkers(60, seed=2), 12), Event("late", "entry", T0 + 16 * SPAN_SECONDS))
        newer = site.wait_for(last.version + 1, 20.0)
        assert site._gate is not None
        assert site._gate.topology.version >= newer.version
        assert site._predictor is not None
        assert site._predictor.save().under_way[0][:2] == ("a", "7"), (
            "what was observed outlives a version"
        )

    assert [one.version for one in site.versions()] == [], "closed"
    assert site.predict(**LEFT).next, "what is held stays usable"
    assert site.stale_since is not None


def test_it_goes_on_when_the_daemon_comes_back(tmp_path: Path) -> None:
    endpoint = free_endpoint()
    with contextlib.ExitStack() as stack:
        with running(tmp_path, endpoint):
            site = stack.enter_context(Site.connect(connect=endpoint))
            before = time.time()
        wait_for(lambda: site.stale_since is not None, "staleness to be noticed")

        assert before <= (site.stale_since or 0.0) <= time.time()
        with pytest.raises(TimeoutError, match="no daemon is there"):
            site.wait_for(1, 0.0)
        daemon = stack.enter_context(running(tmp_path, endpoint))
        wait_for(lambda: site.stale_since is None, "the daemon to be noticed")
        with dial(small_config(tmp_path, endpoint)) as bus:
            put(bus, *(events := [*numbered(walkers(40)), closing_event()]))
            version = learned(daemon, events)
            assert site.wait_for(version.version, 20.0).links


# --- what is said ---------------------------------------------------------------------------------


def test_a_prediction_is_the_daemons(learned_daemon: LearnedDaemon, site: Site) -> None:
    said = site.predict(**LEFT, track="7")
    (answer,) = learned_daemon.bus.query("predict/a", {"zone": said.zone, "t": NOW})
    asked = read(Prediction, answer[1], pack=True)

    assert (said.camera, said.t, said.track, said.version) == ("a", NOW, "7", site.version)
    assert [one.zone for one in said.next[:2]] == [one.zone for one in asked.next[:2]]
    assert {one.camera for one in said.next[:2]} == {"b", "c"}
    assert said.next[0].probability == pytest.approx(asked.next[0].probability, abs=0.01)
    assert 7 < said.next[0].q50 < 11
    by_zone = site.predict("a", NOW, zone=said.zone)
    assert by_zone.next[0].probability == pytest.approx(said.next[0].probability, abs=0.05)


def test_how_many_are_between_cameras_is_what_the_daemon_says(
    learned_daemon: LearnedDaemon, site: Site
) -> None:
    between = site.between()
    assert between is not None
    told = learned_daemon.daemon.status(None).between
    assert told is not None
    assert msgspec.structs.replace(between, t=told.t) == told
    site.close()
    with pytest.raises(BusError, match="closed"):
        site.between()


def test_priors_are_those_of_the_version_held(site: Site) -> None:
    assert site.gate("a/2", NOW, "b", NOW + 9.0) > site.gate_new("b") + site.gate_gone("a/2")
    odds = site.affinity(
        [Event("a", "exit", NOW, 0.9, 0.5), Event("a", "exit", NOW + 20.0, 0.9, 0.5)],
        [Event("b", "entry", NOW + 9.0, 0.1, 0.5), Event("c", "entry", NOW + 29.0, 0.1, 0.5)],
    )

    assert (odds[0, 0], odds[1, 1]) > (0.0, 0.0)
    assert odds[0, 1] < 0
    assert odds[1, 0] < 0


def test_what_makes_no_sense_is_said(learned_daemon: LearnedDaemon, site: Site) -> None:
    with pytest.raises(UnknownPlace, match="no camera 'd'; there are"):
        site.predict("d", NOW, x=0.5, y=0.5)
    with pytest.raises(KeyError, match=r"no zone of a called 'b/1'; there are a/\d, a/\d"):
        site.predict("a", NOW, zone="b/1")
    with pytest.raises(ValueError, match="a zone or a position, not both"):
        site.predict(**LEFT, zone="a/1")
    with pytest.raises(ValueError, match="x and y go together"):
        site.predict("a", NOW, x=0.5)
    with pytest.raises(ValueError, match="camera 'a/b': 1 to 64"):
        site.predictions("a/b")
    with pytest.raises(ValueError, match=r"connect '192\.0\.2\.1': write it like tcp/"):
        Site.connect(connect="192.0.2.1")
    with pytest.raises(ValueError, match="site 'h q': 1 to 64"):
        Site.connect("h q")
    tls = Config(bus=BusSettings(tls=TlsSettings("ca.pem", "certificate.pem", "key.pem")))
    with pytest.raises(ValueError, match="write tls/"):
        Site.connect(connect=learned_daemon.daemon.endpoint, config=tls)


def test_nobody_there_is_said(tmp_path: Path) -> None:
    path = tmp_path / "camtopod.toml"
    path.write_text("[bus]\nconnect_seconds = 0.2\n")
    with pytest.raises(BusError, match="is `camtopod run` running there"):
        Site.connect(connect=free_endpoint(), config=path)


def test_a_reader_gets_in_with_its_certificate(tmp_path: Path) -> None:
    authority = Authority.create(tmp_path / "keys", "hq", time.time())
    for role, name in (("daemon", "daemon"), ("reader", "wall")):
        authority.issue(role, name, 100)
    access = tmp_path / "access.json"
    access.write_bytes(msgspec.json.encode(rules.Access("hq", authority.access().certificates)))

    def files(folder: str) -> list[str]:
        return [
            str(tmp_path / "keys" / folder / name)
            for name in ("ca.pem", "certificate.pem", "private.key")
        ]

    endpoint = free_endpoint().replace("tcp/127.0.0.1", "tls/localhost")
    bus = BusSettings(listen=(endpoint,), tls=TlsSettings(*files("daemon"), access=str(access)))
    ca, certificate, private_key = files("reader/wall")
    config = tmp_path / "reader.toml"
    config.write_text(
        f'[site]\nname = "hq"\n[bus]\nconnect = ["{endpoint}"]\n'
        f'[bus.tls]\nca = "{ca}"\ncertificate = "{certificate}"\nprivate_key = "{private_key}"\n'
    )
    with running(tmp_path, endpoint, bus, "hq") as daemon, Site.connect(config=config) as site:
        assert (site.site, site.version, site.stale_since) == ("hq", 0, None)
        put(daemon.bus, *(events := [*numbered(walkers(40)), closing_event()]))
        version = learned(daemon, events)
        assert site.wait_for(version.version, 20.0).links
        with site.predictions() as predictions:
            there(site)
            put(daemon.bus, Event("a", "exit", NOW, 0.9, 0.5))
            assert predictions.get(10.0) is not None
        with site.walks() as matches:
            there(site)
            put(daemon.bus, Event("a", "entry", NOW + 0.25, 0.1, 0.5))
            match = matches.get(10.0)
            assert match is not None
            assert match.walk == f"a@{NOW + 0.25}"


# --- the daemon's own predictions -----------------------------------------------------------------


def test_each_exit_is_heard_of(learned_daemon: LearnedDaemon, site: Site) -> None:
    with site.predictions() as everywhere, site.predictions("b", seconds=0.5) as of_b:
        there(site)
        learned_daemon.bus.publish_raw("prediction/b", b"\xc1", "prediction")  # is passed over
        exits = sorted(
            (e.camera, e.t, e.track) for e in learned_daemon.walks(5, 14) if e.kind == "exit"
        )
        heard = [everywhere.get(10.0) for _ in exits]

        assert sorted((p.camera, p.t, p.track) for p in heard if p is not None) == exits
        assert everywhere.get(0.0) is None
        assert [p.t for p in of_b] == [t for camera, t, _ in exits if camera == "b"], (
            "ends when none comes for 0.5 s"
        )
        assert everywhere.dropped == 0


def test_who_does_not_read_loses_the_oldest_and_is_told(
    learned_daemon: LearnedDaemon, site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("camtopod.client.answer_queue.WAITING_MAX", 3)

    with site.predictions("a") as predictions:
        there(site)
        times = sorted(
            e.t for e in learned_daemon.walks(10, 15) if e.kind == "exit" and e.camera == "a"
        )
        wait_for(lambda: predictions.dropped == 7, "the oldest to be dropped")

        assert [getattr(predictions.get(0.0), "t", None) for _ in range(4)] == [*times[-3:], None]


# --- the end of a program --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("last_line", "status"),
    [
        ("site.current", 0),
        ("raise SystemError", 1),
        ("queues = site.predictions(), site.walks()", 0),
        ("threading.Thread(target=list, args=[site.versions()], daemon=True).start()", 0),
        ("threading.Thread(target=site.between).start()", 0),
    ],
)
def test_a_program_ends_after_its_last_line(
    learned_daemon: LearnedDaemon, last_line: str, status: int
) -> None:
    program = "import sys, threading, camtopod\nsite = camtopod.connect(connect=sys.argv[1])\n"
    command = [sys.executable, "-c", program + last_line, learned_daemon.daemon.endpoint]

    assert subprocess.run(command, timeout=WAIT_SECONDS).returncode == status


# --- as a package ---------------------------------------------------------------------------------


def test_it_needs_only_the_core_packages() -> None:
    """A program in which nothing else can be imported, not even OpenCV, can import it."""
    program = """
import sys
class Only:
    def find_spec(self, name, path=None, target=None):
        top = name.split(".")[0]
        if top[0] != "_" and top not in {"camtopod", "zenoh", "numpy", "scipy", "msgspec", *sys.stdlib_module_names}:
            raise ModuleNotFoundError(f"{name} is not among them", name=name)
sys.meta_path.insert(0, Only())
import camtopod.client.aio
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)

    assert done.stderr == ""
