"""State directory, topology file and grabbers of version 0.1 still work.

``written_by_0_1.zip`` is a state directory that its daemon and its grabber of camera ``a`` left
behind, with one event that was not acknowledged, and the topology they had learned.
"""

from __future__ import annotations

import contextlib
import zipfile
from pathlib import Path

import msgspec
import pytest
from paths import TESTS
from serving import SPAN_SECONDS, T0, closing_event, small_config, wait_for, walkers

from camtopod import codec
from camtopod.cli.main import main
from camtopod.records import Event, Prediction, Topology
from camtopod.serve.bus import session as buses
from camtopod.serve.daemon import Daemon
from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import open_spool

NOW = T0 + 20 * SPAN_SECONDS
VERSION = 4
DIGEST = "sha256:50cbb637ffcba6b60d36268bb337800064d0400bb2251a427a4b7ee40a7107a0"
EVENTS = len(walkers(60)) + 1


@pytest.fixture
def written(tmp_path: Path) -> Path:
    with zipfile.ZipFile(TESTS / "written_by_0_1.zip") as archive:
        archive.extractall(tmp_path)
    return tmp_path


def test_its_state_directory_goes_on(written: Path) -> None:
    config = small_config(written / "state")
    with (
        Daemon(config, clock=lambda: NOW) as daemon,
        buses.dial(small_config(written, daemon.endpoint)) as bus,
    ):
        assert daemon.topology is not None
        assert (daemon.topology.version, daemon.topology.digest) == (VERSION, DIGEST), (
            "answered at once"
        )
        wait_for(lambda: len(bus.query("predict/a", {"zone": "a/1", "t": T0})) == 1, "a prediction")
        assert daemon.status()["learner"]["accepted"] == EVENTS

        with contextlib.closing(open_spool(written / "state", "site", "a", config.limits)) as spool:
            publisher = Publisher(spool, 100)
            assert publisher.unacknowledged == 1, "what was left in its spool"
            publisher.attach(bus)
            assert publisher.wait_acknowledged(20)
        wait_for(lambda: daemon.status()["learner"]["accepted"] == EVENTS + 1, "it to be learned")
        assert daemon.status()["events"]["refilled"] == 0
        epoch = daemon.epoch
        assert epoch == daemon.topology.epoch, "what was learned is gone on with"


def test_its_topology_file_is_predicted_with(
    written: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    events = written / "events.jsonl"
    events.write_bytes(b"".join(codec.to_json(event) + b"\n" for event in walkers(5)))
    assert main(["predict", str(written / "topology.json"), str(events)]) == 0
    predictions = [
        codec.read(Prediction, line) for line in capfd.readouterr().out.encode().splitlines()
    ]
    assert len(predictions) == 10
    assert codec.read(Topology, (written / "topology.json").read_bytes()).digest == DIGEST


class OldAck(msgspec.Struct):
    """An acknowledgement as version 0.1 reads it."""

    camera: str
    boot: str
    seq: int


class OldBatch(msgspec.Struct):
    """An answer of a spool of version 0.1."""

    camera: str
    boot: str
    first: int
    dropped: int
    more: bool
    events: list[tuple[int, bytes]]
    acked: int | None = None


def test_its_grabbers_talk_to_this_daemon(tmp_path: Path) -> None:
    events = [Event("a", "entry", T0 + n, boot="old", seq=n) for n in range(1, 6)]
    spool = {event.seq or 0: codec.to_msgpack(event) for event in events}
    acks: list[OldAck] = []

    def answer(key: str, parameters: dict[str, str]) -> OldBatch:
        start = int(parameters["from"])
        rows = [(seq, raw) for seq, raw in spool.items() if seq >= start]
        return OldBatch("a", "old", 1, 0, False, rows)

    with (
        Daemon(small_config(tmp_path), clock=lambda: NOW) as daemon,
        buses.dial(small_config(tmp_path, daemon.endpoint)) as bus,
    ):
        bus.answer_queries("spool/a", answer, "spool")
        bus.subscribe(
            "ack/a", lambda key, raw: acks.append(msgspec.msgpack.decode(raw, type=OldAck))
        )
        bus.announce("grabber", "a")
        for event in (events[0], events[1], events[4]):  # two are lost on the way
            bus.publish_raw("event/a", spool[event.seq or 0], "event")
        wait_for(lambda: bool(acks) and acks[-1].seq == 5, "all to be stored")
        assert daemon.status()["events"]["stored"] == 5


def test_events_of_before_the_upgrade_count_once(written: Path) -> None:
    with (
        Daemon(small_config(written / "state"), clock=lambda: NOW) as daemon,
        buses.dial(small_config(written, daemon.endpoint)) as bus,
    ):
        first = min(
            (e for e in [*walkers(60), closing_event()] if e.camera == "a"),
            key=lambda event: event.t,
        )
        bus.publish("event/a", msgspec.structs.replace(first, boot="01BOOT", seq=1), "event")
        wait_for(lambda: daemon.status()["events"]["duplicate"] == 1, "the duplicate")
        assert daemon.status()["events"]["contradicted"] == 0
