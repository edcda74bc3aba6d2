"""A program's session on the bus. Only this module uses zenoh.

All keys are below ``camtopo/{site}/``. Clients connect to explicit endpoints; the daemon may itself
be the endpoint they connect to (zenoh's mode ``router``). Multicast scouting and shared memory are
off, as both cause more trouble than they save. Callbacks must not block: while one does, its
subscription or query gets nothing else.
"""

from __future__ import annotations

import contextlib
import functools
import json
import logging
import re
import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from typing import Any

import zenoh

from camtopod import codec
from camtopod.config import BusSettings, Config
from camtopod.keys.rules import PREFIX
from camtopod.records import NAME_PATTERN
from camtopod.redact import redact
from camtopod.serve.bus import forks, sockets
from camtopod.serve.bus.access import BusError as BusError

log = logging.getLogger(__name__)

_PACK = "application/msgpack;schema=camtopod.{}.1"
JSON = "application/json"
QUERY_SECONDS = 2.0
"""Time to wait for the answer to a query."""
CALLBACKS_SECONDS_MAX = 2.0
"""Longest wait, at the end of a session, for the end of its requests, and of each callback."""
_CALLBACK_NAME = "pyo3"
"""Part of the name of zenoh's threads that call back; they end after their declarations."""
_REPLIES_MAX = 4096
"""Most answers to one query that are kept; closing the channel drops the rest."""
_PROMPT = ("prediction", "match", "status")
"""Schemas of small and urgent messages, which never wait behind a topology on the same link."""

# Priorities, each a queue of its own on every link.
_FIRST = zenoh.Priority.INTERACTIVE_HIGH
_USUAL = zenoh.Priority.DATA
_ASKED = zenoh.Priority.INTERACTIVE_LOW
"""That of queries and answers.

The daemon that others connect to gives _ASKED to readers' queries, whatever they ask for
(`camtopod.keys.rules.priorities`).
"""

OnMessage = Callable[[str, bytes], None]
"""Callback with (key below the site, payload). Called on a thread of the bus; must not block."""
Answer = Callable[[str, dict[str, str]], Any]
"""Callback for a query: (key below the site, parameters).

Returns the struct to answer with, or None for no answer; raises `QueryError` to refuse.
"""

OnRequest = Callable[[str, bytes, Callable[[bytes], None]], None]
"""Callback with (key below the site, content, function that answers).

Called on a thread of the bus; must not block. The answer may be given later, on any thread, once.
"""


class QueryError(Exception):
    """A query that cannot be answered; ``str()`` is sent to the program that asked."""


class NotOpened(Exception):
    """A session cannot be opened; ``str()`` is zenoh's message without a path of its source."""


class Bus(contextlib.AbstractContextManager["Bus"]):
    """One session on the bus of one site.

    Do not call it from its own callbacks, except `publish` (a query there waits for itself). Close
    it at the end: a callback that comes when the interpreter has ended ends the process by force.
    """

    def __init__(
        self, session: zenoh.Session, site: str, endpoint: str, settings: BusSettings
    ) -> None:
        self.site = site
        self.endpoint = endpoint
        """The endpoint listened on, with the actual port, or the first one connected to."""
        self._session = session
        self._bytes_max = settings.message_bytes_max
        self._too_large: set[str] = set()
        self._declarations: list[Any] = []
        self._callback_threads: list[threading.Thread] = []
        self._end = threading.Event()
        self._idle = threading.Condition()
        self._asking = 0  # requests that have not ended
        forks.guard(self)

    def publish(self, key: str, message: Any, schema: str, droppable: bool | None = None) -> None:
        """Publish a struct as MessagePack, without confirmation (see `camtopod.serve.outbox`)."""
        self.publish_raw(key, codec.to_msgpack(message), schema, droppable)

    def publish_raw(
        self, key: str, payload: bytes, schema: str, droppable: bool | None = None
    ) -> None:
        """Publish bytes that are MessagePack already. Does nothing once the bus is closed.

        key: key below the site.
        schema: name of the payload's type; it also decides how the message is sent.
        droppable: True to drop the message for a link that is full; False to wait for room, so that
            `close` does not come before it is sent; None for what its schema says.

        Then only events wait for a subscriber that has stopped reading. Other messages for
        its full link are dropped, except one topology, which is sent when the link has room; the
        subscriber notices the gap in the versions, and queries the topology.
        """
        self._mind_size(key, payload)

        # Decide what to do for a link that is full: drop the message, wait for room, or let one
        # message wait without the caller and drop further ones.
        control = zenoh.CongestionControl.BLOCK_FIRST
        if droppable or (droppable is None and schema in _PROMPT):
            control = zenoh.CongestionControl.DROP
        elif droppable is False or schema == "event":
            control = zenoh.CongestionControl.BLOCK

        try:
            self._session.put(
                self._full(key),
                payload,
                encoding=_encoding(schema),
                congestion_control=control,
                priority=_FIRST if schema in _PROMPT else _USUAL,
            )
        except zenoh.ZError as error:
            if not self._end.is_set():
                log.warning("cannot publish on %s: %s", key, error)

    def subscribe(self, key: str, on_message: OnMessage) -> Callable[[], None]:
        """Call ``on_message`` for every publication on ``key`` (may contain ``*``).

        Returns a function that ends the subscription; it may be called twice.
        """

        def receive(sample: zenoh.Sample) -> None:
            if sample.kind == zenoh.SampleKind.PUT:
                on_message(self._below(str(sample.key_expr)), sample.payload.to_bytes())

        subscriber = self._declare(self._session.declare_subscriber, self._full(key), receive)

        def end() -> None:
            with contextlib.suppress(ValueError, zenoh.ZError):
                self._declarations.remove(subscriber)
                subscriber.undeclare()

        return end

    def answer_queries(self, key: str, answer: Answer, schema: str) -> None:
        """Answer queries on ``key`` (may contain ``*``) by calling ``answer``.

        In MessagePack, or in JSON if the query has the parameter format=application/json.
        """

        def reply(query: zenoh.Query) -> None:
            with query:
                pairs = (pair.partition("=") for pair in str(query.parameters).split(";") if pair)
                parameters = {name: value for name, _, value in pairs}
                full_key = str(query.key_expr) if "*" in key else self._full(key)

                # Get the answer, or the refusal.
                try:
                    content = answer(self._below(full_key), parameters)
                except QueryError as error:
                    query.reply_err(redact(str(error)).encode(), encoding="text/plain")
                    return
                if content is None:
                    return

                # Encode and send it.
                as_json = parameters.get("format") == JSON
                payload = codec.to_json(content) if as_json else codec.to_msgpack(content)
                self._mind_size(self._below(full_key), payload)
                query.reply(full_key, payload, encoding=JSON if as_json else _PACK.format(schema))

        self._declare(self._session.declare_queryable, self._full(key), reply)

    def query(
        self,
        key: str,
        parameters: Mapping[str, object] | None = None,
        seconds: float | None = None,
        one: bool = False,
    ) -> list[tuple[str, bytes]]:
        """Return all answers to a query as (key below the site, payload).

        key: key below the site (may contain ``*``).
        parameters: sent with the query.
        seconds: time limit; `QUERY_SECONDS` by default.
        one: return after the first answer. On a busy machine zenoh (1.10.2) sometimes loses the
            message that ends a query, which then lasts for its whole time limit.

        Answers that do not come within the time limit are missing. Raises `QueryError` if there is
        no answer but a refusal.
        """
        arguments = ";".join(f"{name}={value}" for name, value in (parameters or {}).items())
        answers: list[tuple[str, bytes]] = []
        refusal = None

        try:
            # Send the query, and collect answers and refusals.
            replies = self._session.get(
                f"{self._full(key)}?{arguments}",
                zenoh.handlers.FifoChannel(_REPLIES_MAX),
                timeout=seconds or QUERY_SECONDS,
                consolidation=zenoh.ConsolidationMode.NONE,
                priority=_ASKED,
            )
            for reply in replies:
                if reply.ok is not None:
                    answers.append(
                        (self._below(str(reply.ok.key_expr)), reply.ok.payload.to_bytes())
                    )
                    if one:
                        break
                elif reply.err is not None and str(reply.err.encoding).startswith("text/plain"):
                    refusal = reply.err.payload.to_bytes().decode("utf-8", "replace")
        except zenoh.ZError as error:
            log.debug("query on %s: %s", key, error)

        if refusal is not None and not answers:
            raise QueryError(refusal)
        return answers

    def ask(
        self, key: str, payload: bytes, seconds: float, on_answer: Callable[[bytes | None], None]
    ) -> None:
        """Send a request, and call ``on_answer`` once: with the answer, or with None at the end.

        It is called on a thread of the bus, at once if no program answers on ``key`` or that one
        ends, and after ``seconds`` at the latest. It must not block.
        """
        gate = threading.Lock()

        def answer(content: bytes | None) -> None:
            if gate.acquire(blocking=False):
                on_answer(content)

        def receive(reply: zenoh.Reply) -> None:
            answer(None if reply.ok is None else reply.ok.payload.to_bytes())

        def end() -> None:
            answer(None)
            with self._idle:
                self._asking -= 1
                self._idle.notify_all()

        with self._idle:
            self._asking += 1
        try:
            self._session.get(
                self._full(key),
                zenoh.handlers.Callback(receive, end),
                payload=payload,
                encoding=_encoding("store"),
                timeout=seconds,
                priority=_USUAL,
            )
        except zenoh.ZError as error:
            log.debug("request on %s: %s", key, error)
            end()

    def answer_requests(self, key: str, on_request: OnRequest) -> None:
        """Call ``on_request`` for every request of `ask` on ``key`` (may contain ``*``)."""

        def receive(query: zenoh.Query) -> None:
            full_key = str(query.key_expr)

            def reply(answer: bytes) -> None:
                with query, contextlib.suppress(zenoh.ZError):  # the program that asked has ended
                    query.reply(full_key, answer, encoding=_encoding("store"))

            content = query.payload
            on_request(self._below(full_key), b"" if content is None else content.to_bytes(), reply)

        self._declare(self._session.declare_queryable, self._full(key), receive)

    def announce(self, role: str, name: str) -> None:
        """Declare ``alive/{role}/{name}``, which vanishes with this session."""
        token = self._session.liveliness().declare_token(self._full(f"alive/{role}/{name}"))
        self._declarations.append(token)

    def list_alive(self, role: str) -> list[str]:
        """Return the names of the programs of a role that are on the bus.

        Names that do not match `NAME_PATTERN` are left out.
        """
        names = [key.rsplit("/", 1)[-1] for key in self._alive(self._full(f"alive/{role}/*"))]
        return [name for name in names if re.match(NAME_PATTERN, name)]

    def list_sites(self) -> list[str]:
        """Return the names of all sites that have a daemon on this bus, sorted."""
        names = {key.split("/")[1] for key in self._alive(f"{PREFIX}/*/alive/daemon/*")}
        return sorted(name for name in names if re.match(NAME_PATTERN, name))

    def _alive(self, keys: str) -> list[str]:
        """Return the keys of the liveliness tokens that match ``keys``."""
        answers = self._session.liveliness().get(
            keys, zenoh.handlers.FifoChannel(_REPLIES_MAX), timeout=QUERY_SECONDS
        )
        return [str(reply.ok.key_expr) for reply in answers if reply.ok is not None]

    def watch_alive(self, role: str, on_change: Callable[[str, bool], None]) -> None:
        """Call ``on_change(name, alive)`` for programs of a role: those present, and each change.

        Names as in `list_alive`.
        """

        def change(sample: zenoh.Sample) -> None:
            name = str(sample.key_expr).rsplit("/", 1)[-1]
            if re.match(NAME_PATTERN, name):
                on_change(name, sample.kind == zenoh.SampleKind.PUT)

        declare = self._session.liveliness().declare_subscriber
        self._declare(declare, self._full(f"alive/{role}/*"), change, history=True)

    def watch_connections(self) -> None:
        """Keep links that close from blocking the bus."""

        def change(event: zenoh.LinkEvent) -> None:
            if event.kind == zenoh.SampleKind.PUT:
                sockets.close_without_waiting()

        self._declare(self._session.info.declare_link_events_listener, change, history=True)

    @property
    def connected(self) -> bool:
        """True if the session is connected to a router now; zenoh reconnects by itself."""
        return not self._end.is_set() and bool(self._session.info.routers_zid())

    def close(self) -> None:
        """Flush and close; may be called twice."""
        if self._end.is_set():
            return
        self._end.set()
        for declaration in self._declarations:
            with contextlib.suppress(zenoh.ZError):
                declaration.undeclare()
        with contextlib.suppress(zenoh.ZError):  # raised after zenoh's own timeout (zenoh#2675)
            self._session.close()  # type: ignore[no-untyped-call]

        # A callback that comes when the interpreter has ended would end the process by force.
        with self._idle:
            self._idle.wait_for(lambda: not self._asking, CALLBACKS_SECONDS_MAX)
        for thread in self._callback_threads:
            if thread is not threading.current_thread():
                thread.join(CALLBACKS_SECONDS_MAX)

    def __exit__(self, *_: object) -> None:
        self.close()

    def _declare(self, declare: Callable[..., Any], *arguments: object, **options: object) -> Any:
        """Declare something that calls back, until the session is closed.

        zenoh calls back on a thread that is a daemon if the declaring one is, and any other would
        keep the process from ending while the session is open.
        """
        result: Future[Any] = Future()
        threads_before = threading.enumerate()

        def run() -> None:
            try:
                result.set_result(declare(*arguments, **options))
            except zenoh.ZError as error:
                result.set_exception(error)

        threading.Thread(target=run, name="declare", daemon=True).start()
        self._declarations.append(result.result())
        new_threads = [thread for thread in threading.enumerate() if thread not in threads_before]
        self._callback_threads = [
            *(thread for thread in self._callback_threads if thread.is_alive()),
            *(thread for thread in new_threads if _CALLBACK_NAME in thread.name),
        ]
        return result.result()

    def _mind_size(self, key: str, payload: bytes) -> None:
        """Log an error, once for each key, if a payload is larger than other programs receive.

        They drop it without notice.
        """
        if len(payload) > self._bytes_max and key not in self._too_large:
            self._too_large.add(key)
            log.error(
                "a message on %s has %d bytes, more than bus.message_bytes_max (%d): "
                "other programs drop it; raise that setting for all programs",
                key,
                len(payload),
                self._bytes_max,
            )

    def _full(self, key: str) -> str:
        return f"{PREFIX}/{self.site}/{key}"

    def _below(self, key: str) -> str:
        return key.removeprefix(f"{PREFIX}/{self.site}/")


def open_session(
    config: Config,
    values: Mapping[str, object],
    connect: Sequence[str] = (),
    listen: Sequence[str] = (),
) -> Bus:
    """Open a session with these settings of zenoh and endpoints.

    Raises `NotOpened`, and `BusError` after a fork.
    """
    forks.note_use()
    settings = zenoh.Config()
    endpoints = {"connect/endpoints": list(connect), "listen/endpoints": list(listen)}
    for key, value in {**values, **endpoints}.items():
        settings.insert_json5(key, json.dumps(value))
    if not listen:
        settings.insert_json5(
            "connect/timeout_ms", json.dumps(int(config.bus.connect_seconds * 1000))
        )
    try:
        session = zenoh.open(settings)
    except zenoh.ZError as error:
        raise NotOpened(str(error).split(" at /")[0].strip()) from None
    return Bus(session, config.site.name, [*listen, *connect][0], config.bus)


def log_to_standard_output() -> None:
    """Have zenoh write its own log: errors, and refused TLS connections with the reason.

    The environment variable RUST_LOG can ask for more. Once in a process.
    """
    zenoh.init_log_from_env_or("error,zenoh_link_tls=warn")


@functools.cache
def _encoding(schema: str) -> zenoh.Encoding:
    return zenoh.Encoding(_PACK.format(schema))
