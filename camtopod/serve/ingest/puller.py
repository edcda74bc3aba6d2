"""Ask publishers' spools for missing events: when a gap appears, and at intervals."""

from __future__ import annotations

import concurrent.futures
import itertools
import logging
import math
import re
import threading
import time
from collections.abc import Callable

from camtopod import codec
from camtopod.config import Limits
from camtopod.records import CAMERA_PATTERN
from camtopod.serve.bus import Bus, QueryError
from camtopod.serve.ingest.admission import SpoolAnswer
from camtopod.serve.outbox import SpoolBatch
from camtopod.serve.runtime import Heartbeat, Rejects

log = logging.getLogger(__name__)

_ASKING_AT_ONCE = 4
"""Number of spools asked at the same time."""
_GAP_PULLS_SECONDS = 0.1
"""Shortest time between two rounds of questions when gaps appear."""
_ROUNDS_MAX = 20
"""Most answers of one spool in a row, until other spools have their turn."""
_BOOT = re.compile(CAMERA_PATTERN)
"""Boots that a query can name.

For any other boot, the spool is asked for its oldest events, which gives the same in the end.
"""


class Puller:
    """Pulls missing events from spools.

    wanted: gives for a camera the (boot, seq) from which to ask, or None.
    deliver: takes an answer; returns False to refuse it.
    poke: set to pull at once.
    daemon: name of this daemon.
    """

    def __init__(
        self,
        bus: Bus,
        limits: Limits,
        wanted: Callable[[str], tuple[str, int] | None],
        deliver: Callable[[SpoolAnswer], bool],
        poke: threading.Event,
        rejects: Rejects,
        daemon: str = "",
    ) -> None:
        self._daemon = daemon
        self._bus, self._limits = bus, limits
        self._wanted, self._deliver = wanted, deliver
        self._poke = poke
        self._mutex = threading.Lock()
        # When each camera being asked was asked last, by the monotonic clock; infinity: not yet.
        self._asking: dict[str, float] = {}
        self.alive: set[str] = set()
        """Cameras whose publisher is present."""
        self.pulls = 0
        """Number of answers received."""
        self._rejects = rejects

    def on_alive(self, camera: str, alive: bool) -> None:
        """Take note that a publisher has appeared or vanished. Called from a thread of the bus."""
        with self._mutex:
            (self.alive.add if alive else self.alive.discard)(camera)
        if alive:
            self._poke.set()

    def set_limits(self, limits: Limits) -> None:
        """Use other limits from now on. Any thread."""
        self._limits = limits

    def work(self, stopping: threading.Event, mark: Heartbeat | None = None) -> None:
        """Pull until ``stopping``.

        mark: shows a stall if a query never ends.
        """
        with concurrent.futures.ThreadPoolExecutor(_ASKING_AT_ONCE, "pull") as pool:
            while not stopping.is_set():
                with self._mutex:
                    cameras = self.alive - self._asking.keys()
                    self._asking |= dict.fromkeys(cameras, math.inf)
                    oldest = min(self._asking.values(), default=math.inf)
                if mark is not None:
                    mark.beat_as_of(oldest)
                for camera in sorted(cameras):
                    pool.submit(self._pull, camera, stopping).add_done_callback(_complain)
                self._poke.wait(self._limits.pull_seconds)
                self._poke.clear()
                stopping.wait(_GAP_PULLS_SECONDS)
            pool.shutdown(wait=False, cancel_futures=True)

    def _pull(self, camera: str, stopping: threading.Event) -> None:
        """Ask a camera's spool until it has no more, or for `_ROUNDS_MAX` answers."""
        try:
            question = self._wanted(camera) or ("", 0)
            for _ in range(_ROUNDS_MAX):
                following = None if stopping.is_set() else self._ask(camera, *question)
                if following is None:
                    return
                question = following
            self._poke.set()  # the spool has more
        finally:
            with self._mutex:
                self._asking.pop(camera, None)

    def _ask(self, camera: str, boot: str, start: int) -> tuple[str, int] | None:
        """Ask once; return what to ask next at once, or None."""
        with self._mutex:
            self._asking[camera] = time.monotonic()

        # Ask from the wanted seq on, in the stream's boot if it can be named.
        if not _BOOT.match(boot):
            boot, start = "", 0
        most = self._limits.pull_events_max
        given: dict[str, object] = {"from": start, "max": most, "daemon": self._daemon}
        try:
            answers = self._bus.query(f"spool/{camera}", given | ({"boot": boot} if boot else {}))
        except QueryError as error:
            self._rejects.add("spool-refuses", f"spool/{camera}", str(error))
            return None

        # Deliver the answers; the next question follows the last event of an answer with more.
        following = None
        for _, payload in answers:
            self.pulls += 1
            try:
                batch = read_batch(payload, camera, most)
            except codec.Rejected as error:
                self._rejects.add(error.reason, f"spool/{camera}", str(error), payload)
                continue
            delivered = self._deliver(SpoolAnswer(batch, start if batch.boot == boot else -1))
            if (
                delivered
                and batch.more
                and batch.events
                and (batch.boot != boot or batch.events[-1][0] >= start)
            ):
                following = (batch.boot, batch.events[-1][0] + 1)
        return following


def read_batch(payload: bytes, camera: str, most: int) -> SpoolBatch:
    """Return the answer of a camera's spool, of at most ``most`` events.

    Raises `codec.Rejected`, also for an answer that contradicts itself.
    """
    batch = codec.read(SpoolBatch, payload, pack=True)
    if batch.camera != camera:
        raise codec.Rejected("wrong-camera", f"answers for camera {batch.camera!r}")
    seqs = [seq for seq, _ in batch.events]
    if len(seqs) > most:
        raise codec.Rejected("bad-batch", f"{len(seqs)} events, asked for {most}")
    if any(seq >= following for seq, following in itertools.pairwise(seqs)):
        raise codec.Rejected("bad-batch", "its events are not by rising seq")
    if seqs and batch.first > seqs[0]:
        raise codec.Rejected("bad-batch", "it begins behind its first event")
    return batch


def _complain(pull: concurrent.futures.Future[None]) -> None:
    """Log an unexpected error of a pull."""
    if not pull.cancelled() and (error := pull.exception()) is not None:
        log.error("pulling from a spool failed", exc_info=error)
