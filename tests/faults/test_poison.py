"""Arbitrary bytes on any key are counted by reason and sampled, and change nothing else."""

from __future__ import annotations

import random
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest
import serving
from mutants import answers, mutant, requests, seeds
from serving import T0, all_out, closing_event, numbered, small_config, wait_for, walkers
from sizes import size

from camtopod import codec
from camtopod.codec import (
    EVENT_BYTES_MAX,
    T_MAX,
    T_MIN,
    Rejected,
    event_from_bytes as decode,
    to_msgpack,
)
from camtopod.records import Event
from camtopod.serve.bus.session import QueryError, dial, open_daemon_session
from camtopod.serve.daemon import Daemon
from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.requests import Answer, Batch, read_request

NOW = T0 + 20 * serving.SPAN_SECONDS


# --- the decoder ----------------------------------------------------------------------------------


def fuzz(count: int, seed: int) -> Counter[str]:
    """Decode ``count`` damaged messages; accepted ones must be valid. Returns the
    counts by reason.
    """
    chance, good = random.Random(seed), seeds("lobby")
    outcome: Counter[str] = Counter()
    for _ in range(count):
        raw = mutant(chance, good)
        try:
            event = decode(raw)
        except Rejected as error:
            outcome[error.reason] += 1
            continue
        outcome["taken"] += 1
        assert len(raw) <= EVENT_BYTES_MAX
        assert T_MIN <= event.t < T_MAX
        assert (event.x is None) == (event.y is None)
        assert event.x is None or event.y is None or (0 <= event.x <= 1 and 0 <= event.y <= 1)
        assert event.track is None or (isinstance(event.track, str) and len(event.track) <= 128)
        assert event.boot is None or len(event.boot) <= 64
        assert event.seq is None or 0 <= event.seq < 2**63
        assert event.clock_sd is None or 0 <= event.clock_sd <= 1e6
        assert decode(to_msgpack(event)) == event
    return outcome


def test_damaged_messages_are_events_or_rejected() -> None:
    reasons = {"taken", "malformed", "bad-value", "not-utf8", "half-position"}
    assert reasons <= set(fuzz(8_000, 1))


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_very_many_damaged_messages() -> None:
    count = size("DECODED", 500_000)
    outcome = fuzz(count, size("SEED", 2))
    assert outcome.total() == count
    print(f"{count} decoded: {dict(outcome)}")


def test_the_fuzzer_finds_what_a_plain_decoder_lets_through() -> None:
    """Check of the harness: plain msgspec raises other errors as well."""
    chance, good = random.Random(1), seeds("lobby")
    plain = msgspec.msgpack.Decoder(Event)

    def decode_many() -> None:
        for _ in range(20_000):
            with suppress(msgspec.MsgspecError):
                plain.decode(mutant(chance, good))

    with pytest.raises(UnicodeDecodeError):
        decode_many()


# --- real sessions --------------------------------------------------------------------------------


class Poisoner:
    """A daemon that has learned, and a client that sends damaged messages on every key."""

    def __init__(self, directory: Path, stack: ExitStack) -> None:
        self.daemon = stack.enter_context(
            Daemon(small_config(directory / "state"), clock=lambda: NOW)
        )
        self.bus = stack.enter_context(dial(small_config(directory, self.daemon.endpoint)))
        events = [
            *numbered(walkers(40)),
            *(msgspec.structs.replace(closing_event(), camera=c) for c in "de"),
        ]
        for event in events:
            self.bus.publish(f"event/{event.camera}", event, "event")
        wait_for(lambda: self.state()["stored"] == len(events), "the good events")
        wait_for(lambda: all_out(self.daemon, len(events)), "its versions")

    def state(self) -> dict[str, Any]:
        """Return the state that damaged messages must not change."""
        status = self.daemon.status()
        names = ("stored", "future", "flood", "lost", "waiting")
        topology = self.daemon.topology
        return {
            "version": status.version,
            "digest": topology and topology.digest,
            "state": status.state,
            "journal": status.journal.entries,
            **{name: status.events[name] for name in names},
        }

    def events(self, count: int, chance: random.Random) -> None:
        """Publish damaged messages that are no events."""
        sent = 0
        while sent < count:
            camera = chance.choice("abcxyz")
            raw = mutant(chance, seeds(camera))
            with suppress(Rejected):
                if decode(raw).camera == camera:
                    continue
            self.bus.publish_raw(f"event/{camera}", raw, "event")
            sent += 1

    def requests(self, count: int, chance: random.Random) -> list[bytes | None]:
        """Send damaged requests; return the answers, which come in time."""
        replies: list[bytes | None] = []
        sent = 0
        while sent < count:
            camera = chance.choice(("a", "x", "1", "a=b", "%", "ü", "x" * 200))
            raw = mutant(chance, requests(camera))
            with suppress(Rejected):
                read_request(raw)
                continue
            self.bus.ask(f"store/{camera}", raw, 30.0, replies.append)
            sent += 1
        wait_for(lambda: len(replies) == count, "an answer to each")
        return replies

    def questions(self, count: int, chance: random.Random) -> None:
        """Send queries with invalid parameters."""
        values = [
            "",
            "nan",
            "inf",
            "-1",
            "1e999",
            "9" * 400,
            "ü",
            "a/1",
            "\x00",
            "None",
            "0x1",
            "½",
        ]
        names = ["x", "y", "t", "zone", "format", "version", "camera", "from", "to", "ü", ""]
        keys = [
            "predict/a",
            "predict/nobody",
            "topology",
            "status/daemon",
            "store/a",
            "admin/forget",
            "admin/rename",
            "admin/nonsense",
        ]
        for _ in range(count):
            given = {name: chance.choice(values) for name in chance.sample(names, 3)}
            with suppress(QueryError):
                self.bus.query(chance.choice(keys), given, seconds=5.0)


def poison(directory: Path, count: int, seed: int) -> None:
    """Send ``count`` damaged messages of each kind, and some queries; nothing may have changed."""
    chance = random.Random(seed)
    with ExitStack() as stack:
        one = Poisoner(directory, stack)
        before = one.state()
        one.events(count, chance)
        replies = one.requests(count, chance)
        for name in ("a b", "ü", "x" * 500, "%", "a=b", "lobby;drop", "'"):
            one.bus.announce("grabber", name)
        one.questions(count // 10, chance)

        reasons = Counter(codec.read(Answer, reply or b"", pack=True).reason for reply in replies)
        assert reasons == {"malformed": count}
        wait_for(lambda: sum(one.daemon.status().rejects.values()) >= 2 * count, "all of it")
        assert one.state() == before
        assert before["state"] == "running"
        samples = one.daemon.status().reject_samples
        assert all(1 <= len(kept) <= 3 for kept in samples.values())
        print(one.daemon.status().rejects)

        good = Event("a", "exit", T0 + 11 * serving.SPAN_SECONDS, 0.9, 0.5)
        one.bus.publish("event/a", good, "event")
        wait_for(lambda: one.state()["stored"] == before["stored"] + 1, "the next good event")


def test_poison_on_every_key_changes_nothing(tmp_path: Path) -> None:
    poison(tmp_path, 300, 1)


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_much_poison_on_every_key(tmp_path: Path) -> None:
    poison(tmp_path, size("POISON", 10_000), size("SEED", 2))


@pytest.fixture
def publisher(tmp_path: Path) -> Iterator[Publisher]:
    """Return a publisher that is not attached, of a spool with a hundred events."""
    spool = Spool(tmp_path / "spool.db", "b1", 1_000)
    one = Publisher(spool)
    one.publish(*(Event("lobby", "entry", T0 + n) for n in range(100)))
    yield one
    one.close()
    spool.close()


def test_a_grabber_believes_no_damaged_answer(publisher: Publisher, tmp_path: Path) -> None:
    chance = random.Random(1)
    may_answer = threading.Event()

    def damaged() -> bytes:
        while True:
            raw = mutant(chance, answers())
            try:
                codec.read(Answer, raw, pack=True)
            except Rejected:
                return raw

    def answer(key: str, content: bytes, reply: Any) -> None:
        if not may_answer.is_set():
            reply(damaged())
        elif isinstance(request := read_request(content), Batch):
            reply(to_msgpack(Answer({request.boot: request.events[-1][0]}, 40)))
        else:
            reply(to_msgpack(Answer({"b1": 0}, 40)))

    with open_daemon_session(small_config(tmp_path)) as bus:
        bus.answer_requests("store/*", answer)
        publisher.attach(bus, ["lobby"])
        for number in range(1, 51):
            bus.announce("daemon", f"d{number}")  # so that it asks again at once
            wait_for(lambda n=number: publisher.rejects.counts.total() >= n, "it")  # type: ignore[misc]
        assert publisher.waiting == 100
        may_answer.set()
        bus.announce("daemon", "the last")
        wait_for(lambda: publisher.waiting == 0, "the good answers")
        publisher.close()
