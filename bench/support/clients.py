"""The other processes of `bench.ingest`, `bench.latency` and `bench.router`: senders and receivers.

    python -m bench.support.clients ROLE '{"endpoint": ...}'

Each prints one line of JSON at its end. The bare ones use camtopod's sessions, so that links and
settings are the same, and nothing else of it.
"""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import zenoh
from msgspec import Struct

from camtopod.codec import to_msgpack
from camtopod.config.settings import BusSettings, Config
from camtopod.records import Event, Prediction
from camtopod.serve.bus import Bus, dial, open_daemon_session
from camtopod.serve.requests import ANSWER_SECONDS_MAX, Answer, Batch, Hello
from camtopod.serve.storage import sqlite_file

REQUEST_EVENTS = 300
"""Most events in a request of `deliver`."""
PREFIX = "camtopo/site"
"""Key prefix of a site on the bus."""
COUNT_SECONDS = 0.2
"""Interval at which the bare receiver tells its count, seconds."""
WINDOW_EVENTS = 40_000
"""Most events in flight to the bare receiver."""
QUIET_SECONDS = 300.0
"""Longest wait for a count; after it events count as lost."""
START_SECONDS = 300.0
"""Longest wait for a daemon to make its first version, seconds."""
ENDED = b"ended"
"""Payload that ends a round."""


class Count(Struct, frozen=True):
    """Counts of events in ``status/daemon``, as far as they are used here."""

    stored: int = 0
    received: int = 0
    lost: int = 0
    flood: int = 0
    waiting: int = 0


class Learned(Struct, frozen=True):
    """The newest version of the learner in this epoch; 0 before the first."""

    version: int = 0


class Status(Struct):
    """Fields of ``status/daemon`` that are used here."""

    events: Count = Count()
    learner: Learned = Learned()
    version: int = 0
    predictions: int = 0
    dropped: dict[str, int] = {}


def put_paced(endpoint: str, events: str, bare: bool) -> dict[str, Any]:
    """Publish events when they are due, stamped with the time of publication.

    If ``bare``, payloads have the same size, but consist of the time, the kind and padding.
    """
    bus = _dialled(endpoint)
    batch = _read(events)
    puts = _publishers(bus, batch)

    # Publish each at its time.
    start = time.time() + 0.2
    late = []
    for event in batch:
        due = start + event.t
        while (seconds := due - time.time()) > 0:
            time.sleep(seconds)
        now = time.time()
        stamped_event = msgspec.structs.replace(event, t=now)
        payload = to_msgpack(stamped_event)
        if bare:
            payload = _framed(now, event.kind == "exit", len(payload))
        puts[event.camera].put(payload)
        late.append(now - due)

    # End the round.
    time.sleep(1.0)
    bus._session.put(f"{PREFIX}/bench/ended", ENDED)
    bus.close()
    return {"put": len(batch), "late_ms": 1000 * sorted(late)[len(late) // 2]}


def put_flood(endpoint: str, events: str) -> dict[str, Any]:
    """Publish as fast as the bare receiver counts; return the seconds until it has all."""
    bus = _dialled(endpoint)
    batch = _read(events)
    puts = _publishers(bus, batch)
    messages = [(puts[event.camera], to_msgpack(event)) for event in batch]
    progress, condition = [0, 0.0], threading.Condition()

    def on_count(sample: zenoh.Sample) -> None:
        with condition:
            progress[:] = max(progress[0], int(sample.payload.to_string())), time.monotonic()
            condition.notify_all()

    subscriber = bus._session.declare_subscriber(f"{PREFIX}/bench/received", on_count)
    time.sleep(1.0)

    # Publish; wait whenever the window is full.
    start = time.monotonic()
    for number, (publisher, message) in enumerate(messages):
        if number % 256 == 0 and number - progress[0] > WINDOW_EVENTS:
            with condition:
                count_min = number - WINDOW_EVENTS
                while progress[0] < count_min and condition.wait(QUIET_SECONDS):
                    pass
                if progress[0] < count_min:
                    break
        publisher.put(message)

    # Wait for the rest.
    with condition:
        condition.wait_for(lambda: progress[0] >= len(messages), QUIET_SECONDS)
    subscriber.undeclare()  # type: ignore[no-untyped-call]
    bus.close()
    return {"seconds": progress[1] - start}


def deliver(endpoint: str, events: str) -> dict[str, Any]:
    """Deliver as the spools of all cameras would; return the seconds until all is stored."""
    bus = _dialled(endpoint)
    boot = f"boot-{time.time()}"
    queues = _numbered(_read(events), boot)
    condition = threading.Condition()
    decoder = msgspec.msgpack.Decoder(Answer)

    def ask(camera: str, request: Hello | Batch) -> None:
        bus.ask(
            f"store/{camera}",
            to_msgpack(request),
            ANSWER_SECONDS_MAX,
            lambda content: on_answer(camera, content),
        )

    def on_answer(camera: str, content: bytes | None) -> None:
        answer = decoder.decode(content or b"")
        have = answer.have.get(boot, 0)
        queue = queues[camera] = [message for message in queues[camera] if message[0] > have]
        if queue:
            if answer.reason:
                time.sleep(0.1)
            now = queue[: min(answer.batch, REQUEST_EVENTS)]
            ask(camera, Batch("bench", boot, have, now, len(queue) - len(now)))
        else:
            with condition:
                del queues[camera]
                condition.notify_all()

    start = time.monotonic()
    for camera in list(queues):
        ask(camera, Hello("bench", [boot]))
    with condition:
        condition.wait_for(lambda: not queues, QUIET_SECONDS)
    took = time.monotonic() - start
    bus.close()
    return {"seconds": took}


def _numbered(events: Sequence[Event], boot: str) -> dict[str, list[tuple[int, bytes]]]:
    """Return the events of each camera as pairs of number and bytes."""
    queues: dict[str, list[tuple[int, bytes]]] = {}
    for event in events:
        queue = queues.setdefault(event.camera, [])
        seq = len(queue) + 1
        queue.append((seq, to_msgpack(msgspec.structs.replace(event, boot=boot, seq=seq))))
    return queues


def ask(endpoint: str, events: str) -> dict[str, Any]:
    """Send what `deliver` sends, one request a camera at a time, whatever is answered."""
    bus = _dialled(endpoint)
    queues = _numbered(_read(events), "boot")
    requests = {
        camera: [
            to_msgpack(Batch("bench", "boot", 0, queue[first : first + REQUEST_EVENTS]))
            for first in range(0, len(queue), REQUEST_EVENTS)
        ]
        for camera, queue in queues.items()
    }
    counts = [sum(map(len, requests.values())), sum(map(len, queues.values()))]
    condition = threading.Condition()

    def send(camera: str) -> None:
        bus.ask(f"store/{camera}", requests[camera].pop(), ANSWER_SECONDS_MAX, partial(on, camera))

    def on(camera: str, content: bytes | None) -> None:
        if requests[camera]:
            send(camera)
        else:
            with condition:
                del requests[camera]
                condition.notify_all()

    start = time.monotonic()
    for camera in list(requests):
        send(camera)
    with condition:
        condition.wait_for(lambda: not requests, QUIET_SECONDS)
    took = time.monotonic() - start
    bus.close()
    return {"seconds": took, "requests": counts[0], "events": counts[1]}


def keep(endpoint: str, ready: str, database: str) -> dict[str, Any]:
    """Commit each request as one blob, and answer it."""
    bus, stop = open_daemon_session(_config(listen=endpoint)), threading.Event()
    table = "CREATE TABLE meta (key, value, crc); CREATE TABLE request (content BLOB)"
    store = sqlite_file.connect(Path(database), table, 1)
    count = [0]

    def on_request(key: str, content: bytes, reply: Callable[[bytes], None]) -> None:
        with sqlite_file.transaction(store):
            store.execute("INSERT INTO request VALUES (?)", (content,))
        count[0] += 1
        reply(b"stored")

    bus.answer_requests("store/*", on_request)
    _end_with_input(stop)
    _say_ready(bus, ready)
    stop.wait()
    bus.close()
    store.close()
    return {"requests": count[0]}


def sink(endpoint: str, ready: str, dials: bool = False) -> dict[str, Any]:
    """Receive and decode every event with bare zenoh and msgspec; publish the count regularly."""
    bus = _dialled(endpoint) if dials else open_daemon_session(_config(listen=endpoint))
    decoder, count, stop = msgspec.msgpack.Decoder(Event), [0], threading.Event()

    def on_event(sample: zenoh.Sample) -> None:
        decoder.decode(sample.payload.to_bytes())
        count[0] += 1

    bus._session.declare_subscriber(f"{PREFIX}/event/*", on_event)
    _end_with_input(stop)
    _say_ready(bus, ready)
    while not stop.wait(COUNT_SECONDS):
        bus._session.put(f"{PREFIX}/bench/received", str(count[0]))
    bus.close()
    return {"received": count[0]}


def router(endpoint: str, ready: str) -> dict[str, Any]:
    """Run a router without anything else; return its processor time."""
    bus, stop = open_daemon_session(_config(listen=endpoint)), threading.Event()
    _end_with_input(stop)
    _say_ready(bus, ready)
    start = time.process_time()
    stop.wait()
    cpu_seconds = time.process_time() - start
    bus.close()
    return {"cpu_seconds": cpu_seconds}


def echo(endpoint: str, ready: str, size: int) -> dict[str, Any]:
    """Answer every exit with ``size`` bytes, by bare zenoh."""
    bus = open_daemon_session(_config(listen=endpoint))
    session, stop, filling = bus._session, threading.Event(), bytes(size - 8)

    def on_event(sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        if payload[8]:
            session.put(
                f"{PREFIX}/prediction/{str(sample.key_expr).rpartition('/')[2]}",
                payload[:8] + filling,
            )

    session.declare_subscriber(f"{PREFIX}/event/*", on_event)
    _end_with_input(stop)
    _say_ready(bus, ready)
    stop.wait()
    bus.close()
    return {}


def hear(endpoint: str, ready: str, bare: bool) -> dict[str, Any]:
    """Return the delays from exits to their predictions, ms, until the sender has ended."""
    bus = _dialled(endpoint)
    decoder, stop = msgspec.msgpack.Decoder(Prediction), threading.Event()
    messages: list[tuple[float, bytes]] = []
    bus._session.declare_subscriber(
        f"{PREFIX}/prediction/*",
        lambda sample: messages.append((time.time(), sample.payload.to_bytes())),
    )
    bus._session.declare_subscriber(f"{PREFIX}/bench/ended", lambda _: stop.set())
    _say_ready(bus, ready)
    stop.wait()
    bus.close()
    sizes = [len(payload) for _, payload in messages]
    then = [
        struct.unpack("<d", payload[:8])[0] if bare else decoder.decode(payload).t
        for _, payload in messages
    ]
    return {
        "ms": [round(1000 * (now - t), 4) for (now, _), t in zip(messages, then, strict=True)],
        "size": sorted(sizes)[len(sizes) // 2] if sizes else 0,
    }


def status_of(endpoint: str) -> Status:
    """Return the daemon's status."""
    with _dialled(endpoint) as bus:
        return msgspec.msgpack.decode(bus.query("status/daemon")[0][1], type=Status)


def learned_status(endpoint: str, seconds: float = START_SECONDS) -> Status:
    """Return the daemon's status once it has a version of its epoch and no event waits.

    Raises `TimeoutError` after ``seconds``.
    """
    deadline = time.monotonic() + seconds
    while (status := status_of(endpoint)).learner.version == 0 or status.events.waiting:
        if time.monotonic() > deadline:
            raise TimeoutError(f"the daemon has not learned all events in time: {status}")
        time.sleep(0.5)
    return status


@contextmanager
def client(role: str, folder: Path, **arguments: Any) -> Iterator[subprocess.Popen[str]]:
    """Run a role in a process of its own; wait until it is ready, if the role reports that."""
    if role in ("sink", "keep", "echo", "hear", "router"):
        arguments["ready"] = str(folder / f"{role}-{time.monotonic_ns()}")
    command = [sys.executable, "-m", "bench.support.clients", role, json.dumps(arguments)]
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        while "ready" in arguments and not Path(arguments["ready"]).exists():
            if process.poll() is not None:
                raise RuntimeError(f"{role} ended before it was ready")
            time.sleep(0.02)
        yield process
    finally:
        with process:  # which closes its pipes and waits
            if process.poll() is None:
                process.kill()


def result(process: subprocess.Popen[str]) -> dict[str, Any]:
    """Wait for a client's end and return its result.

    Closing its input ends the roles that run until then.
    """
    out, _ = process.communicate()
    if process.returncode:
        raise RuntimeError(f"a client failed: {process.args!r}")
    outcome: dict[str, Any] = json.loads(out.splitlines()[-1])
    return outcome


def write_events(path: Path, events: Sequence[Event]) -> str:
    """Write events to a file for another process to publish."""
    path.write_bytes(msgspec.msgpack.encode(events))
    return str(path)


def _read(path: str) -> list[Event]:
    return msgspec.msgpack.decode(Path(path).read_bytes(), type=list[Event])


def _config(connect: str | None = None, listen: str | None = None) -> Config:
    bus = BusSettings(connect=(connect,)) if connect else BusSettings(listen=(listen or "",))
    return Config(bus=bus)


def _dialled(endpoint: str) -> Bus:
    return dial(_config(connect=endpoint))


def _publishers(bus: Bus, events: Sequence[Event]) -> dict[str, Any]:
    return {
        camera: bus._session.declare_publisher(
            f"{PREFIX}/event/{camera}", congestion_control=zenoh.CongestionControl.BLOCK
        )
        for camera in {event.camera for event in events}
    }


def _framed(now: float, is_exit: bool, size: int) -> bytes:
    return (struct.pack("<d", now) + bytes([is_exit])).ljust(size, b"\0")


def _say_ready(bus: Bus, path: str) -> None:
    """Report readiness by writing the endpoint to a file, atomically."""
    temporary = Path(f"{path}.made")
    temporary.write_text(bus.endpoint)
    temporary.rename(path)


def ready_at(process: subprocess.Popen[str]) -> str:
    """Return the endpoint of a client that listens."""
    arguments = process.args
    assert isinstance(arguments, list)
    return Path(json.loads(str(arguments[-1]))["ready"]).read_text()


def _end_with_input(stop: threading.Event) -> None:
    """Set ``stop`` when the standard input is closed."""

    def wait() -> None:
        sys.stdin.read()
        stop.set()

    threading.Thread(target=wait, daemon=True).start()


ROLES: dict[str, Any] = {
    "put_paced": put_paced,
    "put_flood": put_flood,
    "deliver": deliver,
    "ask": ask,
    "keep": keep,
    "sink": sink,
    "echo": echo,
    "hear": hear,
    "router": router,
}
"""Functions by role; each takes the fields of the JSON argument."""

if __name__ == "__main__":
    print(json.dumps(ROLES[sys.argv[1]](**json.loads(sys.argv[2]))))
