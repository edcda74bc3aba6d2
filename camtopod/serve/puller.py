"""Asks the publishers' spools for what has not arrived: at a gap, when one appears, and once a second."""

from __future__ import annotations

import concurrent.futures
import logging
import math
import threading
import time
from collections.abc import Callable

from camtopod import codec
from camtopod.config import Limits
from camtopod.serve.bus import Bus, QueryError
from camtopod.serve.progress import Mark
from camtopod.serve.receiver import Pulled
from camtopod.serve.spool import SpoolBatch

log = logging.getLogger(__name__)

_ASKING_AT_ONCE = 4
_GAP_PULLS_SECONDS = 0.1
_ROUNDS_MAX = 1000
"""Answers taken in a row from one spool before it is another's turn."""


class Puller:
    """``wanted(camera)``: the (boot, seq) to ask from, or None; ``deliver`` takes an answer, or refuses."""

    def __init__(
        self,
        bus: Bus,
        limits: Limits,
        wanted: Callable[[str], tuple[str, int] | None],
        deliver: Callable[[Pulled], bool],
        poke: threading.Event,
    ) -> None:
        self._bus, self._limits = bus, limits
        self._wanted, self._deliver = wanted, deliver
        self._poke = poke
        self._mutex = threading.Lock()
        self._asking: dict[str, float] = {}  # camera -> when its last question was put; infinity: not yet
        self.alive: set[str] = set()
        """Cameras whose publisher is there."""
        self.pulls = 0

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
        finally:
            with self._mutex:
                self._asking.pop(camera, None)

    def _ask(self, camera: str, boot: str, start: int) -> tuple[str, int] | None:
        """Ask once; returns what to ask next at once, or None."""
        with self._mutex:
            self._asking[camera] = time.monotonic()
        given: dict[str, object] = {"from": start, "max": self._limits.pull_events_max}
        try:
            answers = self._bus.ask(f"spool/{camera}", given | ({"boot": boot} if boot else {}))
        except QueryError as error:
            log.warning("the spool of camera %s: %s", camera, error)
            return None
        following = None
        for _, payload in answers:
            self.pulls += 1
            try:
                batch = codec.read(SpoolBatch, payload, pack=True)
            except codec.Rejected as error:
                log.warning("the spool of camera %s gave an answer that cannot be read: %s", camera, error)
                continue
            if batch.camera != camera:
                log.warning("the spool of camera %s answered for camera %s", camera, batch.camera)
                continue
            delivered = self._deliver(Pulled(batch, start if batch.boot == boot else -1))
            if delivered and batch.more and batch.events:
                following = (batch.boot, batch.events[-1][0] + 1)
        return following


def _complain(pull: concurrent.futures.Future[None]) -> None:
    if not pull.cancelled() and (error := pull.exception()) is not None:
        log.error("pulling from a spool failed", exc_info=error)
