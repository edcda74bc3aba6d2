"""Intruders against the real daemon, over mutual TLS, each session in a process of its own.

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
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest
from serving import T0, WAIT_SECONDS, camtopod, closing_event, small_config, wait_for, walkers

from camtopod.cli import exits
from camtopod.cli.main import main
from camtopod.config.settings import BusSettings, Config, TlsSettings
from camtopod.keys import rules
from camtopod.keys.authority import Authority
from camtopod.serve.bus.session import BusError, dial, open_daemon_session
from camtopod.serve.bus.topology_subscriber import TopologySubscriber
from camtopod.serve.daemon import Daemon
from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import Spool

HQ = "camtopo/hq"
PUPPET = Path(__file__).parent / "puppet.py"
BIG_BYTES = 2 * 1024 * 1024
GROWTH_BYTES_MAX = 24 * 1024 * 1024


class Puppet:
    """A process on the bus that is controlled by the test; see puppet.py."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, str(PUPPET)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )

    @property
    def pid(self) -> int:
        return self._process.pid

    def open(self, **settings: Any) -> bool:
        """Return True if the session is accepted."""
        return "open" in self._say(settings)

    def do(self, name: str, **arguments: Any) -> Any:
        return self._say([name, arguments])["done"]

    def hears(self, *expected: str) -> None:
        wait_for(
            lambda: set(expected) <= set(self.do("heard")),
            f"{expected}, not only {set(self.do('heard'))}",
        )

    def close(self) -> None:
        self._process.communicate(timeout=WAIT_SECONDS)

    def _say(self, what: Any) -> dict[str, Any]:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(what).encode() + b"\n")
        self._process.stdin.flush()
        answer: dict[str, Any] = json.loads(self._process.stdout.readline())
        return answer


class Keys:
    """A site's authority, and certificates of which some are faulty."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        now = time.time()
        self.authority = Authority.create(folder, "hq", now, 7300, replace=False)
        self.authority.issue("daemon", "daemon", 100)
        for camera in ("cam1", "cam2"):
            self.authority.issue("camera", camera, 100)
        self.authority.issue("reader", "wall", 100)
        self.authority.issue("camera", "gone", 100)
        self.authority.revoke("camera", "gone")
        self.allow(folder / "daemon" / "access.json")
        other = Authority.create(folder / "other", "hq", now, 7300, replace=False)
        other.issue("camera", "cam1", 100)
        Authority.create(folder / "old", "hq", now, 7300, replace=False)
        for name in ("ca.key", "ca.pem"):
            (folder / "old/authority" / name).write_bytes(
                (folder / "authority" / name).read_bytes()
            )
        Authority(folder / "old", now - 50 * 86400.0).issue("camera", "cam1", 20)

    def tls(self, own: str) -> dict[str, Any]:
        """Return zenoh's settings for the certificate in the folder ``own``, with this site's
        authority.
        """
        folder = self.folder / own
        return rules.mutual_tls(
            str(self.folder / "authority" / "ca.pem"),
            str(folder / "certificate.pem"),
            str(folder / "private.key"),
        )

    def bus(
        self, own: str, endpoint: str = "", listen: str = "", patience: float = 3.0
    ) -> BusSettings:
        folder = self.folder / own
        files = [str(folder / name) for name in ("ca.pem", "certificate.pem", "private.key")]
        tls = TlsSettings(*files, access=str(self.folder / "daemon" / "access.json"))
        return BusSettings(
            connect=(endpoint,) if endpoint else (),
            listen=(listen,) if listen else (),
            tls=tls,
            connect_seconds=patience,
        )

    def allow(self, path: Path, everything: str = "") -> Path:
        """Write an access list; the certificate named ``everything`` may do what the daemon may."""
        certificates = [
            msgspec.structs.replace(c, role="daemon") if c.name == everything else c
            for c in self.authority.access.certificates
        ]
        path.write_bytes(msgspec.json.encode(rules.Access("hq", certificates)))
        return path


class RealDaemon:
    """`camtopod run` on a free port; its output is in ``said``."""

    def __init__(self, folder: Path, bus: str) -> None:
        folder.mkdir(exist_ok=True)
        config = folder / "camtopod.toml"
        config.write_text(f'[site]\nname = "hq"\n[limits]\nstatus_seconds = 0.1\n{bus}')
        config.chmod(0o600)
        self.process = camtopod(
            "--config",
            str(config),
            "run",
            "--state",
            str(folder / "state"),
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )
        self.said: list[str] = []
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()
        wait_for(lambda: self._ready() is not None, "the daemon to be ready")
        self.endpoint = str(self._ready())

    def _listen(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.said.append(line.decode())

    def _ready(self) -> str | None:
        found = re.search(r"ready at (\S+)", "".join(self.said))
        return found and found.group(1)

    def stop(self) -> None:
        self.process.terminate()
        self.process.communicate(timeout=WAIT_SECONDS)


def tls_table(keys: Keys, access: Path, listen: str = "tls/127.0.0.1:0") -> str:
    folder = keys.folder / "daemon"
    return (
        f'[bus]\nlisten = ["{listen}"]\n[bus.tls]\nca = "{folder}/ca.pem"\ncertificate = "{folder}/certificate.pem"\n'
        f'private_key = "{folder}/private.key"\naccess = "{access}"\n'
    )


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Keys:
    return Keys(tmp_path_factory.mktemp("keys"))


@pytest.fixture(scope="module")
def guarded(keys: Keys, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RealDaemon]:
    """Run a daemon with the access rules."""
    daemon = RealDaemon(
        tmp_path_factory.mktemp("d") / "d", tls_table(keys, keys.folder / "daemon" / "access.json")
    )
    yield daemon
    daemon.stop()


@pytest.fixture(scope="module")
def unguarded(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RealDaemon]:
    """Run a daemon without authentication, for this machine only."""
    daemon = RealDaemon(tmp_path_factory.mktemp("u") / "d", '[bus]\nlisten = ["tcp/127.0.0.1:0"]\n')
    yield daemon
    daemon.stop()


@pytest.fixture
def cleanup() -> Iterator[contextlib.ExitStack]:
    with contextlib.ExitStack() as stack:
        yield stack


def puppet(cleanup: contextlib.ExitStack) -> Puppet:
    one = Puppet()
    cleanup.callback(one.close)
    return one


def client(endpoint: str, mode: str = "client") -> dict[str, Any]:
    return rules.session_settings(mode) | {
        "connect/endpoints": [endpoint],
        "listen/endpoints": [],
        "connect/timeout_ms": 500,
        "connect/exit_on_failure": True,
    }


def status(observer: Puppet) -> dict[str, Any]:
    """Return the daemon's status, asking again if the answer is late."""
    answers: list[str] = []

    def answered() -> bool:
        answers[:] = [
            one
            for one in observer.do("ask", key=f"{HQ}/status/daemon?format=application/json")
            if "{" in one
        ]
        return bool(answers)

    wait_for(answered, "the daemon's status")
    found: dict[str, Any] = json.loads(answers[0])
    return found


# --- a stolen box
# -----------------------------------------------------------------------------------

OWN = {f"put {HQ}/event/cam1", f"put {HQ}/status/cam1", f"put {HQ}/alive/grabber/cam1"}
STOLEN = [
    ("put", f"{HQ}/event/cam2"),
    ("put", f"{HQ}/event/*"),
    ("put", f"{HQ}/event/cam1/x"),
    ("put", f"{HQ}/topology"),
    ("put", f"{HQ}/topology/delta"),
    ("put", f"{HQ}/prediction/cam1"),
    ("put", f"{HQ}/ack/cam1"),
    ("put", f"{HQ}/ack/cam2"),
    ("put", f"{HQ}/status/cam2"),
    ("delete", f"{HQ}/event/cam1"),
    ("delete", f"{HQ}/topology"),
]


def attack(
    thief: Puppet, observer: Puppet, hears: tuple[str, ...] = ("ack/cam1",), seconds: float = 0.5
) -> set[str]:
    """Try everything a stolen box of cam1 might try; return the attempts that had an effect.

    hears: message to wait for.
    seconds: timeout of answers, which a query that is not allowed waits out.
    """
    observer.do("subscribe", key=f"{HQ}/**")
    observer.do("watch", key=f"{HQ}/alive/**")
    observer.do("answer", key=f"{HQ}/spool/cam2", payload="the real one")
    observer.do("appear", key=f"{HQ}/alive/grabber/cam3")
    wait_for(
        lambda: reaches(thief, observer, f"{HQ}/event/cam1"), "a way from the thief to the observer"
    )
    for what, key in STOLEN:
        thief.do(what, key=key)
    for camera in ("cam2", "cam1"):
        thief.do("appear", key=f"{HQ}/alive/grabber/{camera}")
        thief.do("answer", key=f"{HQ}/spool/{camera}", payload="from the thief")
    thief.do("answer", key=f"{HQ}/topology", payload="from the thief")
    for key in ("ack/cam1", "ack/cam2", "event/*", "prediction/*", "topology/delta", "status/*"):
        thief.do("subscribe", key=f"{HQ}/{key}")
    thief.do("watch", key=f"{HQ}/alive/*/cam3")
    thief.do("put", key=f"{HQ}/status/cam1")  # the last, so that all before it has been dealt with
    observer.hears(*OWN)
    effects = set()
    for key in (
        "ack/cam2",
        "event/cam2",
        "prediction/cam2",
        "topology/delta",
        "status/cam2",
        "ack/cam1",
    ):
        observer.do("put", key=f"{HQ}/{key}", payload="y")
    thief.hears(*(f"put {HQ}/{key}" for key in hears))
    wait_for(
        lambda: "from the thief" in observer.do("ask", key=f"{HQ}/spool/cam1"), "its own spool"
    )
    for key in ("spool/cam2", "topology"):
        if thief_answers(observer, key, seconds):
            effects.add(f"answered {key}")
    for key in ("topology", "predict/cam1?zone=cam1/1", "status/daemon", "spool/cam2", "**"):
        if thief.do("ask", key=f"{HQ}/{key}", seconds=seconds):
            effects.add(f"asked {key}")
    # what was heard is looked at last: it comes in another order than it was sent in
    effects |= {line for line in observer.do("heard") if not re.search("daemon|cam3", line)}
    effects |= {f"thief heard {line}" for line in thief.do("heard") if "grabber/cam1" not in line}
    return effects


def thief_answers(observer: Puppet, key: str, seconds: float) -> bool:
    """Return True if the observer gets the thief's answer within ``seconds``.

    It is asked again, as the thief's offers to answer arrive one by one, in any order.
    """
    deadline = time.monotonic() + seconds
    while "from the thief" not in observer.do("ask", key=f"{HQ}/{key}", seconds=seconds):
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
def test_a_stolen_box_can_publish_its_own_events_and_nothing_else(
    mode: str, keys: Keys, guarded: RealDaemon, cleanup: contextlib.ExitStack
) -> None:
    thief, observer = puppet(cleanup), puppet(cleanup)
    assert thief.open(**client(guarded.endpoint, mode), **keys.tls("camera/cam1"))
    assert observer.open(**client(guarded.endpoint), **keys.tls("daemon"))
    effects = attack(thief, observer)
    assert effects == OWN | {f"thief heard put {HQ}/ack/cam1"}


def test_a_stolen_box_that_poses_as_a_router_gains_and_breaks_nothing(
    keys: Keys, guarded: RealDaemon, cleanup: contextlib.ExitStack
) -> None:
    thief, observer, other = puppet(cleanup), puppet(cleanup), puppet(cleanup)
    assert observer.open(**client(guarded.endpoint), **keys.tls("daemon"))
    observer.do("subscribe", key=f"{HQ}/**")
    observer.do("watch", key=f"{HQ}/alive/grabber/*")
    assert thief.open(**client(guarded.endpoint, "router"), **keys.tls("camera/cam1"))
    for what, key in STOLEN:
        thief.do(what, key=key)
    for key in ("topology", "spool/cam2", "**"):
        thief.do("answer", key=f"{HQ}/{key}", payload="from the thief")
    for key in ("event/*", "prediction/*", "**"):
        thief.do("subscribe", key=f"{HQ}/{key}")
    for camera in ("cam2", "cam1"):
        thief.do("appear", key=f"{HQ}/alive/grabber/{camera}")
    observer.hears(f"put {HQ}/alive/grabber/cam1")
    assert other.open(**client(guarded.endpoint), **keys.tls("camera/cam2"))
    other.do("answer", key=f"{HQ}/spool/cam2", payload="the real one")
    other.do("put", key=f"{HQ}/event/cam2")
    observer.hears(f"put {HQ}/event/cam2")
    heard = [line for line in observer.do("heard") if "daemon" not in line]
    assert sorted(heard) == [f"put {HQ}/alive/grabber/cam1", f"put {HQ}/event/cam2"]
    wait_for(
        lambda: observer.do("ask", key=f"{HQ}/spool/cam2") == ["the real one"],
        "the other camera's spool",
    )
    answers = observer.do("ask", key=f"{HQ}/topology")
    assert set(answers) - {"Timeout"} == {"nothing has been learned yet"}, (
        "the thief's answer is waited for at most"
    )
    observer.do("put", key=f"{HQ}/prediction/cam2")
    assert thief.do("ask", key=f"{HQ}/status/daemon") == []
    assert thief.do("heard") == []


def test_the_file_for_a_router_of_its_own_enforces_the_same(
    keys: Keys, cleanup: contextlib.ExitStack
) -> None:
    with open_daemon_session(Config(bus=BusSettings(listen=("tcp/127.0.0.1:0",)))) as bus:
        endpoint = bus.endpoint.replace("tcp/", "tls/")  # free again in a moment
    folder = keys.folder / "daemon"
    access = rules.read_access((folder / "access.json").read_bytes())
    (folder / "router.json5").write_text(rules.router_json5(access, [endpoint], 1 << 24, 1000))
    start = "import sys, zenoh; s = zenoh.open(zenoh.Config.from_file('router.json5')); print(1, flush=True); "
    router = subprocess.Popen(
        [sys.executable, "-c", start + "sys.stdin.read(); s.close()"],
        cwd=folder,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    cleanup.callback(router.communicate, timeout=WAIT_SECONDS)
    assert router.stdout is not None
    assert router.stdout.readline() == b"1\n"
    thief, observer = puppet(cleanup), puppet(cleanup)
    assert thief.open(**client(endpoint), **keys.tls("camera/cam1"))
    assert observer.open(**client(endpoint), **keys.tls("daemon"))
    assert attack(thief, observer) == OWN | {f"thief heard put {HQ}/ack/cam1"}
    assert not puppet(cleanup).open(**client(endpoint), **keys.tls("other/camera/cam1"))


def test_the_same_box_allowed_everything_does_all_of_it(
    keys: Keys, tmp_path: Path, cleanup: contextlib.ExitStack
) -> None:
    daemon = RealDaemon(
        tmp_path / "d", tls_table(keys, keys.allow(tmp_path / "access.json", everything="cam1"))
    )
    cleanup.callback(daemon.stop)
    thief, observer = puppet(cleanup), puppet(cleanup)
    assert thief.open(**client(daemon.endpoint), **keys.tls("camera/cam1"))
    assert observer.open(**client(daemon.endpoint), **keys.tls("daemon"))
    hears = ("ack/cam1", "ack/cam2", "event/cam2", "alive/grabber/cam3")
    effects = attack(thief, observer, hears, seconds=WAIT_SECONDS)
    assert effects >= OWN
    assert effects >= {
        f"{what} {key}" for what, key in STOLEN if HQ in key and not re.search(r"daemon|\*", key)
    }
    assert effects >= {f"put {HQ}/alive/grabber/cam2", "answered spool/cam2", "answered topology"}
    assert effects >= {f"thief heard put {HQ}/{key}" for key in hears}
    assert effects >= {f"asked {key}" for key in ("topology", "status/daemon", "spool/cam2")}


def test_a_reader_reads_and_nothing_else(
    keys: Keys, guarded: RealDaemon, cleanup: contextlib.ExitStack
) -> None:
    reader, observer = puppet(cleanup), puppet(cleanup)
    assert reader.open(**client(guarded.endpoint), **keys.tls("reader/wall"))
    assert observer.open(**client(guarded.endpoint), **keys.tls("daemon"))
    readable = ("topology", "topology/delta", "prediction/cam1", "status/cam1")
    observer.do("subscribe", key=f"{HQ}/**")
    for key in (
        "topology",
        "topology/delta",
        "prediction/*",
        "status/*",
        "event/*",
        "ack/*",
        "spool/*",
        "**",
    ):
        reader.do("subscribe", key=f"{HQ}/{key}")
    reader.do("watch", key=f"{HQ}/alive/daemon/*")
    assert reader.do("ask", key=f"{HQ}/status/daemon?format=application/json")
    nothing = [
        "nothing has been learned yet"
    ]  # on a busy machine a question may end late, which is an answer, too
    wait_for(
        lambda: reader.do("ask", key=f"{HQ}/topology") == nothing,
        "the answer about the topology alone",
    )
    prediction = f"{HQ}/predict/cam1?zone=cam1/1"
    wait_for(
        lambda: reader.do("ask", key=prediction) == nothing, "the answer about a prediction alone"
    )
    assert reader.do("ask", key=f"{HQ}/spool/cam1") == []
    for key in (*readable, "event/cam1", "ack/cam1"):
        reader.do("put", key=f"{HQ}/{key}", payload="from the reader")
        reader.do("delete", key=f"{HQ}/{key}")
        observer.do("put", key=f"{HQ}/{key}")
    reader.hears(*(f"put {HQ}/{key}" for key in readable))
    wait_for(
        lambda: any("alive/daemon/" in line for line in reader.do("heard")), "the daemon to be seen"
    )
    heard = {line for line in reader.do("heard") if "daemon" not in line}
    assert heard == {f"put {HQ}/{key}" for key in readable}
    assert reader.do("ask", key=f"{HQ}/status/daemon"), (
        "and with it what was put before has been dealt with"
    )
    assert [line for line in observer.do("heard") if "daemon" not in line] == [], "from the reader"


def test_a_box_whose_certificate_was_withdrawn_has_no_rights(
    keys: Keys, guarded: RealDaemon, cleanup: contextlib.ExitStack
) -> None:
    thief, observer = puppet(cleanup), puppet(cleanup)
    assert observer.open(**client(guarded.endpoint), **keys.tls("daemon"))
    assert thief.open(**client(guarded.endpoint), **keys.tls("camera/gone")), (
        "it is still the authority's"
    )
    observer.do("subscribe", key=f"{HQ}/event/*")
    thief.do("put", key=f"{HQ}/event/gone")
    assert (
        thief.do("ask", key=f"{HQ}/status/daemon") == []
    )  # and with it the put has been dealt with
    assert observer.do("heard") == []
    wait_for(
        lambda: any(
            "'gone' from" in line and "can do nothing here" in line for line in guarded.said
        ),
        "it to be said",
    )


# --- at the door
# ------------------------------------------------------------------------------------


def test_who_is_not_let_in(keys: Keys, guarded: RealDaemon, cleanup: contextlib.ExitStack) -> None:
    observer, intruder = puppet(cleanup), puppet(cleanup)
    assert observer.open(**client(guarded.endpoint), **keys.tls("daemon"))
    good = client(guarded.endpoint) | keys.tls("camera/cam1")
    own = "transport/link/tls/connect_"
    nothing = {
        f"{own}certificate": None,
        f"{own}private_key": None,
        "transport/link/tls/enable_mtls": False,
    }
    plain = {
        "connect/endpoints": [guarded.endpoint.replace("tls/", "tcp/")],
        "transport/link/protocols": ["tcp"],
    }
    for reason, wrong in (
        ("no-certificate", nothing),
        ("wrong-authority", _own(keys.tls("other/camera/cam1"))),
        ("expired", _own(keys.tls("old/camera/cam1"))),
        ("not-tls", plain),
    ):
        assert not intruder.open(**good | wrong), reason
    assert intruder.open(**good), "the control: the same with a good certificate"


def _own(tls: dict[str, Any]) -> dict[str, Any]:
    """Return a folder with certificate and key only; the authority stays the site's."""
    return {key: value for key, value in tls.items() if "root_ca" not in key}


def test_a_stolen_box_cannot_pass_for_the_daemon(keys: Keys, cleanup: contextlib.ExitStack) -> None:
    """A listener at the daemon's address has to present the daemon's certificate."""
    for own, accepted in (("camera/cam2", False), ("daemon", True)):
        listening = Config(bus=keys.bus(own, listen="tls/127.0.0.1:0"))
        listening = msgspec.structs.replace(
            listening, site=msgspec.structs.replace(listening.site, name="hq")
        )
        with open_daemon_session(listening) as false_daemon:
            config = msgspec.structs.replace(
                listening, bus=keys.bus("camera/cam1", false_daemon.endpoint, patience=0.5)
            )
            if accepted:
                dial(config).close()
            else:
                with pytest.raises(BusError, match="does it accept this certificate"):
                    dial(config)


# --- too large
# --------------------------------------------------------------------------------------


def memory(pid: int) -> int:
    """Return the resident bytes."""
    found = re.search(r"VmRSS:\s+(\d+) kB", Path(f"/proc/{pid}/status").read_text())
    assert found is not None
    return 1024 * int(found.group(1))


def test_what_is_too_large_neither_arrives_nor_takes_memory(
    unguarded: RealDaemon, cleanup: contextlib.ExitStack
) -> None:
    flooder, observer = puppet(cleanup), puppet(cleanup)
    assert flooder.open(**client(unguarded.endpoint))
    assert observer.open(**client(unguarded.endpoint))
    event = f"{HQ}/event/cam1"
    flooder.do("put", key=event)
    wait_for(lambda: status(observer)["events"]["received"] == 1, "the daemon to receive")
    before = memory(unguarded.process.pid)
    for size, count in ((BIG_BYTES, 40), (rules.EVENT_BYTES_MAX + 1, 200)):
        flooder.do("put", key=event, payload="x", repeat=size, count=count)
    flooder.do("put", key=event, payload='{"camera":"cam1","kind":"entry","t":1}')
    wait_for(lambda: status(observer)["events"]["received"] >= 2, "the one that fits")
    assert status(observer)["events"]["received"] == 2
    assert memory(unguarded.process.pid) - before < GROWTH_BYTES_MAX
    flooder.do("put", key=event, payload="x", repeat=rules.EVENT_BYTES_MAX)
    wait_for(
        lambda: status(observer)["rejects"].get("too-long") == 1,
        "what the bus lets pass to be counted",
    )


def test_no_message_of_any_kind_may_be_that_large(
    unguarded: RealDaemon, cleanup: contextlib.ExitStack
) -> None:
    """The filter limits events; this limits the messages that the daemon reassembles."""
    flooder, observer = puppet(cleanup), puppet(cleanup)
    assert observer.open(**client(unguarded.endpoint))
    assert flooder.open(**client(unguarded.endpoint))
    observer.do("subscribe", key=f"{HQ}/any/*")
    flooder.do("put", key=f"{HQ}/any/large", repeat=BIG_BYTES)
    flooder.do("put", key=f"{HQ}/any/fits", repeat=BIG_BYTES // 2)
    observer.hears(f"put {HQ}/any/fits")
    assert observer.do("heard") == [f"put {HQ}/any/fits"]


def test_without_limits_the_same_arrives(cleanup: contextlib.ExitStack) -> None:
    with open_daemon_session(Config(bus=BusSettings(listen=("tcp/127.0.0.1:0",)))) as bus:
        endpoint = bus.endpoint  # free again in a moment
    unlimited, flooder = puppet(cleanup), puppet(cleanup)
    assert unlimited.open(
        **rules.session_settings("router"),
        **{"listen/endpoints": [endpoint], "connect/endpoints": []},
    )
    unlimited.do("subscribe", key="**")
    assert flooder.open(**client(endpoint))
    flooder.do("put", key=f"{HQ}/event/cam1", repeat=BIG_BYTES)
    unlimited.hears(f"put {HQ}/event/cam1")


@pytest.mark.parametrize("own", ["camera/cam1", "reader/wall"])
def test_only_the_daemons_certificate_gives_commands(
    own: str, keys: Keys, guarded: RealDaemon, cleanup: contextlib.ExitStack
) -> None:
    stranger, observer = puppet(cleanup), puppet(cleanup)
    assert stranger.open(**client(guarded.endpoint), **keys.tls(own))
    assert observer.open(**client(guarded.endpoint), **keys.tls("daemon"))
    ask = f"{HQ}/admin/forget?camera=nobody"
    wait_for(
        lambda: any("there is no camera nobody" in one for one in observer.do("ask", key=ask)),
        "the answer to the daemon's certificate",
    )
    for key in (ask, f"{HQ}/admin/reset", f"{HQ}/admin/*", f"{HQ}/**"):
        stranger.do("ask", key=key, seconds=0.5)
    answers = [stranger.do("ask", key=key, seconds=0.5) for key in (ask, f"{HQ}/admin/reset")]
    assert answers == [[], []]
    assert status(observer)["names"]["reset"] is None


# --- what listens, and what is said about it
# --------------------------------------------------------


def listening(pid: int) -> set[str]:
    """Return the addresses, in the kernel's hexadecimal, on which a process listens
    (TCP and UDP).
    """
    links = []
    for fd in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):
            links.append(os.readlink(fd))
    inodes = {link[8:-1] for link in links if link.startswith("socket:[")}
    found = set()
    for table, states in (("tcp", ("0A",)), ("tcp6", ("0A",)), ("udp", ("07",)), ("udp6", ("07",))):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[9] in inodes and fields[3] in states:
                found.add(f"{table} {fields[1].split(':')[0]}")
    return found


def test_nothing_listens_beyond_loopback_and_what_is_open_is_said(
    unguarded: RealDaemon, cleanup: contextlib.ExitStack
) -> None:
    assert listening(unguarded.process.pid) == {"tcp 0100007F"}
    assert "warning: no authentication: every program of this machine" in "".join(unguarded.said)
    grabber = puppet(cleanup)
    assert grabber.open(**client(unguarded.endpoint))
    assert listening(grabber.pid) == set()


def test_what_listens_beyond_loopback_is_seen_and_said_loudly(
    caplog: pytest.LogCaptureFixture,
) -> None:
    before = listening(os.getpid())
    with open_daemon_session(Config(bus=BusSettings(listen=("tcp/0.0.0.0:0",)))):
        assert listening(os.getpid()) - before == {"tcp 00000000"}
    assert "ANYBODY ON THE NETWORK" in caplog.text


# --- and those who belong there
# ---------------------------------------------------------------------


def test_an_authenticated_site_works_as_one_without(
    keys: Keys, tmp_path: Path, cleanup: contextlib.ExitStack
) -> None:
    authority = keys.authority
    for camera in ("a", "b", "c", "late"):
        if not (keys.folder / "camera" / camera).exists():
            authority.issue("camera", camera, 100)
    keys.allow(keys.folder / "daemon" / "access.json")
    plain = small_config(tmp_path / "state")
    plain = msgspec.structs.replace(plain, site=msgspec.structs.replace(plain.site, name="hq"))
    daemon = Daemon(
        msgspec.structs.replace(plain, bus=keys.bus("daemon", listen="tls/127.0.0.1:0"))
    )
    events = walkers(120)
    spools = {}
    for camera in ("a", "b", "c", "late"):
        spool = spools[camera] = Spool(tmp_path / f"{camera}.db", f"boot-{camera}", 100_000)
        cleanup.callback(spool.close)
    publishers = {camera: Publisher(spool) for camera, spool in spools.items()}
    for event in events[:100]:
        publishers[event.camera].publish(event)  # before there is a bus: these have to be pulled
    daemon.start()
    cleanup.callback(daemon.stop)
    for camera, publisher in publishers.items():
        bus = dial(
            msgspec.structs.replace(plain, bus=keys.bus(f"camera/{camera}", daemon.endpoint))
        )
        cleanup.callback(bus.close)
        publisher.attach(bus, [camera])
    for event in events[100:]:
        publishers[event.camera].publish(event)
    reader = dial(msgspec.structs.replace(plain, bus=keys.bus("reader/wall", daemon.endpoint)))
    cleanup.callback(reader.close)
    for camera, publisher in publishers.items():
        assert publisher.wait_stored(WAIT_SECONDS), f"{camera} is not acknowledged"
    publishers["late"].publish(closing_event())  # not before: who comes behind it is late
    assert publishers["late"].wait_stored(WAIT_SECONDS)
    view = TopologySubscriber(reader)
    assert view.wait_for(1, WAIT_SECONDS) is not None
    assert daemon.status().events["stored"] == len(events) + 1
    exit_at = {"x": 0.9, "y": 0.5}
    wait_for(
        lambda: [key for key, _ in reader.query("predict/a", exit_at)] == ["predict/a"],
        "a prediction",
    )
    wait_for(
        lambda: "status/daemon" in [key for key, _ in reader.query("status/*")],
        "the daemon's status",
    )


def test_one_certificate_for_the_cameras_of_another_program(
    keys: Keys, tmp_path: Path, cleanup: contextlib.ExitStack, monkeypatch: pytest.MonkeyPatch
) -> None:
    keys.authority.issue("camera", "nvr", 100, cameras=["door", "yard"])
    keys.allow(keys.folder / "daemon" / "access.json")
    plain = small_config(tmp_path / "state")
    plain = msgspec.structs.replace(plain, site=msgspec.structs.replace(plain.site, name="hq"))
    daemon = Daemon(
        msgspec.structs.replace(plain, bus=keys.bus("daemon", listen="tls/127.0.0.1:0"))
    )
    daemon.start()
    cleanup.callback(daemon.stop)
    config = tmp_path / "nvr.toml"
    tls = msgspec.structs.asdict(keys.bus("camera/nvr").tls)
    config.write_text(
        f'[site]\nname = "hq"\n[bus]\nconnect = ["{daemon.endpoint}"]\n[bus.tls]\n'
        + "".join(f'{key} = "{path}"\n' for key, path in tls.items())
    )

    def ingest(*cameras: str) -> int:
        lines = [
            {"camera": camera, "kind": "entry", "t": T0 + n}
            for n in range(50)
            for camera in cameras
        ]
        path = tmp_path / "events.jsonl"
        path.write_text("".join(json.dumps(line) + "\n" for line in lines))
        return main(
            [
                "--config",
                str(config),
                "ingest",
                "jsonl",
                str(path),
                "--state",
                str(tmp_path / cameras[0]),
            ]
        )

    assert ingest("door", "yard") == exits.DONE
    assert daemon.status().events["stored"] == 100
    monkeypatch.setattr("camtopod.cli.commands.ingest.PATIENCE_SECONDS", 1.0)
    assert ingest("hall") == exits.BUS
    assert daemon.status().events["stored"] == 100
