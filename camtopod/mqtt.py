"""Messages of an MQTT broker, and to one. The one home of paho-mqtt, which is an extra
(``[mqtt]``).
"""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlsplit

from msgspec import Struct

from camtopod.redact import redact, remember

if TYPE_CHECKING:
    from paho.mqtt.client import Client, MQTTMessage
    from paho.mqtt.enums import MQTTProtocolVersion
    from paho.mqtt.reasoncodes import ReasonCode

log = logging.getLogger(__name__)

PORTS = {"mqtt": 1883, "mqtts": 8883}
"""Usual port by the URL's scheme; mqtts is TLS."""
MESSAGES_MAX = 10_000
WAITING_BYTES_MAX = 32 * 1024**2
"""Messages, and bytes, that wait to be read; further messages are dropped and counted."""
PACKET_BYTES_MAX = 2 * 1024**2
"""A broker that speaks MQTT 5 does not send larger packets; one that does all the same is
disconnected. Lines of all formats are shorter.
"""
CONNECT_SECONDS = 10.0
"""How long the first connection may take."""
KEEPALIVE_SECONDS = 30
RETRY_SECONDS_MAX = 60
"""Largest wait before a lost connection is tried again; it begins with 1 s and doubles."""
LEAVE_SECONDS = 2.0
"""For the last message."""
ONLINE, OFFLINE = "online", "offline"
UNSUPPORTED = "Unsupported protocol version"
"""The answer to MQTT 5 of a broker that does not speak it."""
CLOSED = "the connection was closed"
_TICK_SECONDS = 0.2


class MqttError(Exception):
    """The broker cannot be reached, or does not let us in; ``str()`` says why."""


class Broker(Struct, frozen=True):
    """Where messages come from or go to. ``prefix``: the levels before a program's own topics,
    without a slash at the end.
    """

    host: str
    port: int
    tls: bool
    prefix: str
    user: str | None = None
    password: str | None = None
    ca: str | None = None
    """File with the authorities to trust; None: the system's."""


def broker(
    url: str, password: str | None = None, ca: str | None = None, prefix: str = ""
) -> Broker:
    """From ``mqtt[s]://[USER@]HOST[:PORT]/PREFIX``; ``prefix`` stands for one that is left out.

    Raises `ValueError`, also for a password in it.
    """
    remember(url)
    parts = urlsplit(url)
    if parts.scheme not in PORTS or not parts.hostname:
        raise ValueError(
            f"{redact(url)!r}: write it like mqtt://HOST:1883/PREFIX, or mqtts:// for TLS"
        )
    if parts.password is not None:
        raise ValueError(
            "others on this machine can read a password on the command line: put it in a file"
        )
    prefix = unquote(parts.path).strip("/") or prefix
    if not prefix or "+" in prefix or parts.query or "#" in url:
        raise ValueError(
            f"{redact(url)!r}: it ends in the program's topic prefix, for example /frigate"
        )
    user = None if parts.username is None else unquote(parts.username)
    if password is not None:
        if user is None:
            raise ValueError("a password needs a user: put the name and an @ before the host")
        remember(f"mqtt://{user}:{password}@")
    tls = parts.scheme == "mqtts"
    return Broker(
        parts.hostname, parts.port or PORTS[parts.scheme], tls, prefix, user, password, ca
    )


def _bounded() -> type[Client]:
    """paho's client, which would ask the system for a packet of any length, with a limit."""
    from paho.mqtt.client import Client

    class Bounded(Client):
        def _sock_recv(self, bufsize: int) -> bytes:
            if bufsize > PACKET_BYTES_MAX:
                log.warning(
                    "the broker sends a packet of %d bytes; at most %d are taken",
                    bufsize,
                    PACKET_BYTES_MAX,
                )
                raise ConnectionError("a packet is too large")
            return super()._sock_recv(bufsize)

    return Bounded


class _Connection:
    """A client of the broker.

    Raises `MqttError` if the first connection fails; a later one that is lost is made again, for as
    long as it takes.
    """

    def __init__(self, at: Broker) -> None:
        self._at = at
        self._ready = threading.Event()
        """Connected for the first time, or refused."""
        self._refused: str | None = None
        self._client: Client

    def close(self) -> None:
        """Disconnect."""
        self._client.on_disconnect = None
        self._client.disconnect()
        self._client.loop_stop()

    def _connect(self) -> None:
        """By MQTT 5, or by 3.1.1 where the broker does not speak 5."""
        from paho.mqtt.enums import MQTTProtocolVersion

        self._dial(MQTTProtocolVersion.MQTTv5)
        if self._refused in (UNSUPPORTED, CLOSED):
            self.close()
            self._dial(MQTTProtocolVersion.MQTTv311)
        if not self._ready.is_set() or self._refused == CLOSED:
            self.close()
            raise MqttError(f"{self._at.host}:{self._at.port} does not answer as an MQTT broker")
        if self._refused is not None:
            self.close()
            raise MqttError(f"{self._at.host}:{self._at.port} refuses: {self._refused}")

    def _dial(self, protocol: MQTTProtocolVersion) -> None:
        """Wait for an answer, for `CONNECT_SECONDS`."""
        from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
        from paho.mqtt.packettypes import PacketTypes
        from paho.mqtt.properties import Properties

        at, properties = self._at, None
        if protocol == MQTTProtocolVersion.MQTTv5:
            properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
            properties.MaximumPacketSize = PACKET_BYTES_MAX
        self._ready.clear()
        self._refused = None
        self._client = client = _bounded()(CallbackAPIVersion.VERSION2, protocol=protocol)
        client.on_connect, client.on_disconnect = self._on_connect, self._on_disconnect
        client.reconnect_delay_set(1, RETRY_SECONDS_MAX)
        client.connect_timeout = CONNECT_SECONDS
        if at.user is not None:
            client.username_pw_set(at.user, at.password)
        self._prepare(client)
        try:
            if at.tls:
                client.tls_set(at.ca)
            client.connect(at.host, at.port, KEEPALIVE_SECONDS, properties=properties)
        except (OSError, ValueError) as error:
            raise MqttError(f"cannot reach {at.host}:{at.port}: {error}") from None
        client.loop_start()
        self._ready.wait(CONNECT_SECONDS)

    def _prepare(self, client: Client) -> None:
        """What a client needs before it connects."""
        raise NotImplementedError

    def _joined(self) -> None:
        """Connected, for the first time or again."""
        raise NotImplementedError

    def _on_connect(self, _: Client, __: Any, ___: Any, code: ReasonCode, ____: Any) -> None:
        if code.is_failure:
            self._tell(str(code))
        else:
            self._joined()

    def _tell(self, refusal: str) -> None:
        """At the start it ends the program; later on it is said, and tried again."""
        if self._ready.is_set():
            log.warning("%s:%d refuses: %s", self._at.host, self._at.port, refusal)
            return
        self._refused = refusal
        self._ready.set()

    def _on_disconnect(self, _: Client, __: Any, ___: Any, code: ReasonCode, ____: Any) -> None:
        if (
            not self._ready.is_set()
        ):  # so some brokers answer to a version of MQTT that they do not speak
            self._tell(CLOSED)
        elif self._refused is None:
            log.warning("lost %s:%d (%s); trying again", self._at.host, self._at.port, code)


class Messages(_Connection):
    """What comes under one topic below the broker's prefix, oldest first, until told to stop. What
    was published while there was no connection is missing. Raises `MqttError`.
    """

    def __init__(self, source: Broker, topic: str, limit_messages: int = MESSAGES_MAX) -> None:
        super().__init__(source)
        self.topic = f"{source.prefix}/{topic}"
        self.dropped = 0
        """Messages that found ``limit_messages`` others waiting."""
        self._waiting: queue.Queue[bytes] = queue.Queue(limit_messages)
        self._mutex = threading.Lock()
        self._waiting_bytes = 0
        self._connect()

    def read(self, stop: threading.Event) -> Iterator[bytes]:
        """The messages, until ``stop`` is set."""
        while not stop.is_set():
            try:
                message = self._waiting.get(timeout=_TICK_SECONDS)
            except queue.Empty:
                continue
            with self._mutex:
                self._waiting_bytes -= len(message)
            yield message

    def close(self) -> None:
        """Disconnect, and say what was dropped."""
        super().close()
        if self.dropped:
            log.warning("%d messages of %s were dropped", self.dropped, self.topic)

    def _prepare(self, client: Client) -> None:
        client.on_subscribe, client.on_message = self._on_subscribe, self._on_message

    def _joined(self) -> None:
        self._client.subscribe(self.topic, qos=1)

    def _on_subscribe(
        self, _: Client, __: Any, ___: int, codes: list[ReasonCode], ____: Any
    ) -> None:
        failed = [str(code) for code in codes if code.is_failure]
        if failed:
            self._tell(f"{self.topic}: {failed[0]}")
            return
        log.info("hearing %s at %s:%d", self.topic, self._at.host, self._at.port)
        self._ready.set()

    def _on_message(self, _: Client, __: Any, message: MQTTMessage) -> None:
        payload = bytes(message.payload)
        with self._mutex:
            full = f"{self._waiting.maxsize}" if self._waiting.full() else ""
            if self._waiting_bytes + len(payload) > WAITING_BYTES_MAX:
                full = f"{WAITING_BYTES_MAX} bytes"
            if not full:
                self._waiting.put_nowait(payload)  # nothing else puts
                self._waiting_bytes += len(payload)
                return
        self.dropped += 1
        if self.dropped == 1:
            log.warning(
                "messages come faster than they are read; those beyond %s are dropped", full
            )


class Board(_Connection):
    """Retained messages, one a topic. ``availability`` is a topic that says ``online`` as long as
    this program is there and the broker reaches it, and ``offline`` otherwise. Raises `MqttError`.

    What is sent when the connection breaks may be lost, so everything is sent again with the next
    one; a quality of service above 0 would then bring back what is out of date.
    """

    def __init__(self, target: Broker, availability: str) -> None:
        super().__init__(target)
        self._availability = availability
        self._mutex = threading.Lock()
        self._said: dict[str, str] = {}
        self._connect()

    def show(self, messages: Mapping[str, str]) -> None:
        """Publish what is not known to be there, by topic; what cannot be sent now is sent with the
        next call.
        """
        with self._mutex:
            for topic, text in messages.items():
                if self._client.is_connected() and self._said.get(topic) != text:
                    self._client.publish(topic, text, retain=True)
                    self._said[topic] = text

    def close(self) -> None:
        """Say so and disconnect."""
        if self._client.is_connected():
            told = self._client.publish(self._availability, OFFLINE, qos=1, retain=True)
            told.wait_for_publish(LEAVE_SECONDS)
        super().close()

    def _prepare(self, client: Client) -> None:
        client.will_set(self._availability, OFFLINE, qos=1, retain=True)

    def _joined(self) -> None:
        """Whatever the broker still has of before, it is told everything anew."""
        with self._mutex:
            self._said.clear()
        self._client.publish(self._availability, ONLINE, qos=1, retain=True)
        log.info("publishing below %s at %s:%d", self._at.prefix, self._at.host, self._at.port)
        self._ready.set()
