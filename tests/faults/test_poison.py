"""Arbitrary bytes on any key are counted by reason and sampled, and change nothing else."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import msgspec
import pytest
import serving
from grabber import publisher_on
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
from camtopod.serve.bus import QueryError, dial, open_daemon_session
from camtopod.serve.daemon import Daemon
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


def test_the_fuzzer_makes_text_that_is_not_utf8() -> None:
    """Check of the harness: msgspec before 0.23 raises another error than its own for it."""
    chance, good = random.Random(1), seeds("lobby")
    plain = msgspec.msgpack.Decoder(Event)

    with pytest.raises(ValueError, match=r"(?i)utf-8"):  # noqa: PT012
        for _ in range(20_000):
            try:
                plain.decode(mutant(chance, good))
            except msgspec.MsgspecError as error:
                if "UTF-8" in str(error):
                    raise


# --- real sessions --------------------------------------------------------------------------------


CAMERAS = ("a", "x", "1", "a=b", "%", "ü", "x" * 200)
ODD_NAMES = ("a b", "ü", "x" * 500, "%", "a=b", "lobby;drop", "'")
KEYS = (
    *("predict/a", "predict/nobody", "topology", "status/daemon", "store/a"),
    *("admin/forget", "admin/rename", "admin/nonsense"),
)
PARAMETERS = ("x", "y", "t", "zone", "format", "version", "camera", "from", "to", "ü", "")
VALUES = (*("", "nan", "inf", "-1", "1e999", "9" * 400, "ü", "a/1", "\x00", "None", "0x1", "½"),)


def unreadable(chance: random.Random, good: list[bytes], read: Callable[[bytes], object]) -> bytes:
    """Return a damaged message that ``read`` rejects."""
    while True:
        raw = mutant(chance, good)
        try:
            read(raw)
        except Rejected:
            return raw


def unchanging(daemon: Daemon) -> dict[str, Any]:
    """Return the state that damaged messages must not change."""
    status = daemon.status()
    return {
        "topology": daemon.topology,
        "state": status.state,
        "journal": status.journal.entries,
        **{
            name: getattr(status.events, name)
            for name in ("stored", "future", "flood", "lost", "waiting")
        },
    }


def poison(directory: Path, count: int, seed: int) -> None:
    """Send ``count`` damaged messages of each kind, and some queries; nothing may have changed."""
    chance = random.Random(seed)
    with ExitStack() as stack:
        config = small_config(directory / "state")
        daemon = stack.enter_context(Daemon(config, clock=lambda: NOW))
        bus = stack.enter_context(dial(small_config(directory, daemon.endpoint)))
        closing = [msgspec.structs.replace(closing_event(), camera=camera) for camera in "de"]
        events = [*numbered(walkers(40)), *closing]
        for event in events:
            bus.publish(f"event/{event.camera}", event, "event")
        wait_for(lambda: daemon.status().events.stored == len(events), "the good events")
        wait_for(lambda: all_out(daemon, len(events)), "its versions")
        before = unchanging(daemon)
        assert before["state"] == "running"

        replies: list[bytes | None] = []
        for _ in range(count):
            camera = chance.choice("abcxyz")
            bus.publish_raw(f"event/{camera}", unreadable(chance, seeds(camera), decode), "event")
            camera = chance.choice(CAMERAS)
            request = unreadable(chance, requests(camera), read_request)
            bus.ask(f"store/{camera}", request, 30.0, replies.append)
        for name in ODD_NAMES:
            bus.announce("grabber", name)
        for _ in range(count // 10):
            given = {name: chance.choice(VALUES) for name in chance.sample(PARAMETERS, 3)}
            with suppress(QueryError):
                bus.query(chance.choice(KEYS), given, seconds=5.0)

        wait_for(lambda: len(replies) == count, "an answer to each")
        reasons = Counter(codec.read(Answer, reply or b"", pack=True).reason for reply in replies)
        assert set(reasons) <= {"malformed", "busy"}  # busy: a newer one of the camera has come
        refused = count + reasons["malformed"]
        wait_for(lambda: sum(daemon.status().rejects.values()) >= refused, "all of it")
        assert unchanging(daemon) == before
        assert all(1 <= len(kept) <= 3 for kept in daemon.status().reject_samples.values())
        print(daemon.status().rejects)

        good = Event("a", "exit", T0 + 11 * serving.SPAN_SECONDS, 0.9, 0.5)
        bus.publish("event/a", good, "event")
        stored = before["stored"] + 1
        wait_for(lambda: daemon.status().events.stored == stored, "the next good event")


def test_poison_on_every_key_changes_nothing(tmp_path: Path) -> None:
    poison(tmp_path, 300, 1)


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_much_poison_on_every_key(tmp_path: Path) -> None:
    poison(tmp_path, size("POISON", 10_000), size("SEED", 2))


def test_a_grabber_believes_no_damaged_answer(tmp_path: Path) -> None:
    chance = random.Random(1)
    is_damaged = True

    def answer(key: str, content: bytes, reply: Callable[[bytes], None]) -> None:
        if is_damaged:
            reply(unreadable(chance, answers(), lambda raw: codec.read(Answer, raw, pack=True)))
        elif isinstance(request := read_request(content), Batch):
            reply(to_msgpack(Answer({request.boot: request.events[-1][0]}, 40)))
        else:
            reply(to_msgpack(Answer({"b1": 0}, 40)))

    with open_daemon_session(small_config(tmp_path)) as bus:
        bus.answer_requests("store/*", answer)
        with publisher_on(bus, tmp_path, ["lobby"]) as publisher:
            publisher.publish(*(Event("lobby", "entry", T0 + n) for n in range(100)))
            for number in range(1, 51):
                bus.announce("daemon", f"d{number}")  # so that it asks again at once
                wait_for(lambda n=number: publisher.rejects.counts.total() >= n, "it")  # type: ignore[misc]
            assert publisher.waiting == 100
            is_damaged = False
            bus.announce("daemon", "the last")
            assert publisher.wait_stored(serving.WAIT_SECONDS)
