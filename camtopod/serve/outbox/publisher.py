"""Publish events without losing any: store them in the spool, publish them, answer queries."""

from __future__ import annotations

import functools
import logging
import sqlite3
import threading
from collections.abc import Callable, Sequence

from camtopod import codec
from camtopod.records import Ack, Event
from camtopod.serve.bus import Bus, QueryError
from camtopod.serve.outbox.spool import Spool, SpoolBatch
from camtopod.serve.runtime import Rejects, clock
from camtopod.serve.storage import StateError

log = logging.getLogger(__name__)

PENDING_EVENTS_MAX = 10_000
"""Most events kept in memory while the spool cannot be written (disk full).

Beyond it the newest are dropped.
"""
SEQ_MAX = 2**63 - 1
"""Largest sequence number."""
NAME_CHARACTERS_MAX = 64
"""Longest part of a daemon's name that is used, in characters."""


class Publisher:
    """Publish the events of some cameras. Call `publish` and `retry` from one thread.

    spool: belongs to the caller, who closes the bus before it.
    limit_batch_events: most events stored in one transaction.
    on_ack: called with each acknowledgement, from a thread of the bus.

    Without a bus, events wait in the spool until `attach`. `publish` and `retry` raise
    `sqlite_file.Damaged`.
    """

    def __init__(
        self, spool: Spool, limit_batch_events: int, on_ack: Callable[[Ack], None] | None = None
    ) -> None:
        self._spool, self.on_ack = spool, on_ack
        self._box = clock.machine_id().encode()
        self._bus: Bus | None = None
        self._batch_max = limit_batch_events
        self._pending: list[Event] = []
        self._introduced: set[str] = set()
        self._acked = threading.Condition()
        self._unwritable = False
        self.rejects = Rejects()
        """Acknowledgements and queries that were rejected."""
        self.published = 0
        """Events stored in the spool (and published, if there is a bus) since the start."""
        self.dropped = 0
        """Events lost because the spool could not be written for too long."""

    def attach(self, bus: Bus, cameras: Sequence[str] = ()) -> None:
        """From now on publish on ``bus``, for these cameras and for those with events in the spool.

        Further cameras are added with their first event.
        """
        for camera in {*cameras, *self._spool.cameras()}:
            self._introduce(bus, camera)
        self._bus = bus

    def publish(self, *events: Event) -> None:
        """Store events in the spool and publish them.

        A spool that cannot be written is logged once, and tried again with the next events.
        """
        room = PENDING_EVENTS_MAX - len(self._pending)
        self._pending.extend(events[:room])
        self.dropped += max(0, len(events) - room)
        self.retry()

    def retry(self) -> None:
        """Store and publish the events that could not be stored yet; cheap if there are none."""
        while self._pending:
            batch = self._pending[: self._batch_max]

            # Store a batch, or keep it in memory.
            try:
                numbered = self._spool.append(batch)
            except sqlite3.Error as error:
                if not self._unwritable:
                    self._unwritable = True
                    log.error("cannot write the spool: %s; events wait in memory", error)
                return
            if self._unwritable:
                self._unwritable = False
                log.info("the spool can be written again")

            # Publish the batch.
            del self._pending[: self._batch_max]
            self.published += len(numbered)
            if self._bus is not None:
                for event in numbered:
                    self._introduce(self._bus, event.camera)
                    self._bus.publish_raw(
                        f"event/{event.camera}", codec.to_msgpack(event), "event", self._box
                    )

    def wait_acknowledged(self, seconds: float, most: int = 0) -> bool:
        """Wait until at most ``most`` events are unacknowledged; return False after ``seconds``."""
        with self._acked:
            return self._acked.wait_for(lambda: self.unacknowledged <= most, seconds)

    @property
    def unacknowledged(self) -> int:
        """Number of events that are not known to be stored by a daemon."""
        return len(self._spool) + len(self._pending)

    def statistics(self) -> dict[str, int]:
        """Return counters for the status."""
        return {
            **self._spool.statistics(),
            "published": self.published,
            "unacknowledged": self.unacknowledged,
            "dropped": self.dropped + self._spool.dropped,
            "rejected": self.rejects.counts.total(),
        }

    def _introduce(self, bus: Bus, camera: str) -> None:
        """Answer for a camera's spool, receive its acknowledgements, and appear on the bus."""
        if camera not in self._introduced:
            self._introduced.add(camera)
            bus.answer_queries(
                f"spool/{camera}", functools.partial(self._answer, bus.endpoint), "spool"
            )
            bus.subscribe(f"ack/{camera}", functools.partial(self._on_ack, bus.endpoint))
            bus.announce("grabber", camera)

    def _answer(self, endpoint: str, key: str, parameters: dict[str, str]) -> SpoolBatch:
        """Answer a query for events of a camera, from the seq ``from`` of the boot ``boot`` on."""
        try:
            start, most = int(parameters.get("from", "0")), int(parameters.get("max", "1000"))
        except ValueError:
            raise self._refusal(key, parameters, "from and max are whole numbers") from None
        if not -1 <= start <= SEQ_MAX:
            raise self._refusal(key, parameters, "from is not a sequence number")
        camera = key.removeprefix("spool/")
        try:
            self._spool.note_daemon(parameters.get("daemon", "")[:NAME_CHARACTERS_MAX], endpoint)
            return self._spool.batch(
                camera, parameters.get("boot"), start, max(1, min(most, 10_000))
            )
        except (sqlite3.Error, StateError) as error:
            raise QueryError(f"the spool cannot be read: {error}") from None

    def _refusal(self, key: str, parameters: dict[str, str], what: str) -> QueryError:
        """Count a malformed query, and return the error to answer with."""
        self.rejects.add("bad-question", key, what, str(parameters))
        return QueryError(what)

    def _on_ack(self, endpoint: str, key: str, payload: bytes) -> None:
        """Check an acknowledgement and pass it to the spool."""
        try:
            ack = codec.read(Ack, payload, pack=True)
            if ack.camera != key.removeprefix("ack/"):
                raise codec.Rejected("wrong-camera", f"says camera {ack.camera!r}")
            if not 0 <= ack.seq <= SEQ_MAX:
                raise codec.Rejected("bad-value", "seq is not a sequence number")
            self._spool.note_daemon(ack.daemon[:NAME_CHARACTERS_MAX], endpoint)
            if not self._spool.ack(ack.camera, ack.boot, ack.seq):
                raise codec.Rejected("beyond", "seq is above the highest one of this boot")
            if self.on_ack is not None:
                self.on_ack(ack)
        except codec.Rejected as error:
            self.rejects.add(error.reason, key, str(error), payload)
            return
        except (sqlite3.Error, StateError) as error:
            log.debug("cannot write the spool: %s; the ack will come again", error)
            return
        with self._acked:
            self._acked.notify_all()
