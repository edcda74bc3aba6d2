"""Delivery of a spool's events to the daemon of one site, by a session and a thread of its own."""

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
from camtopod.serve.outbox.site_queue import SiteQueue
from camtopod.serve.requests import ANSWER_SECONDS_MAX, Answer, Batch, Hello
from camtopod.serve.runtime import Rejects, clock
from camtopod.serve.storage import StateError, sqlite_file

log = logging.getLogger(__name__)

_UNANSWERED = "the daemon is there and does not answer: it is older than this program"


class SiteDelivery:
    """The deliveries of all cameras in ``queue`` on ``bus``, until `close`.

    rejects: counts answers that could not be read.
    change: the condition that is notified whenever something may have changed.
    """

    def __init__(
        self, queue: SiteQueue, bus: Bus, rejects: Rejects, change: threading.Condition
    ) -> None:
        self.queue = queue
        self.bus = bus
        self.damage: StateError | None = None
        """Damage of the spool, if there is any; then nothing more is sent of that camera."""
        self._rejects = rejects

        # What callbacks leave for the delivering thread.
        self._change = change
        self._due: set[str] = set()
        self._answers: list[tuple[str, Hello | Batch, bytes | None]] = []
        self._daemon_appeared = False
        self._daemons: set[str] = set()
        self._closing = False

        # The delivering thread's own.
        self._deliveries: dict[str, Delivery] = {}
        self._deadlines: dict[str, float] = {}
        self._thread = threading.Thread(target=self._deliver, name="deliver", daemon=True)

    def start(self, cameras: Sequence[str] = ()) -> None:
        """Deliver from now on, for these cameras and for those with events in the spool."""
        for camera in {*cameras, *self.queue.cameras()}:
            self.introduce(camera)
        self.bus.watch_alive("daemon", self._on_daemon)
        self._thread.start()

    def publish(self, event: Event) -> None:
        """Publish an event that was just stored in the spool, for predictions."""
        event = replace(self.queue.numbered(event), spooled=True)
        self.bus.publish_raw(
            f"event/{event.camera}", codec.to_msgpack(event), "event", droppable=True
        )

    def outcome(self) -> tuple[int, int]:
        """Return how many events of this process were late, and how many refused."""
        deliveries = list(self._deliveries.copy().values())
        return (
            sum(delivery.late for delivery in deliveries),
            sum(delivery.refusals for delivery in deliveries),
        )

    def _own(self) -> list[Delivery]:
        """Return the deliveries of cameras of which this process was given events."""
        return [
            delivery
            for delivery in self._deliveries.copy().values()
            if self.queue.is_own(delivery.camera)
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

        With certificates the reason is that this program's is not for these cameras.
        """
        silent = [
            delivery.camera for delivery in self._own() if delivery.failures >= UNANSWERED_MAX
        ]
        return silent if self.sees_daemon else []

    @property
    def unanswered_reason(self) -> str:
        """Why requests get no answer from a daemon that is there."""
        if not self.bus.endpoint.startswith("tls/"):
            return f"{_UNANSWERED}, upgrade it"
        return f"{_UNANSWERED}, or this program's certificate is not for this camera"

    def close(self) -> None:
        """End the delivery; may be called twice."""
        with self._change:
            self._closing = True
            self._change.notify_all()
        if self._thread.is_alive():
            self._thread.join()

    def introduce(self, camera: str) -> None:
        """Deliver the events of a camera from now on, or have its delivery look for new ones."""
        with self._change:
            exists = camera in self._deliveries
            if not exists:
                self._deliveries[camera] = Delivery(
                    camera, self.queue, lambda: clock.ulid(clock.wall())
                )
            self._due.add(camera)
            self._change.notify_all()
        if not exists:
            self.bus.announce("grabber", camera)

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
            self.damage = damage
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
                self._rejects.add(error.reason, f"store/{camera}", str(error), payload)
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
        if request is None:
            return

        def on_answer(payload: bytes | None) -> None:
            with self._change:
                self._answers.append((camera, request, payload))
                self._change.notify_all()

        self.bus.ask(f"store/{camera}", codec.to_msgpack(request), ANSWER_SECONDS_MAX, on_answer)
