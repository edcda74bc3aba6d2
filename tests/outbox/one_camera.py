"""A grabber of one camera and the daemons of its sites in simulated time, with faults everywhere."""

from __future__ import annotations

import heapq
import itertools
import math
import random
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from camtopod import codec
from camtopod.records import Event
from camtopod.serve.outbox.delivery import Delivery
from camtopod.serve.outbox.spool import Spool
from camtopod.serve.requests import Answer

FAULTS = (
    "restart",
    "outage",
    "older journal",
    "erased journal",
    "new boot",
    "flapping",
    "damage",
    "burst",
    "busy",
    "slow",
    "held",
    "cut",
    "older spool",
    "lost number",
    "slow network",
    "replay",
)
SET_BACK = ("older journal", "erased journal")
"""Faults that set the daemon's machine back."""
NOT_BESIDE = {
    "older spool": ("damage", *SET_BACK),
    "lost number": SET_BACK,
}
"""Fault -> those that do not happen beside it.

What the daemon has counted as lost stays so, though an older copy of the spool that still has it
comes back. And a history has no snapshots: of events that the journal has deleted ("lost number")
it cannot tell whether the learner of an older journal knows them.
"""
FAULTS_SECONDS = 600.0
"""Time in which faults happen."""
END_SECONDS = FAULTS_SECONDS + 4000.0
CAMERA = "lobby"
SPOOL_EVENTS = 240
KEPT_EVENTS = 60


class Side:
    """A site of the camera: its daemon, and the delivery to it."""

    def __init__(self, world: World, site: str) -> None:
        self.world = world
        self.site = site
        self.linked = False
        self.until = world.until
        self.chance = world.chance
        self.at = world.at
        self.daemon: Any

    @property
    def now(self) -> float:
        return self.world.now

    def start_delivery(self) -> None:
        """Deliver the present grabber's spool."""
        assert self.world.spool is not None
        numbers = (f"n{self.world.grabber}-{count}" for count in itertools.count())
        queue = self.world.spool.queue(self.site)
        self.delivery = Delivery(CAMERA, queue, lambda: next(numbers))
        self.look()

    def look(self) -> None:
        """Send what is to be sent now, and come again when the delivery asks for it."""
        request = self.delivery.next_request(self.now)
        if self.delivery.deadline < math.inf:
            self.at(
                max(self.delivery.deadline, self.now + 0.001), self._look_again, self.world.grabber
            )
        if request is None:
            return
        self.world.requests += 1
        grabber, delivery = self.world.grabber, self.delivery

        def answered(answer: Answer | None) -> None:
            if grabber == self.world.grabber:
                delivery.on_answer(request, answer, self.now)
                self.look()

        def reply(answer: Answer) -> None:
            if not self._loses():
                raw = codec.to_msgpack(answer)
                self.at(self._arrival(), answered, codec.read(Answer, raw, pack=True))

        if not self.linked:
            self.at(self.now + 0.01, answered, None)
        elif not self._loses():
            self.at(self._arrival(), self.daemon.receive, codec.to_msgpack(request), reply)

    def _look_again(self, grabber: int) -> None:
        if grabber == self.world.grabber and self.now >= self.delivery.deadline:
            self.look()

    def _loses(self) -> bool:
        return self.now < FAULTS_SECONDS and self.chance.random() < self.world.lossy

    def _arrival(self) -> float:
        slow = self.now < self.until["slow network"] and self.chance.random() < 0.3
        return self.now + 0.01 + (self.chance.uniform(0, 400) if slow else 0.0)

    def appear(self) -> None:
        """Show the daemon's token to the grabber."""
        if self.daemon.up:
            self.linked = True
            self.delivery.on_daemon(self.now)
            self.look()

    @property
    def is_calm(self) -> bool:
        return self.daemon.up and self.linked and self.delivery.deadline == math.inf

    def wrongs(self, dropped: int) -> list[str]:
        """Return what went wrong here.

        dropped: events that may be lost.
        """
        assert self.world.spool is not None
        wrongs = []
        stored = {uid for _, _, uid in self.daemon.journal}
        rows = self.world.spool._db.execute("SELECT raw FROM event WHERE raw != x'00'")
        spooled = [int(str(codec.event_from_bytes(raw).track)) for (raw,) in rows]
        lost = [uid for uid in spooled if uid not in stored]
        if len(lost) > dropped:
            wrongs.append(f"{len(lost)} events lost {self.site}")
        kept = Counter(uid for _, _, uid in self.daemon.kept)
        for where, counts in (("in the journal", kept), ("learned", self.daemon.counted)):
            if twice := [uid for uid, count in counts.items() if count > 1]:
                wrongs.append(f"{len(twice)} events twice {where} {self.site}")
        uids = list(dict.fromkeys(uid for _, _, uid in self.daemon.journal))
        if uids != sorted(uids) and "older spool" not in self.world.kinds:
            wrongs.append(f"order {self.site}")
        return wrongs


class World:
    """One history: events, faults and everything that follows from them.

    sites: the sites of the camera, as the spool names them.
    """

    def __init__(
        self,
        seed: int,
        folder: Path,
        kinds: list[str] | None = None,
        sites: tuple[str, ...] = ("",),
    ) -> None:
        self.chance = random.Random(seed)
        self.kinds = kinds or self.chance.sample(FAULTS, self.chance.randint(1, 5))
        without = {kind for fault in self.kinds for kind in NOT_BESIDE.get(fault, ())}
        self.kinds = [kind for kind in self.kinds if kind not in without]
        self.lossy = self.chance.choice([0.0, 0.0, 0.02, 0.2])
        self.now = 0.0
        self.until = dict.fromkeys(("busy", "slow", "held", "slow network"), -1.0)
        self.calm_at: float | None = None
        self.requests = 0
        self.uid = 0
        self._dropped = 0  # events that the spool has deleted, as it was full
        self._path = folder / "spool.db"
        self._image = folder / "image.db"
        self._boots = itertools.count(1)
        self._heap: list[tuple[float, int, Callable[..., None], tuple[object, ...]]] = []
        self._order = itertools.count()
        self.grabber = 0
        self.spool: Spool | None = None
        self.sides = [Side(self, site) for site in sites]

    def at(self, t: float, step: Callable[..., None], *given: object) -> None:
        heapq.heappush(self._heap, (t, next(self._order), step, given))

    def start_grabber(self, kill: bool = True) -> None:
        """End the grabber, by force or not, and start it again."""
        if self.spool is not None and kill:
            self.spool._db.close()
            self.spool._lock.close()
        elif self.spool is not None:
            self.spool.close()
        if self.spool is not None:
            self._dropped += self.spool.dropped
        self.grabber += 1
        boot = f"b{next(self._boots)}"
        sites = [side.site for side in self.sides]
        self.spool = Spool(
            self._path, boot, SPOOL_EVENTS, kept_max=KEPT_EVENTS, sites_of=lambda camera: sites
        )
        for side in self.sides:
            side.start_delivery()

    def add(self) -> None:
        """Let the grabber see one event more."""
        assert self.spool is not None
        self.uid += 1
        self.spool.append([Event(CAMERA, "entry", float(self.uid), track=str(self.uid))])
        for side in self.sides:
            side.look()

    def fault(self) -> None:
        """Let one fault happen, and plan the next."""
        if self.now > FAULTS_SECONDS:
            return
        assert self.spool is not None
        chance = self.chance
        self.at(self.now + chance.expovariate(1 / 15), self.fault)
        kind = chance.choice(self.kinds)
        side = self.sides[0] if len(self.sides) == 1 else chance.choice(self.sides)
        rows = len(side.daemon.journal)
        if kind in ("restart", "replay"):
            side.daemon.stop(1.0)
        elif kind == "outage":
            side.daemon.stop(chance.uniform(3, 90))
        elif kind == "older journal" and side.daemon.up:
            side.daemon.go_back(chance.randint(rows // 3, rows))
        elif kind == "erased journal" and side.daemon.up:
            side.daemon.go_back(0)
        elif kind == "new boot":
            self.start_grabber(kill=chance.random() < 0.5)
        elif kind == "flapping":
            for _ in range(chance.randint(3, 8)):
                self.start_grabber()
                self.add()
        elif kind == "damage":
            self._damage()
        elif kind == "burst":
            for _ in range(chance.randint(5, 60)):
                self.add()
        elif kind == "cut" and side.daemon.up and side.linked:
            side.linked = False
            self.at(self.now + chance.uniform(0.5, 20), side.appear)
        elif kind == "older spool":
            self._restore()
        elif kind == "lost number" and side.daemon.numbers and side.daemon.up:
            side.daemon.lose_number(chance.choice(list(side.daemon.numbers)))
        elif kind in self.until:
            self.until[kind] = self.now + chance.uniform(1, 60)

    def _damage(self) -> None:
        """Flip the bytes of one event in the spool."""
        assert self.spool is not None
        self.spool._db.execute(
            "UPDATE event SET raw = x'00' WHERE id ="
            " (SELECT id FROM event ORDER BY id LIMIT 1 OFFSET ?)",
            (self.chance.randrange(SPOOL_EVENTS),),
        )

    def _restore(self) -> None:
        """Keep a copy of the spool, or go back to the one that was kept."""
        assert self.spool is not None
        if not self._image.exists():
            self.spool._db.execute("VACUUM INTO ?", (str(self._image),))
            return
        self.spool.close()
        self._image.replace(self._path)
        self.start_grabber()

    def live(self, rate: float, until: float) -> None:
        """Add events at a rate."""
        if self.now <= until:
            self.add()
            self.at(self.now + self.chance.expovariate(rate), self.live, rate, until)

    def run(self) -> list[str]:
        """Run the history; return what went wrong."""
        self.start_grabber()
        for side in self.sides:
            self.at(0.0, side.daemon.start)
        self.at(5.0, self.fault)
        self.at(0.0, self.live, self.chance.choice([0.02, 0.1, 0.5]), FAULTS_SECONDS)
        if self.chance.random() < 0.5:
            self.at(FAULTS_SECONDS, self.live, 0.02, FAULTS_SECONDS + 500)
        steps = 0
        while self._heap and self._heap[0][0] < END_SECONDS:
            t, _, step, given = heapq.heappop(self._heap)
            self.now = max(self.now, t)
            step(*given)
            steps += 1
            if steps > 60_000:
                return ["storm"]
            if self.calm_at is None and self.now > FAULTS_SECONDS and self._is_calm():
                self.calm_at = self.now
        return self._wrongs()

    def _is_calm(self) -> bool:
        assert self.spool is not None
        return not self.spool.waiting() and all(side.is_calm for side in self.sides)

    def _wrongs(self) -> list[str]:
        assert self.spool is not None
        wrongs = []
        if left := self.spool.waiting():
            wrongs.append(f"{left} events wait at the end")
        dropped = self._dropped * ("older spool" in self.kinds)  # a copy may still have them
        return wrongs + [wrong for side in self.sides for wrong in side.wrongs(dropped)]
