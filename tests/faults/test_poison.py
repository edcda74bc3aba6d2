"""Arbitrary bytes on any key are counted by reason and sampled, and change nothing else."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest
import serving
from mutants import mutant, seeds
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
from camtopod.config.settings import SiteSettings
from camtopod.records import Ack, Event
from camtopod.serve.bus import session as buses
from camtopod.serve.bus.session import Bus, QueryError
from camtopod.serve.daemon import Daemon
from camtopod.serve.outbox.publisher import Publisher
from camtopod.serve.outbox.spool import Spool, SpoolBatch

NOW = T0 + 20 * serving.SPAN_SECONDS


# --- the decoder
# -----------------------------------------------------------------------------------


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
    outcome = fuzz(20_000, 1)
    assert {"taken", "malformed", "bad-value", "not-utf8", "too-long", "half-position"} <= set(
        outcome
    )


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_very_many_damaged_messages() -> None:
    count = size("DECODED", 1_000_000)
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


# --- a real session
# ---------------------------------------------------------------------------------


class Poisoner:
    """A daemon that has learned, and a client that publishes damaged messages on every key."""

    def __init__(self, directory: Path, stack: ExitStack) -> None:
        self.daemon = Daemon(
            small_config(directory / "state", pull_seconds=0.05), clock=lambda: NOW
        )
        self.daemon.start()
        stack.callback(self.daemon.stop)
        config = small_config(directory, self.daemon.endpoint)
        self.bus = self._dial(stack, config)
        events = [
            *numbered(walkers(40)),
            *(msgspec.structs.replace(closing_event(), camera=c) for c in "de"),
        ]
        for event in events:
            self.bus.publish(f"event/{event.camera}", event, "event")
        wait_for(lambda: self.state()["stored"] == len(events), "the good events")
        wait_for(lambda: all_out(self.daemon, len(events)), "its versions")
        assert self.daemon.topology is not None
        elsewhere = msgspec.structs.replace(config, site=SiteSettings("elsewhere"))
        self.spool = Spool(directory / "spool.db", "b1", 1000)
        stack.callback(self.spool.close)
        self.publisher = Publisher(self.spool)
        self.publisher.attach(
            self._dial(stack, elsewhere)
        )  # a site without a daemon: nobody acknowledges
        self.publisher.publish(*(Event("lobby", "entry", T0 + n) for n in range(100)))
        self.elsewhere = self._dial(stack, elsewhere)
        self.answers = 0

    def state(self) -> dict[str, Any]:
        """The state that damaged messages must not change."""
        status = self.daemon.status()
        events = status["events"]
        digest = None if self.daemon.topology is None else self.daemon.topology.digest
        names = ("stored", "future", "flood", "lost", "waiting")
        return {
            "version": status["version"],
            "digest": digest,
            "state": status["state"],
            "journal": status["journal"]["entries"],
            **{name: events[name] for name in names},
        }

    def events(self, count: int, chance: random.Random) -> int:
        """Publish damaged messages that are no events; return their number."""
        sent = 0
        while sent < count:
            camera = chance.choice("abcxyz")
            raw = mutant(chance, seeds(camera))
            try:
                if decode(raw).camera == camera:
                    continue
            except Rejected:
                pass
            self.bus.publish_raw(f"event/{camera}", raw, "event")
            sent += 1
        return sent

    def acks(self, count: int, chance: random.Random) -> int:
        """Publish damaged messages that are no acknowledgements; return their number."""
        good = [to_msgpack(Ack("lobby", "b1", seq)) for seq in (0, 50, 2**40)]
        sent = 0
        while sent < count:
            raw = mutant(chance, good)
            try:
                ack = codec.read(Ack, raw, pack=True)
                if (ack.camera, 0 <= ack.seq < 2**63) == ("lobby", True):
                    continue
            except Rejected:
                pass
            self.elsewhere.publish_raw("ack/lobby", raw, "ack")
            sent += 1
        return sent

    def spools(self, cameras: int, chance: random.Random) -> None:
        """Answer the daemon's queries of spools with nonsense."""
        batch = SpoolBatch("junk", "b1", 1, 0, True, [(n, b"\xc1" * n) for n in range(1, 4)])

        def answer(key: str, parameters: dict[str, str]) -> msgspec.Raw:
            self.answers += 1
            return msgspec.Raw(mutant(chance, [to_msgpack(batch)])[:-1] + b"\xc1")

        for number in range(cameras):
            self.bus.answer_queries(f"spool/junk{number}", answer, "spool")
            self.bus.announce("grabber", f"junk{number}")
        for name in ("a b", "ü", "x" * 500, "..", "%", "a=b", "lobby;drop", "'"):
            self.bus.announce("grabber", name)

    def questions(self, count: int, chance: random.Random) -> None:
        """Send queries with invalid parameters."""
        values = (
            "",
            "nan",
            "inf",
            "-1",
            "1e999",
            "9" * 400,
            "0.5",
            "ü",
            "a/1",
            "\x00",
            "None",
            "0x1",
            "1_0",
            "½",
        )
        asked = (
            "predict/a",
            "predict/nobody",
            "predict/a b",
            "topology",
            "status/daemon",
            "spool/lobby",
        )
        for _ in range(count):
            key = chance.choice(asked)
            bus = self.elsewhere if key.startswith("spool") else self.bus
            names = chance.sample(
                ("x", "y", "t", "zone", "format", "version", "from", "max", "boot", "ü", ""), 3
            )
            with suppress(QueryError):
                bus.query(key, {name: chance.choice(values) for name in names}, seconds=5.0)

    @staticmethod
    def _dial(stack: ExitStack, config: Any) -> Bus:
        return stack.enter_context(buses.dial(config))


@pytest.fixture
def poisoner(tmp_path: Path) -> Iterator[Poisoner]:
    with ExitStack() as stack:
        yield Poisoner(tmp_path, stack)


def poison(one: Poisoner, count: int, seed: int) -> str:
    """Publish ``count`` damaged messages on every key, and a tenth as many queries.

    Nothing may have changed afterwards.
    """
    chance = random.Random(seed)
    before = one.state()
    events = one.events(count * 7 // 10, chance)
    acks = one.acks(count * 3 // 10, chance)
    one.spools(5, random.Random(seed))
    one.questions(count // 10, chance)
    wait_for(
        lambda: one.daemon.status().events["received"] >= 162 + events,
        "the daemon to have seen all of it",
    )
    wait_for(
        lambda: one.publisher.rejects.counts.total() >= acks, "the publisher to have seen all of it"
    )
    wait_for(lambda: one.answers >= count // 50, "answers of spools")
    status = one.daemon.status()
    said = status["rejects"]
    assert one.state() == before
    assert before["state"] == "running"
    assert said.total() if isinstance(said, Counter) else sum(said.values()) >= events
    assert all(1 <= len(kept) <= 3 for kept in status["reject_samples"].values())
    assert len(one.spool) == 100
    one.bus.publish(
        "event/a", Event("a", "exit", T0 + 11 * serving.SPAN_SECONDS, 0.9, 0.5), "event"
    )
    wait_for(lambda: one.state()["stored"] == before["stored"] + 1, "the next good event")
    one.elsewhere.publish("ack/lobby", Ack("lobby", "b1", 40), "ack")
    wait_for(lambda: len(one.spool) == 60, "the next good ack")
    return f"{events} events, {acks} acks, {one.answers} answers: {dict(said)}, {dict(one.publisher.rejects.counts)}"


def test_poison_on_every_key_changes_nothing(poisoner: Poisoner) -> None:
    poison(poisoner, 1_000, 1)


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_much_poison_on_every_key(poisoner: Poisoner) -> None:
    print(poison(poisoner, size("POISON", 10_000), size("SEED", 2)))
