"""Publish events without losing any: store them in the spool, and deliver them to the daemon."""

from __future__ import annotations

import logging
import math
import sqlite3
import threading
import time
from collections.abc import Callable, Sequence

from msgspec.structs import replace

from camtopod import codec
from camtopod.records import Event
from camtopod.serve.bus import Bus
from camtopod.serve.outbox.delivery import RETRY_SECONDS, UNANSWERED_MAX, Delivery
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.requests import ANSWER_SECONDS_MAX, Answer, Batch, Hello
from camtopod.serve.runtime import Rejects, clock
from camtopod.serve.storage import StateError, sqlite_file

log = logging.getLogger(__name__)

PENDING_EVENTS_MAX = 10_000
"""Most events kept in memory while the spool cannot be written (disk full).

Beyond it the newest are dropped.
"""
TRANSACTION_EVENTS_MAX = 5_000
"""Most events stored in one transaction when many come at once, some hundredths of a second."""
_UNANSWERED = "the daemon is there and does not answer: it is older than this program"


class Publisher:
    """Publish the events of some cameras. Call `publish` and `retry` from one thread.

    spool: belongs to the caller, who closes this publisher before the bus and the spool.
    live: the events happen now: publish each for predictions. Those of a recording are only
        delivered.

    Without a bus, events wait in the spool until `attach`. `publish` and `retry` raise
    `sqlite_file.Damaged`.
    """

    def __init__(self, spool: Spool, live: bool = True) -> None:
        self._spool = spool
        self._live = live
        self._bus: Bus | None = None
        self._pending: list[Event] = []
        self._unwritable = False
        self._drops = 0
        self.published = 0
        """Events stored in the spool since the start; those that were in it already do not count.
        """
        self.rejects = Rejects()
        """Answers that could not be read."""

        # What callbacks leave for the delivering thread.
        self._change = threading.Condition()
        self._due: set[str] = set()
        self._answers: list[tuple[str, Hello | Batch, bytes | None]] = []
        self._daemon_appeared = False
        self._daemons: set[str] = set()
        self._closing = False

        # The delivering thread's own.
        self._deliveries: dict[str, Delivery] = {}
        self._deadlines: dict[str, float] = {}
        self._damage: StateError | None = None
        self._thread = threading.Thread(target=self._deliver, name="deliver", daemon=True)

    def attach(self, bus: Bus, cameras: Sequence[str] = ()) -> None:
        """From now on publish on ``bus``, for these cameras and for those with events in the spool.

        Further cameras are added with their first event. Call it once.
        """
        self._bus = bus
        for camera in {*cameras, *self._spool.cameras()}:
            self._introduce(bus, camera)
        bus.watch_alive("daemon", self._on_daemon)
        self._thread.start()

    def publish(self, *events: Event) -> None:
        """Store events in the spool and publish them.

        A spool that cannot be written is logged once, and tried again with the next events.
        """
        room = PENDING_EVENTS_MAX - len(self._pending)
        self._pending.extend(events[:room])
        self._drops += max(0, len(events) - room)
        self.retry()

    def retry(self) -> None:
        """Store and publish the events that could not be stored yet; cheap if there are none."""
        if self._damage is not None:
            raise self._damage
        while self._pending:
            # Store a batch, or keep it in memory.
            try:
                batch = self._spool.append(self._pending[:TRANSACTION_EVENTS_MAX])
            except sqlite3.Error as error:
                if not self._unwritable:
                    self._unwritable = True
                    log.error("cannot write the spool: %s; events wait in memory", error)
                return
            if self._unwritable:
                self._unwritable = False
                log.info("the spool can be written again")
            del self._pending[:TRANSACTION_EVENTS_MAX]
            self.published += len(batch)

            # Have it delivered, and publish it for viewers.
            if self._bus is not None:
                for camera in {event.camera for event in batch}:
                    self._introduce(self._bus, camera)
                for event in batch if self._live else ():
                    self._bus.publish_raw(
                        f"event/{event.camera}",
                        codec.to_msgpack(replace(event, spooled=True)),
                        "event",
                        droppable=True,
                    )

    def wait_stored(self, seconds: float, limit: int = 0, own: bool = False) -> bool:
        """Wait until at most ``limit`` events wait; return False if not within ``seconds``.

        own: count only those of boots of which this process was given events.
        """
        with self._change:
            return self._change.wait_for(lambda: self.count_waiting(own) <= limit, seconds)

    def count_waiting(self, own: bool = False) -> int:
        """Return the number of events that are not known to be stored by the daemon.

        own: as for `wait_stored`.
        """
        return self._spool.waiting(own=own) + len(self._pending)

    @property
    def waiting(self) -> int:
        """Number of events that are not known to be stored by the daemon."""
        return self.count_waiting()

    def outcome(self) -> tuple[int, int]:
        """Return how many events of this process came too late to be learned, and were refused."""
        deliveries = list(self._deliveries.copy().values())
        refusals = self._spool.rejects.counts.total() + sum(
            delivery.refusals for delivery in deliveries
        )
        return sum(delivery.late for delivery in deliveries), refusals

    def _own(self) -> list[Delivery]:
        """Return the deliveries of cameras of which this process was given events."""
        return [
            delivery
            for delivery in self._deliveries.copy().values()
            if self._spool.is_own(delivery.camera)
        ]

    def own_cameras_without_room(self) -> dict[str, str]:
        """Return this process's cameras that are too many for the daemon, each with its reason."""
        return {delivery.camera: delivery.no_room for delivery in self._own() if delivery.no_room}

    def own_reason(self) -> str:
        """Return why the daemon takes nothing of this process's cameras; "" if it does."""
        return next((delivery.reason for delivery in self._own() if delivery.reason), "")

    @property
    def sees_daemon(self) -> bool:
        """True if a daemon of the site is on the bus."""
        return bool(self._daemons)

    def own_cameras_unanswered(self) -> list[str]:
        """Return this process's cameras for which a daemon that is there does not answer.

        Where programs have certificates, this one's is not for these cameras.
        """
        silent = [
            delivery.camera for delivery in self._own() if delivery.failures >= UNANSWERED_MAX
        ]
        return silent if self.sees_daemon else []

    @property
    def unanswered_reason(self) -> str:
        """Why requests get no answer from a daemon that is there."""
        if self._bus is None or not self._bus.endpoint.startswith("tls/"):
            return f"{_UNANSWERED}, upgrade it"
        return f"{_UNANSWERED}, or this program's certificate is not for this camera"

    def drop(self, camera: str) -> None:
        """Delete the events of a camera that wait in the spool, and count them as dropped."""
        self._spool.drop(camera)

    @property
    def dropped(self) -> int:
        """Events lost as the spool was full or could not be written, or by `drop`."""
        return self._drops + self._spool.dropped

    def statistics(self) -> dict[str, int]:
        """Return counters for the status."""
        counters = self._spool.statistics()
        return {
            **counters,
            "published": self.published,
            "waiting": counters["waiting"] + len(self._pending),
            "dropped": self.dropped,
            "rejected": self.rejects.counts.total(),
        }

    def close(self) -> None:
        """End the delivery; may be called twice."""
        with self._change:
            self._closing = True
            self._change.notify_all()
        if self._thread.is_alive():
            self._thread.join()

    def _introduce(self, bus: Bus, camera: str) -> None:
        """Deliver the events of a camera from now on, or have its delivery look for new ones."""
        with self._change:
            exists = camera in self._deliveries
            if not exists:
                self._deliveries[camera] = Delivery(
                    camera, self._spool, lambda: clock.ulid(clock.wall())
                )
            self._due.add(camera)
            self._change.notify_all()
        if not exists:
            bus.announce("grabber", camera)

    def _on_daemon(self, name: str, alive: bool) -> None:
        """Note that a daemon has appeared or vanished; called on a thread of the bus."""
        if alive:
            self._daemons.add(name)
            with self._change:
                self._daemon_appeared = True
                self._change.notify_all()
        else:
            self._daemons.discard(name)

    def _deliver(self) -> None:
        """Send requests and take answers until the end."""
        while True:
            # Wait for something to do.
            with self._change:
                while not self._closing:
                    now = time.monotonic()
                    due = {*self._due, *(c for c, at in self._deadlines.items() if at <= now)}
                    if due or self._answers or self._daemon_appeared:
                        break
                    first = min(self._deadlines.values(), default=math.inf)
                    self._change.wait(min(first - now, threading.TIMEOUT_MAX))
                if self._closing:
                    return
                answers = self._answers
                is_new_daemon = self._daemon_appeared
                self._answers = []
                self._daemon_appeared = False
                self._due.clear()

            # Pass answers to the deliveries, and send the next requests.
            if is_new_daemon:
                due.update(self._deliveries)
                for delivery in self._deliveries.copy().values():
                    delivery.on_daemon(now)
            for camera, request, payload in answers:
                if self._guard(camera, self._take, self._deliveries[camera], request, payload):
                    self._guard(camera, self._send, self._deliveries[camera])
            for camera in due:
                self._guard(camera, self._send, self._deliveries[camera])
            with self._change:
                self._change.notify_all()

    def _guard(self, camera: str, step: Callable[..., None], *arguments: object) -> bool:
        """Carry out a step of a delivery; return False if it is tried again later.

        That is so if the spool cannot be used, unless it is damaged.
        """
        try:
            step(*arguments)
            return True
        except sqlite_file.Damaged as damage:
            self._damage = damage
            self._deadlines[camera] = math.inf
        except (sqlite3.Error, StateError) as error:
            log.debug("cannot use the spool: %s", error)
            self._deadlines[camera] = time.monotonic() + RETRY_SECONDS
        return False

    def _take(self, delivery: Delivery, request: Hello | Batch, payload: bytes | None) -> None:
        """Take the answer to a request."""
        camera = delivery.camera
        answer: Answer | None = None
        if payload is not None:
            try:
                answer = codec.read(Answer, payload, pack=True)
            except codec.Rejected as error:
                self.rejects.add(error.reason, f"store/{camera}", str(error), payload)
        was_full = any(peer.no_room for peer in self._deliveries.copy().values())
        delivery.on_answer(request, answer, time.monotonic())
        if delivery.no_room and not was_full:  # of many cameras the first one
            log.error("%s", delivery.no_room)
        if delivery.failures == UNANSWERED_MAX and self.sees_daemon:
            log.error("camera %s: %s", camera, self.unanswered_reason)

    def _send(self, delivery: Delivery) -> None:
        """Send the next request of a camera, if there is one."""
        camera = delivery.camera
        request = delivery.next_request(time.monotonic())
        self._deadlines[camera] = delivery.deadline
        if request is None or self._bus is None:
            return

        def on_answer(payload: bytes | None) -> None:
            with self._change:
                self._answers.append((camera, request, payload))
                self._change.notify_all()

        self._bus.ask(f"store/{camera}", codec.to_msgpack(request), ANSWER_SECONDS_MAX, on_answer)
