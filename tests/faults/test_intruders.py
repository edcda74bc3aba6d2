"""Intruders against a real daemon, over mutual TLS, each session in a process of its own.

Each attack is made twice: under the access rules, where it must have no effect, and by a client
that the rules allow everything (or without rules), where it must succeed. Otherwise the test proves
nothing.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from grabber import publisher_on
from puppets import HQ, Puppet, client
from real_daemon import OPEN, RealDaemon, status_over
from serving import (
    T0,
    WAIT_SECONDS,
    closing_event,
    free_endpoint,
    small_config,
    wait_for,
    walkers,
)
from site_keys import Keys

from bench.support.site import resident
from camtopod.cli import exits
from camtopod.cli.main import main
from camtopod.config.settings import BusSettings, Config, SiteSettings
from camtopod.keys import rules
from camtopod.keys.authority import Authority
from camtopod.serve.bus import Bus, BusError, dial, open_daemon_session
from camtopod.serve.bus.topology_subscriber import TopologySubscriber
from camtopod.serve.daemon import Daemon

BIG_BYTES = 2 * 1024 * 1024
GROWTH_BYTES_MAX = 24 * 1024 * 1024


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Keys:
    return Keys(tmp_path_factory.mktemp("keys"))


def guarded_config(keys: Keys, state: Path, access: Path | None = None) -> Config:
    """Return the configuration of a daemon with authentication."""
    bus = keys.bus("daemon", listen="tls/127.0.0.1:0")
    if access is not None:
        bus = msgspec.structs.replace(bus, tls=msgspec.structs.replace(bus.tls, access=str(access)))
    return msgspec.structs.replace(small_config(state), site=SiteSettings("hq"), bus=bus)


@pytest.fixture(scope="module")
def guarded(keys: Keys, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Return the endpoint of a daemon with the access rules."""
    with Daemon(guarded_config(keys, tmp_path_factory.mktemp("guarded"))) as daemon:
        yield daemon.endpoint


@pytest.fixture(scope="module")
def observers(keys: Keys, guarded: str) -> Iterator[Puppet]:
    with contextlib.closing(Puppet()) as one:
        assert one.open(**client(guarded), **keys.tls("daemon"))
        yield one


@pytest.fixture
def observer(observers: Puppet) -> Puppet:
    """Return a client with the daemon's certificate, which may do everything."""
    observers.do("reset")
    return observers


@pytest.fixture(scope="module")
def unguarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RealDaemon]:
    """Run a daemon without authentication, for this machine only."""
    daemon = RealDaemon(tmp_path_factory.mktemp("unguarded"), OPEN)
    yield daemon
    daemon.stop()


MakePuppet = Callable[[], Puppet]


@pytest.fixture
def make_puppet() -> Iterator[MakePuppet]:
    with contextlib.ExitStack() as stack:
        yield lambda: stack.enter_context(contextlib.closing(Puppet()))


# --- a stolen box ---------------------------------------------------------------------------------

OWN = {
    *(f"put {HQ}/{key}" for key in ("event/cam1", "status/cam1", "alive/grabber/cam1")),
    "asked store/cam1",
    f"thief heard put {HQ}/alive/daemon/last",
}
"""What a camera's certificate allows: its own events and status, and to see the daemon."""
STOLEN = [
    *(("put", key) for key in ("event/cam2", "event/*", "event/cam1/x", "store/cam1")),
    *(("put", key) for key in ("topology", "topology/delta", "prediction/cam1", "status/cam2")),
    ("put", "match/cam1"),
    *(("delete", key) for key in ("event/cam1", "topology")),
    *(("appear", key) for key in ("alive/grabber/cam2", "alive/daemon/thief")),
]
ASKED = (
    *("store/cam1", "store/cam2", "store/*", "topology", "predict/cam1?zone=cam1/1"),
    *("status/daemon", "recent", "admin/forget?camera=nobody", "admin/*", "**"),
)
ANSWERED = ("store/cam1", "store/cam2", "topology")
HEARD = ("event/cam2", "prediction/cam2", "match/cam2", "topology/delta", "status/cam2")


def attack(thief: Puppet, observer: Puppet, everything: bool = False) -> set[str]:
    """Try everything a stolen box of cam1 might try; return the attempts that had an effect.

    everything: all of it is expected, and waited for.
    """
    observer.do("subscribe", key=f"{HQ}/**")
    observer.do("watch", key=f"{HQ}/alive/**")
    observer.do("appear", key=f"{HQ}/alive/grabber/cam3")
    wait_for(lambda: reaches(thief, observer, f"{HQ}/event/cam1"), "a way to the observer")

    # Publish, offer answers, and listen.
    thief.do("appear", key=f"{HQ}/alive/grabber/cam1")
    for what, key in STOLEN:
        thief.do(what, key=f"{HQ}/{key}")
    for key in ("store/*", *ANSWERED):
        thief.do("answer", key=f"{HQ}/{key}", payload="from the thief")
    for key in ("store/*", "event/*", "prediction/*", "match/*", "topology/delta", "status/*"):
        thief.do("subscribe", key=f"{HQ}/{key}")
    for key in ("alive/grabber/*", "alive/daemon/*"):
        thief.do("watch", key=f"{HQ}/{key}")
    thief.do("put", key=f"{HQ}/status/cam1")  # the last, so that all before it has been dealt with
    observer.hears(*(line for line in OWN if line.startswith("put ")))

    # Let it hear something, and ask it.
    for key in HEARD:
        observer.do("put", key=f"{HQ}/{key}", payload="y")
    observer.do("appear", key=f"{HQ}/alive/daemon/last")
    audible = ("alive/daemon/last", *(HEARD if everything else ()))
    thief.hears(*(f"put {HQ}/{key}" for key in audible))
    seconds = WAIT_SECONDS if everything else 0.5
    effects = {
        f"answered {key}"
        for key in ANSWERED
        if is_answered(observer, key, seconds, "from the thief")
    }
    for key in ASKED:
        expected = everything or f"asked {key}" in OWN
        if is_answered(thief, key, WAIT_SECONDS if expected else 0.5):
            effects.add(f"asked {key}")

    # What was heard is looked at last: it comes in another order than it was sent in. On a slow
    # machine the thief may be lost for a moment, and its own token with it.
    usual = rf"/daemon(?!/thief)|cam3|delete {HQ}/alive/grabber/cam1"
    effects |= {line for line in observer.do("heard") if not re.search(usual, line)}
    usual = r"alive/daemon/(?!last)|alive/grabber/cam[12]"
    heard = [line for line in thief.do("heard") if not re.search(usual, line)]
    return effects | {f"thief heard {line}" for line in heard}


def is_answered(asker: Puppet, key: str, seconds: float, by: str = "") -> bool:
    """Return True if an answer that begins with ``by`` comes within ``seconds``.

    It is asked for again: zenoh sometimes loses one, and offers to answer arrive in any order.
    """
    deadline = time.monotonic() + seconds
    while not any(answer.startswith(by) for answer in asker.do("ask", key=f"{HQ}/{key}")):
        if time.monotonic() > deadline:
            return False
        time.sleep(0.02)
    return True


def reaches(one: Puppet, other: Puppet, key: str) -> bool:
    """Return True if messages arrive.

    A peer's session is open before it is connected, so its first messages are lost.
    """
    one.do("put", key=key)
    return f"put {key}" in other.do("heard")


@pytest.mark.parametrize("mode", ["client", "peer"])
def test_a_stolen_box_can_deliver_its_own_events_and_nothing_else(
    mode: str, keys: Keys, guarded: str, observer: Puppet, make_puppet: MakePuppet
) -> None:
    thief = make_puppet()
    assert thief.open(**client(guarded, mode), **keys.tls("camera/cam1"))

    assert attack(thief, observer) == OWN


def test_a_stolen_box_that_poses_as_a_router_gains_and_breaks_nothing(
    keys: Keys, guarded: str, observer: Puppet, make_puppet: MakePuppet
) -> None:
    thief, other = make_puppet(), make_puppet()
    observer.do("subscribe", key=f"{HQ}/**")
    observer.do("watch", key=f"{HQ}/alive/grabber/*")
    assert thief.open(**client(guarded, "router"), **keys.tls("camera/cam1"))
    for what, key in STOLEN:
        thief.do(what, key=f"{HQ}/{key}")
    for key in (*ANSWERED, "**"):
        thief.do("answer", key=f"{HQ}/{key}", payload="from the thief")
    for key in ("event/*", "prediction/*", "**"):
        thief.do("subscribe", key=f"{HQ}/{key}")
    thief.do("appear", key=f"{HQ}/alive/grabber/cam1")
    observer.hears(f"put {HQ}/alive/grabber/cam1")

    assert other.open(**client(guarded), **keys.tls("camera/cam2"))
    other.do("put", key=f"{HQ}/event/cam2")
    observer.hears(f"put {HQ}/event/cam2")
    usual = rf"daemon|delete {HQ}/alive/grabber/cam1"  # a pausing machine may lose the thief
    heard = [line for line in observer.do("heard") if not re.search(usual, line)]
    assert sorted(heard) == [f"put {HQ}/alive/grabber/cam1", f"put {HQ}/event/cam2"]
    wait_for(lambda: other.do("ask", key=f"{HQ}/store/cam2"), "the daemon's answer")
    assert "from the thief" not in other.do("ask", key=f"{HQ}/store/cam2")
    assert "from the thief" not in observer.do("ask", key=f"{HQ}/topology")
    observer.do("put", key=f"{HQ}/prediction/cam2")
    assert thief.do("ask", key=f"{HQ}/status/daemon") == []
    assert thief.do("heard") == []


def test_the_file_for_a_router_of_its_own_enforces_the_same(
    keys: Keys, make_puppet: MakePuppet
) -> None:
    endpoint = free_endpoint().replace("tcp/", "tls/")
    folder = keys.folder / "daemon"
    access = rules.read_access((folder / "access.json").read_bytes())
    (folder / "router.json5").write_text(rules.router_json5(access, [endpoint], 1 << 24))
    thief, observer = make_puppet(), make_puppet()

    with router_of(folder):
        assert thief.open(**client(endpoint), **keys.tls("camera/cam1"))
        assert observer.open(**client(endpoint), **keys.tls("daemon"))
        effects = attack(thief, observer)

    assert effects == OWN - {"asked store/cam1"}, "there is no daemon"


@contextlib.contextmanager
def router_of(folder: Path) -> Iterator[None]:
    """Run zenoh on the router.json5 of a folder, in a process of its own."""
    start = "import sys, zenoh; s = zenoh.open(zenoh.Config.from_file('router.json5'));"
    router = subprocess.Popen(
        [sys.executable, "-c", f"{start} print(1, flush=True); sys.stdin.read(); s.close()"],
        cwd=folder,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert router.stdout is not None
    assert router.stdout.readline() == b"1\n"
    try:
        yield
    finally:
        router.communicate(timeout=WAIT_SECONDS)


def test_the_same_box_allowed_everything_does_all_of_it(
    keys: Keys, tmp_path: Path, make_puppet: MakePuppet
) -> None:
    access = keys.allow(tmp_path / "access.json", everything="cam1")
    thief, observer = make_puppet(), make_puppet()

    with Daemon(guarded_config(keys, tmp_path / "state", access)) as daemon:
        assert thief.open(**client(daemon.endpoint), **keys.tls("camera/cam1"))
        assert observer.open(**client(daemon.endpoint), **keys.tls("daemon"))
        effects = attack(thief, observer, everything=True)

    done = {f"{what.replace('appear', 'put')} {HQ}/{key}" for what, key in STOLEN if "*" not in key}
    heard = {f"thief heard put {HQ}/{key}" for key in (*HEARD, "alive/grabber/cam3")}
    assert effects >= OWN | done | heard
    assert effects >= {f"answered {key}" for key in ANSWERED}
    assert effects >= {f"asked {key}" for key in ASKED}


def test_a_reader_reads_and_nothing_else(
    keys: Keys, guarded: str, observer: Puppet, make_puppet: MakePuppet
) -> None:
    reader = make_puppet()
    assert reader.open(**client(guarded), **keys.tls("reader/wall"))
    observer.do("subscribe", key=f"{HQ}/**")
    topics = ("topology", "topology/delta", "prediction/*", "match/*", "status/*")
    for key in (*topics, "event/*", "**"):
        reader.do("subscribe", key=f"{HQ}/{key}")
    reader.do("watch", key=f"{HQ}/alive/daemon/*")

    # It asks.
    assert reader.do("ask", key=f"{HQ}/status/daemon", seconds=WAIT_SECONDS)
    nothing = ["nothing has been learned yet"]
    for key in ("topology", "predict/cam1?zone=cam1/1"):
        # on a busy machine a question may end late, which is an answer, too
        wait_for(lambda key=key: reader.do("ask", key=f"{HQ}/{key}") == nothing, "it alone")  # type: ignore[misc]
    assert reader.do("ask", key=f"{HQ}/recent", seconds=WAIT_SECONDS)
    for key in ("store/cam1", "admin/forget?camera=nobody", "admin/reset"):
        assert reader.do("ask", key=f"{HQ}/{key}") == []

    # It listens, and tries to publish.
    readable = ("topology", "topology/delta", "prediction/cam1", "match/cam1", "status/cam1")
    for key in (*readable, "event/cam1", "store/cam1"):
        reader.do("put", key=f"{HQ}/{key}", payload="from the reader")
        reader.do("delete", key=f"{HQ}/{key}")
        observer.do("put", key=f"{HQ}/{key}")
    reader.hears(*(f"put {HQ}/{key}" for key in readable))
    wait_for(lambda: any("alive/daemon/" in line for line in reader.do("heard")), "the daemon")
    heard = {line for line in reader.do("heard") if "daemon" not in line}
    assert heard == {f"put {HQ}/{key}" for key in readable}
    assert reader.do("ask", key=f"{HQ}/status/daemon", seconds=WAIT_SECONDS), (
        "with it, what was put is dealt with"
    )
    assert [line for line in observer.do("heard") if "daemon" not in line] == []


def test_a_box_whose_certificate_was_withdrawn_has_no_rights(
    keys: Keys, guarded: str, observer: Puppet, make_puppet: MakePuppet
) -> None:
    thief = make_puppet()
    assert thief.open(**client(guarded), **keys.tls("camera/gone")), "it is the authority's"
    observer.do("subscribe", key=f"{HQ}/event/*")
    thief.do("put", key=f"{HQ}/event/gone")

    assert thief.do("ask", key=f"{HQ}/store/gone") == []  # and the put has been dealt with
    assert not [line for line in observer.do("heard") if "/event/" in line]


# --- at the door ----------------------------------------------------------------------------------


def test_who_is_not_let_in(keys: Keys, guarded: str, make_puppet: MakePuppet) -> None:
    intruder = make_puppet()
    good = client(guarded) | keys.tls("camera/cam1")
    own = "transport/link/tls/connect_"
    nothing = {own + "certificate": None, own + "private_key": None}
    plain = {"connect/endpoints": [guarded.replace("tls/", "tcp/")]}
    for reason, wrong in (
        ("no certificate", nothing | {"transport/link/tls/enable_mtls": False}),
        ("another authority's", _own(keys.tls("other/camera/cam1"))),
        ("expired", _own(keys.tls("old/camera/cam1"))),
        ("not TLS", plain | {"transport/link/protocols": ["tcp"]}),
    ):
        assert not intruder.open(**good | wrong), reason

    assert intruder.open(**good), "the control: the same with a good certificate"


@pytest.mark.parametrize("options", ["", "#iface=lo"])
def test_that_the_daemons_certificate_has_ended_is_said_where_the_grabber_is(
    options: str, tmp_path: Path
) -> None:
    keys, site = Keys(tmp_path / "keys"), SiteSettings("hq")
    old = Authority(keys.folder, time.time() - 50 * 86400.0)
    old.issue("daemon", "daemon", 20, replace=True)
    listening = Config(bus=keys.bus("daemon", listen="tls/127.0.0.1:0"), site=site)
    with open_daemon_session(listening) as daemon:
        endpoint = f"{daemon.endpoint}{options}"
        words = f"the certificate of the daemon at {endpoint} has ended: make another"
        bus = keys.bus("camera/cam1", endpoint, patience=0.5)
        with pytest.raises(BusError, match=words):
            dial(Config(bus=bus, site=site))


def _own(tls: dict[str, Any]) -> dict[str, Any]:
    """Return a folder with certificate and key only; the authority stays the site's."""
    return {key: value for key, value in tls.items() if "root_ca" not in key}


def test_a_stolen_box_cannot_pass_for_the_daemon(keys: Keys) -> None:
    """A listener at the daemon's address has to present the daemon's certificate."""
    site = SiteSettings("hq")
    for own, accepted in (("camera/cam2", False), ("daemon", True)):
        listening = Config(bus=keys.bus(own, listen="tls/127.0.0.1:0"), site=site)
        with open_daemon_session(listening) as false_daemon:
            bus = keys.bus("camera/cam1", false_daemon.endpoint, patience=0.5)
            if accepted:
                dial(Config(bus=bus, site=site)).close()
            else:
                with pytest.raises(BusError, match="does it accept this certificate"):
                    dial(Config(bus=bus, site=site))


# --- too large ------------------------------------------------------------------------------------


def test_what_is_too_large_neither_arrives_nor_takes_memory(
    unguarded: RealDaemon, make_puppet: MakePuppet
) -> None:
    flooder, observer = make_puppet(), make_puppet()
    assert flooder.open(**client(unguarded.endpoint))
    assert observer.open(**client(unguarded.endpoint))
    good = '{"camera":"cam1","kind":"entry","t":1}'
    event = "camtopo/site/event/cam1"
    with unguarded.dial() as bus:

        def await_received(count: int) -> None:
            flooder.do("put", key=event, payload=good)
            wait_for(lambda: status_over(bus)["events"]["received"] == count, "the one that fits")

        await_received(1)
        before = resident(unguarded.process.pid)
        for size, count in ((BIG_BYTES, 20), (rules.EVENT_BYTES_MAX + 1, 100)):
            flooder.do("put", key=event, repeat=size, count=count)
        await_received(2)
        assert status_over(bus)["rejects"] == {}
        assert resident(unguarded.process.pid) - before < GROWTH_BYTES_MAX
        flooder.do("put", key=event, repeat=rules.EVENT_BYTES_MAX)
        too_long = {"too-long": 1}
        wait_for(lambda: status_over(bus)["rejects"] == too_long, "what the bus lets pass")

    # The filter limits events; a message of any kind is limited where the daemon reassembles it.
    observer.do("subscribe", key=f"{HQ}/any/*")
    wait_for(lambda: reaches(flooder, observer, f"{HQ}/any/small"), "a way to the observer")
    flooder.do("put", key=f"{HQ}/any/large", repeat=BIG_BYTES)
    flooder.do("put", key=f"{HQ}/any/fits", repeat=BIG_BYTES // 4)
    observer.hears(f"put {HQ}/any/fits")
    assert f"put {HQ}/any/large" not in observer.do("heard")


def test_without_limits_the_same_arrives(make_puppet: MakePuppet) -> None:
    unlimited, flooder = make_puppet(), make_puppet()
    endpoint = free_endpoint()
    listen = {"listen/endpoints": [endpoint], "connect/endpoints": []}
    assert unlimited.open(**rules.session_settings("router"), **listen)
    unlimited.do("subscribe", key="**")
    assert flooder.open(**client(endpoint))

    flooder.do("put", key=f"{HQ}/event/cam1", repeat=BIG_BYTES)

    unlimited.hears(f"put {HQ}/event/cam1")


# --- what listens, and what is said about it ------------------------------------------------------


def listening(pid: int) -> set[str]:
    """Return where a process listens (TCP and UDP), in the kernel's hexadecimal."""
    links = []
    for fd in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):
            links.append(os.readlink(fd))
    inodes = {link[8:-1] for link in links if link.startswith("socket:[")}
    found = set()
    for table, state in (("tcp", "0A"), ("tcp6", "0A"), ("udp", "07"), ("udp6", "07")):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] in inodes and fields[3] == state:
                found.add(f"{table} {fields[1].split(':')[0]}")
    return found


def test_what_listens_is_said(
    unguarded: RealDaemon, make_puppet: MakePuppet, caplog: pytest.LogCaptureFixture
) -> None:
    assert listening(unguarded.process.pid) == {"tcp 0100007F"}
    assert "warning: no authentication: every program of this machine" in "".join(unguarded.said)
    grabber = make_puppet()
    assert grabber.open(**client(unguarded.endpoint))
    assert listening(grabber.pid) == set()

    before = listening(os.getpid())
    with open_daemon_session(Config(bus=BusSettings(listen=("tcp/0.0.0.0:0",)))):
        assert listening(os.getpid()) - before == {"tcp 00000000"}
    assert "ANYBODY ON THE NETWORK" in caplog.text


# --- and those who belong there -------------------------------------------------------------------


def test_an_authenticated_site_works_as_one_without(keys: Keys, tmp_path: Path) -> None:
    cameras = ("a", "b", "c", "late")
    for camera in cameras:
        keys.authority.issue("camera", camera, 100)
    keys.allow(keys.folder / "daemon" / "access.json")
    config = guarded_config(keys, tmp_path / "state")
    events = walkers(120)
    with contextlib.ExitStack() as stack:
        daemon = stack.enter_context(Daemon(config))

        def joined(own: str) -> Bus:
            bus = keys.bus(own, daemon.endpoint)
            return stack.enter_context(dial(msgspec.structs.replace(config, bus=bus)))

        publishers = {
            camera: stack.enter_context(
                publisher_on(joined(f"camera/{camera}"), tmp_path / camera, [camera])
            )
            for camera in cameras
        }
        reader = joined("reader/wall")
        for event in events:
            publishers[event.camera].publish(event)
        for camera, publisher in publishers.items():
            assert publisher.wait_stored(WAIT_SECONDS), f"{camera} is not stored"
        publishers["late"].publish(closing_event())  # not before: who comes behind it is late
        assert publishers["late"].wait_stored(WAIT_SECONDS)

        subscriber = TopologySubscriber(reader)
        wait_for(lambda: subscriber.update() is not None, "the topology")
        assert daemon.status().events.stored == len(events) + 1
        exit_at = {"x": 0.9, "y": 0.5}
        wait_for(lambda: bool(reader.query("predict/a", exit_at)), "a prediction")
        wait_for(lambda: "status/daemon" in dict(reader.query("status/*")), "the status")


def test_one_certificate_for_the_cameras_of_another_program(
    keys: Keys,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    keys.authority.issue("camera", "nvr", 100, cameras=["door", "yard"])
    keys.allow(keys.folder / "daemon" / "access.json")
    monkeypatch.setattr("camtopod.serve.outbox.delivery.RETRY_SECONDS", 0.1)
    with Daemon(guarded_config(keys, tmp_path / "state")) as daemon:

        def ingest(*cameras: str) -> int:
            lines = [
                json.dumps({"camera": camera, "kind": "entry", "t": T0 + n})
                for n in range(50)
                for camera in cameras
            ]
            path = tmp_path / "events.jsonl"
            path.write_text("\n".join(lines))
            state = str(tmp_path / cameras[0])
            return main(["--config", str(config), "ingest", "jsonl", str(path), "--state", state])

        config = tmp_path / "nvr.toml"
        tls = msgspec.structs.asdict(keys.bus("camera/nvr").tls)
        config.write_text(
            f'[site]\nname = "hq"\n[bus]\nconnect = ["{daemon.endpoint}"]\n[bus.tls]\n'
            + "".join(f'{key} = "{path}"\n' for key, path in tls.items())
        )

        assert ingest("door", "yard") == exits.DONE
        assert daemon.status().events.stored == 100
        assert ingest("hall") == exits.BUS
        assert "camera hall: the daemon is there and does not answer" in capfd.readouterr().err
        assert daemon.status().events.stored == 100
