"""Subscribe to an MQTT broker, or publish to it. Only this module uses paho-mqtt.

That package is an extra (``[mqtt]``).
"""

from __future__ import annotations

import logging
import queue
import sys
import threading
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote, urlsplit

from msgspec import Struct

from camtopod.redact import redact, remember

if TYPE_CHECKING:
    from paho.mqtt.client import Client, MQTTMessage
    from paho.mqtt.reasoncodes import ReasonCode

log = logging.getLogger(__name__)

PORTS = {"mqtt": 1883, "mqtts": 8883}
"""Usual ports by the URL's scheme; mqtts is TLS."""
WAITING_BYTES_MAX = 32 * 1024**2
"""Most bytes of messages that wait to be read; further messages are dropped and counted."""
PACKET_BYTES_MAX = 2 * 1024**2
"""Largest packet, in bytes, that the broker may send; lines of all formats are shorter."""
CONNECT_SECONDS = 10.0
"""Longest time for the first connection, in seconds."""
ONLINE = "online"
"""Payload of an availability topic while the program runs."""
OFFLINE = "offline"
"""Payload of it otherwise."""


class MqttError(Exception):
    """The broker cannot be reached or refuses the connection; ``str()`` gives the reason."""


class Broker(Struct, frozen=True):
    """The address of a broker, and how to log in.

    prefix: the topic levels before a program's own topics, without a slash at the end.
    """

    host: str
    port: int
    tls: bool
    prefix: str
    user: str | None = None
    password: str | None = None
    ca: str | None = None
    """Path of the certificate authorities to trust; None for the system's."""


def broker(
    url: str, password: str | None = None, ca: str | None = None, prefix: str = ""
) -> Broker:
    """Return the broker of a URL ``mqtt[s]://[USER@]HOST[:PORT]/PREFIX``.

    password: of the URL's user.
    ca: path of the certificate authorities to trust; None for the system's.
    prefix: used if the URL has none. Where there is none, a level of PREFIX may be ``+``, for any.

    Raises `ValueError`, also if the URL contains a password.
    """

    remember(url)
    parts = urlsplit(url)
    if parts.password is not None:
        raise ValueError(
            "others on this machine can read a password on the command line: put it in a file"
        )
    path = unquote(parts.path).strip("/")
    wrong = any("+" in level and (prefix or level != "+") for level in path.split("/"))
    prefix = path or prefix
    wildcard = wrong or "#" in url + path or parts.query
    if parts.scheme not in PORTS or not parts.hostname or not prefix or wildcard:
        raise ValueError(
            f"{redact(url)!r}: write it like mqtt://HOST:1883/PREFIX, or mqtts:// for TLS; PREFIX "
            "is that of the program's topics, for example frigate"
        )

    user = unquote(parts.username or "") or None
    if password is not None:
        if user is None:
            raise ValueError("a password needs a user: put the name and an @ before the host")
        remember(f"mqtt://{user}:{password}@")
    port = parts.port or PORTS[parts.scheme]
    return Broker(parts.hostname, port, parts.scheme == "mqtts", prefix, user, password, ca)


class _BrokerConnection:
    """A client of the broker, which reconnects by itself.

    Raises `MqttError` if the first connection fails.
    """

    def __init__(self, at: Broker) -> None:
        from paho.mqtt.client import Client
        from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion
        from paho.mqtt.packettypes import PacketTypes
        from paho.mqtt.properties import Properties

        # MQTT 5, where the broker keeps larger packets back.
        self._at = at
        self._ready = threading.Event()
        """Set when the first connection is made or refused."""
        self._refusal = ""
        properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
        properties.MaximumPacketSize = PACKET_BYTES_MAX
        self._client = client = Client(
            CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv5
        )
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.reconnect_delay_set(1, 60)
        client.connect_timeout = CONNECT_SECONDS
        if at.user is not None:
            client.username_pw_set(at.user, at.password)
        self._prepare(client)

        # Connect, and wait for the broker's answer.
        try:
            if at.tls:
                client.tls_set(at.ca)
            client.connect(at.host, at.port, keepalive=30, properties=properties)
        except (OSError, ValueError) as error:
            raise MqttError(f"cannot reach {at.host}:{at.port}: {error}") from None
        client.loop_start()
        if not self._ready.wait(CONNECT_SECONDS):
            self._refusal = "does not answer as an MQTT broker"
        if self._refusal:
            self._leave()
            raise MqttError(f"{at.host}:{at.port} {self._refusal}")

    def _prepare(self, client: Client) -> None:
        """Set up a client before it connects."""

    def _joined(self) -> None:
        """React to a connection, the first one or a later one."""

    def _leave(self) -> None:
        """Disconnect."""
        self._client.on_disconnect = None
        self._client.disconnect()
        self._client.loop_stop()

    def _on_connect(self, _: Client, __: Any, ___: Any, code: ReasonCode, ____: Any) -> None:
        """React to the broker's answer. Called from paho's thread, as all that follow are."""
        if code.is_failure:
            self._fail(f"refuses: {code}")
        else:
            self._joined()

    def _on_disconnect(self, _: Client, __: Any, ___: Any, code: ReasonCode, ____: Any) -> None:
        if self._ready.is_set() and not self._refusal:
            log.warning("lost %s:%d (%s); trying again", self._at.host, self._at.port, code)
        else:
            self._fail("does not answer as an MQTT broker")

    def _fail(self, refusal: str) -> None:
        """Report a refusal: to the caller at the start, later in the log (paho retries then)."""
        if not self._ready.is_set():
            self._refusal = refusal
            self._ready.set()
        elif not self._refusal:
            log.warning("%s:%d %s", self._at.host, self._at.port, refusal)


class MessageSubscription(_BrokerConnection):
    """The messages of one topic below the broker's prefix, oldest first.

    Retained messages, which tell of earlier, are none of them.

    with_topics: put each message's topic and a blank in front of it, as `mosquitto_sub -v` does.

    Messages that are published while there is no connection are missing. Raises `MqttError`.
    """

    def __init__(self, source: Broker, topic: str, with_topics: bool = False) -> None:
        self.topic = f"{source.prefix}/{topic}"
        self.dropped_count = 0
        """Number of messages dropped because too many bytes were waiting."""
        self._with_topics = with_topics
        self._messages: queue.Queue[bytes] = queue.Queue()
        self._mutex = threading.Lock()
        self._waiting_bytes = 0
        super().__init__(source)

    def read(self, stop: threading.Event, ticks: bool = False) -> Iterator[bytes]:
        """Yield the messages until ``stop`` is set.

        ticks: yield an empty one, too, while none comes.
        """
        while not stop.is_set():
            try:
                message = self._messages.get(timeout=0.2)
            except queue.Empty:
                if ticks:
                    yield b""
                continue
            with self._mutex:
                self._waiting_bytes -= sys.getsizeof(message)
            yield message

    def close(self) -> None:
        """Disconnect, and log how many messages were dropped."""
        self._leave()
        if self.dropped_count:
            log.warning("%d messages of %s were dropped", self.dropped_count, self.topic)

    def _prepare(self, client: Client) -> None:
        client.on_subscribe = self._on_subscribe
        client.on_message = self._on_message

    def _joined(self) -> None:
        from paho.mqtt.subscribeoptions import SubscribeOptions

        options = SubscribeOptions(qos=1, retainHandling=SubscribeOptions.RETAIN_DO_NOT_SEND)
        self._client.subscribe(self.topic, options=options)

    def _on_subscribe(
        self, _: Client, __: Any, ___: int, codes: list[ReasonCode], ____: Any
    ) -> None:
        if codes[0].is_failure:
            self._fail(f"refuses: {self.topic}: {codes[0]}")
            return
        log.info("subscribed to %s at %s:%d", self.topic, self._at.host, self._at.port)
        self._ready.set()

    def _on_message(self, _: Client, __: Any, message: MQTTMessage) -> None:
        if message.retain:  # of a broker that sends them nevertheless
            return
        payload = bytes(message.payload)
        if self._with_topics:
            try:
                payload = message.topic.encode() + b" " + payload
            except UnicodeDecodeError:  # of a broker that lets any through; no format has one
                return
        with self._mutex:
            if self._waiting_bytes + sys.getsizeof(payload) <= WAITING_BYTES_MAX:
                self._messages.put(payload)
                self._waiting_bytes += sys.getsizeof(payload)
                return
        self.dropped_count += 1
        if self.dropped_count == 1:
            log.warning("messages come faster than they are read: some are dropped")


class RetainedMessages(_BrokerConnection):
    """Retained messages, one for each topic, and others that are not retained.

    availability: a topic that is ``online`` while this program runs and the broker reaches it, and
        ``offline`` otherwise.

    Messages may be lost when the connection breaks, so all are sent again with the next one. A
    quality of service above 0 would then bring back outdated ones. Raises `MqttError`.
    """

    def __init__(self, target: Broker, availability: str) -> None:
        self._availability = availability
        self._mutex = threading.Lock()
        self._texts: dict[str, str] = {}
        super().__init__(target)

    def show(self, messages: Mapping[str, str]) -> None:
        """Publish the messages (text by topic) that differ from the published ones.

        Messages that cannot be sent now are sent with the next call.
        """
        with self._mutex:
            for topic, text in messages.items():
                if self._client.is_connected() and self._texts.get(topic) != text:
                    # The broker answers to the first one, which never changes.
                    self._client.publish(topic, text, qos=0 if self._texts else 1, retain=True)
                    self._texts[topic] = text

    def tell(self, messages: Mapping[str, str]) -> None:
        """Publish messages that are not retained; without a connection they are lost."""
        if self._client.is_connected():
            for topic, text in messages.items():
                self._client.publish(topic, text)

    def close(self) -> None:
        """Publish ``offline`` and disconnect."""
        if self._client.is_connected():
            last = self._client.publish(self._availability, OFFLINE, qos=1, retain=True)
            last.wait_for_publish(2.0)
        self._leave()

    def _prepare(self, client: Client) -> None:
        client.will_set(self._availability, OFFLINE, qos=1, retain=True)
        client.on_publish = self._on_publish

    def _on_publish(self, _: Client, __: Any, ___: int, code: ReasonCode, ____: Any) -> None:
        if code.is_failure:
            log.warning(
                "%s:%d refuses messages (%s): the user must be allowed to write below %s, and "
                "below the discovery prefix",
                self._at.host,
                self._at.port,
                code,
                self._at.prefix,
            )

    def _joined(self) -> None:
        """Appear as online, and have the next `show` publish everything again."""
        with self._mutex:
            self._texts.clear()
        self._client.publish(self._availability, ONLINE, qos=1, retain=True)
        log.info("publishing below %s at %s:%d", self._at.prefix, self._at.host, self._at.port)
        self._ready.set()
