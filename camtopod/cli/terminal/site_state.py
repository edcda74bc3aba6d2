"""What `camtopod watch` knows at the moment: filled by the bus's threads, and put into words for
whoever draws it.
"""

from __future__ import annotations

import re
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from msgspec import Struct

from camtopod import codec
from camtopod.predict import seen_now
from camtopod.records import CAMERA_PATTERN, Alarm, Link, Prediction, Topology

PREDICTIONS_KEPT = 30
ALARMS_SHOWN = 5
NEXT_SHOWN = 3
SILENT_SECONDS = 5.0
"""Who has not been heard for longer has gone, whatever the last word was; they speak every
second.
"""
_FINE = ("running", "ended", "no grabber", "unknown")
"""The last two are cameras of another program, whose events come in without a word of its own."""


class _Said(Struct, frozen=True):
    """What a camera's process says of itself."""

    state: str = ""
    reason: str = ""


class _Counted(Struct, frozen=True):
    """What the daemon says of a camera."""

    events: int = 0
    newest: float | None = None
    alive: bool = False


class _Events(Struct, frozen=True):
    stored: int = 0
    duplicate: int = 0


class _DaemonSaid(_Said, frozen=True):
    """What the daemon says."""

    events: _Events = _Events()
    rejects: dict[str, int] = {}
    cameras: dict[str, _Counted] = {}


class CameraLine(NamedTuple):
    """A camera; ``last``: seconds since its newest event, None where there is none."""

    name: str
    state: str
    reason: str
    events: int
    last: float | None

    @property
    def wrong(self) -> bool:
        """Whether somebody should look at it."""
        return self.state not in _FINE


class View(NamedTuple):
    """A moment. ``state`` and ``reason`` are the daemon's; ``now``: seconds since the epoch."""

    site: str
    now: float
    state: str
    reason: str
    counts: str
    cameras: list[CameraLine]
    topology: Topology | None
    predictions: list[Prediction]
    """The newest first."""


class Board:
    """Statuses and predictions as they come. ``steady``: a clock that does not step, for who has
    been silent.
    """

    def __init__(self, steady: Callable[[], float] = time.monotonic) -> None:
        self._steady = steady
        self._mutex = threading.Lock()
        self._daemon: tuple[float, _DaemonSaid] | None = None
        self._status: dict[str, tuple[float, _Said]] = {}
        """By camera. Each with when it was said."""
        self._predictions: deque[Prediction] = deque(maxlen=PREDICTIONS_KEPT)

    def on_status(self, key: str, payload: bytes) -> None:
        """A publication on ``status/...``. One that does not fit changes nothing."""
        name = key.removeprefix("status/")
        if not re.match(CAMERA_PATTERN, name):
            return
        try:
            if name == "daemon":
                daemon = codec.read(_DaemonSaid, payload, pack=True)
                with self._mutex:
                    self._daemon = self._steady(), daemon
            else:
                said = codec.read(_Said, payload, pack=True)
                with self._mutex:
                    self._status[name] = self._steady(), said
        except codec.Rejected:
            return

    def on_prediction(self, key: str, payload: bytes) -> None:
        """A publication on ``prediction/{camera}``."""
        try:
            prediction = codec.read(Prediction, payload, pack=True)
        except codec.Rejected:
            return
        with self._mutex:
            self._predictions.append(prediction)

    @property
    def empty(self) -> bool:
        """Whether no status has come yet."""
        with self._mutex:
            return self._daemon is None and not self._status

    def view(self, topology: Topology | None, site: str, now: float) -> View:
        """What there is to see now; ``now`` in seconds since the epoch."""
        with self._mutex:
            status, said, predictions = dict(self._status), self._daemon, list(self._predictions)
        steady = self._steady()
        heard, daemon = said or (steady, _DaemonSaid())
        state, reason = daemon.state, daemon.reason
        if steady - heard > SILENT_SECONDS:
            state, reason = (
                "silent",
                f"not heard for {steady - heard:.0f} s; what is below may be old",
            )
        known = daemon.cameras
        cameras = [
            _camera(name, status.get(name), known.get(name, _Counted()), now, steady)
            for name in {*status, *known}
        ]
        return View(
            site, now, state, reason, _counts(daemon), sorted(cameras), topology, predictions[::-1]
        )


def _camera(
    name: str, status: tuple[float, _Said] | None, known: _Counted, now: float, steady: float
) -> CameraLine:
    """``status``: when it spoke itself and what it said; ``known``: what the daemon says of it."""
    heard, said = status or (steady, _Said())
    state, reason = said.state, said.reason
    if not state:
        state = "unknown" if known.alive else "no grabber"
    elif state != "ended" and steady - heard > SILENT_SECONDS:
        state, reason = "silent", f"not heard for {steady - heard:.0f} s"
    last = None if known.newest is None or not 0 <= now - known.newest < 1e6 else now - known.newest
    return CameraLine(name, state, reason, known.events, last)


def _counts(daemon: _DaemonSaid) -> str:
    """What it has taken in, and what not."""
    events = daemon.events
    return f"{events.stored} events stored, {events.duplicate} duplicates, {sum(daemon.rejects.values())} rejected"


def daemon_line(view: View) -> str:
    """Who the daemon is and how it is."""
    if not view.state:
        return f"site {view.site}: no daemon has said anything yet"
    because = f" ({view.reason})" if view.reason else ""
    return f"site {view.site}: daemon {view.state}{because}, {view.counts}"


def topology_lines(topology: Topology | None) -> list[str]:
    """What has been learned, and how good its predictions were."""
    if topology is None:
        return ["topology: nothing learned yet"]
    lines = [
        f"topology: version {topology.version}, {topology.events} events, {len(topology.cameras)} cameras, "
        f"{len(topology.zones)} zones, {len(topology.links)} links, {topology.digest[:19]}"
    ]
    if (s := topology.score) is not None:
        lines.append(
            f"predictions: next camera right {s.top1:.2f} (the usual one {s.baseline_top1:.2f}), among three "
            f"{s.top3:.2f}, log loss {s.log_loss:.2f} ({s.baseline_log_loss:.2f}); "
            f"{s.exits} exits since version {s.since_version}"
        )
    return lines


def newest_alarms(topology: Topology | None) -> list[Alarm]:
    """The newest first, at most `ALARMS_SHOWN`."""
    return list(
        reversed(((topology.alarms if topology is not None else None) or [])[-ALARMS_SHOWN:])
    )


def alarm_line(alarm: Alarm, now: float) -> str:
    """One alarm."""
    return f"{(now - alarm.t) / 60:.0f} min ago, version {alarm.version}: {alarm.kind} {alarm.subject}, {alarm.detail}"


def busiest_links(topology: Topology | None) -> list[Link]:
    """Those between views, the busiest first."""
    links = (
        [link for link in topology.links if link.relation != "visible"]
        if topology is not None
        else []
    )
    return sorted(links, key=lambda link: -link.transitions)


def transit(link: Link) -> str:
    """How long the way takes: the median, and what four of five take."""
    return f"{link.transit.q50:.1f} ({link.transit.q10:.1f} to {link.transit.q90:.1f}) s"


def prediction_line(prediction: Prediction) -> str:
    """Where somebody has left, which cameras see them at that moment, and where to look next."""
    seen = [
        f"now in view of {one.camera} {one.probability:.2f}"
        for one in seen_now(prediction.in_view or [])
    ]
    following = ", ".join(
        f"{following.zone} {following.probability:.2f} in {following.q10:.0f} to {following.q90:.0f} s"
        for following in prediction.next_[:NEXT_SHOWN]
    )
    if not seen and not following:
        return f"{prediction.zone or prediction.camera} -> next camera unknown"
    return f"{prediction.zone or prediction.camera} -> {'; '.join([*seen, following] if following else seen)}"
