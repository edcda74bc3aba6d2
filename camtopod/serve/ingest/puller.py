"""Asks the publishers' spools for what has not arrived: at a gap, when one appears, and once a
second.
"""

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
from camtopod.serve.ingest.receiver import Pulled
from camtopod.serve.outbox import SpoolBatch
from camtopod.serve.runtime import Mark, Rejects

log = logging.getLogger(__name__)

_ASKING_AT_ONCE = 4
_GAP_PULLS_SECONDS = 0.1
_ROUNDS_MAX = 20
"""Answers taken in a row from one spool before it is another's turn."""
_BOOT = re.compile(CAMERA_PATTERN)
"""A boot that can be asked for; for another the spool is asked what is oldest, which comes to the
same in the end.
"""


class Puller:
    """``wanted(camera)``: the (boot, seq) to ask from, or None; ``deliver`` takes an answer, or
    refuses; ``daemon``: its name.
    """

    def __init__(
        self,
        bus: Bus,
        limits: Limits,
        wanted: Callable[[str], tuple[str, int] | None],
        deliver: Callable[[Pulled], bool],
        poke: threading.Event,
        rejects: Rejects,
        daemon: str = "",
    ) -> None:
        self._daemon = daemon
        self._bus, self._limits = bus, limits
        self._wanted, self._deliver = wanted, deliver
        self._poke = poke
        self._mutex = threading.Lock()
        self._asking: dict[
            str, float
        ] = {}  # camera -> when its last question was put; infinity: not yet
        self.alive: set[str] = set()
        """Cameras whose publisher is there."""
        self.pulls = 0
        self._rejects = rejects

    def on_alive(self, camera: str, alive: bool) -> None:
        """A publisher appeared or vanished; from a thread of the bus."""
        with self._mutex:
            (self.alive.add if alive else self.alive.discard)(camera)
        if alive:
            self._poke.set()

    def use(self, limits: Limits) -> None:
        """Obey other limits from now on. Any thread."""
        self._limits = limits

    def work(self, stopping: threading.Event, mark: Mark | None = None) -> None:
        """Pull until ``stopping``. A question that never ends shows in ``mark``."""
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
        try:
            question = self._wanted(camera) or ("", 0)
            for _ in range(_ROUNDS_MAX):
                following = None if stopping.is_set() else self._ask(camera, *question)
                if following is None:
                    return
                question = following
            self._poke.set()  # there is more
        finally:
            with self._mutex:
                self._asking.pop(camera, None)

    def _ask(self, camera: str, boot: str, start: int) -> tuple[str, int] | None:
        """Ask once; returns what to ask next at once, or None."""
        with self._mutex:
            self._asking[camera] = time.monotonic()
        if not _BOOT.match(boot):
            boot, start = "", 0
        most = self._limits.pull_events_max
        given: dict[str, object] = {"from": start, "max": most, "daemon": self._daemon}
        try:
            answers = self._bus.ask(f"spool/{camera}", given | ({"boot": boot} if boot else {}))
        except QueryError as error:
            self._rejects.add("spool-refuses", f"spool/{camera}", str(error))
            return None
        following = None
        for _, payload in answers:
            self.pulls += 1
            try:
                batch = read_batch(payload, camera, most)
            except codec.Rejected as error:
                self._rejects.add(error.reason, f"spool/{camera}", str(error), payload)
                continue
            delivered = self._deliver(Pulled(batch, start if batch.boot == boot else -1))
            if (
                delivered
                and batch.more
                and batch.events
                and (batch.boot != boot or batch.events[-1][0] >= start)
            ):
                following = (batch.boot, batch.events[-1][0] + 1)
        return following


def read_batch(payload: bytes, camera: str, most: int) -> SpoolBatch:
    """The answer of a camera's spool, of at most ``most`` events. Raises `codec.Rejected` also for
    one that contradicts itself.
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
    if not pull.cancelled() and (error := pull.exception()) is not None:
        log.error("pulling from a spool failed", exc_info=error)
