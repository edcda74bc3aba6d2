"""State of the site as `camtopod watch` shows it: filled by the bus's threads, put into words."""

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
from camtopod.publishers import is_gone
from camtopod.records import CAMERA_PATTERN, Alarm, Link, NextCamera, Prediction, Topology
from camtopod.topology import links_between_views, links_in_words, waiting_for_links

PREDICTIONS_KEPT = 30
"""Newest predictions that are kept."""
ALARMS_SHOWN = 5
"""Newest alarms that are shown."""
NEXT_SHOWN = 3
"""Likeliest next zones that are shown of a prediction."""
SILENT_SECONDS = 5.0
"""Time without a status after which its sender counts as silent; statuses come every second."""
_FINE = ("running", "ended", "no grabber", "unknown", "gone")
"""States that need no attention.

"gone" is a camera without a grabber, and without events for `camtopod.publishers.GONE_SECONDS`.
"no grabber" and "unknown" are cameras of another program, which sends events but no status.
"""


class _Said(Struct, frozen=True):
    """Status that a camera's process publishes."""

    state: str = ""
    reason: str = ""


class _Counted(Struct, frozen=True):
    """Counters of one camera in the daemon's status."""

    events: int = 0
    newest: float | None = None
    alive: bool = False


class _Events(Struct, frozen=True):
    """Counters of all events in the daemon's status."""

    stored: int = 0


class _CatchingUp(Struct, frozen=True):
    """How far the learner is behind: event time in seconds, and the share that is learned."""

    seconds: float = 0.0
    share: float = 0.0


class _Names(Struct, frozen=True):
    """Forgotten names, and the present names of renamed cameras, in the daemon's status."""

    forgotten: dict[str, int] = {}
    renamed: dict[str, str] = {}


class _DaemonSaid(_Said, frozen=True):
    """Status that the daemon publishes."""

    events: _Events = _Events()
    rejects: dict[str, int] = {}
    catching_up: _CatchingUp | None = None
    cameras: dict[str, _Counted] = {}
    names: _Names = _Names()


class CameraLine(NamedTuple):
    """One camera; ``last``: seconds since its newest event, None if there is none."""

    name: str
    state: str
    reason: str
    events: int
    last: float | None

    @property
    def wrong(self) -> bool:
        """Return True if the camera needs attention."""
        return self.state not in _FINE


class SiteView(NamedTuple):
    """State of the site at one moment.

    ``state`` and ``reason`` are the daemon's; ``now`` is in seconds since the epoch.
    """

    site: str
    now: float
    state: str
    reason: str
    counts: str
    cameras: list[CameraLine]
    topology: Topology | None
    predictions: list[Prediction]
    """Newest first."""


class SiteState:
    """Collects statuses and predictions as they arrive; thread-safe.

    steady: monotonic clock in seconds, to notice senders that are silent.
    """

    def __init__(self, steady: Callable[[], float] = time.monotonic) -> None:
        self._steady = steady
        self._mutex = threading.Lock()
        self._daemon: tuple[float, _DaemonSaid] | None = None
        self._status: dict[str, tuple[float, _Said]] = {}
        """Camera -> (time of arrival, status)."""
        self._predictions: deque[Prediction] = deque(maxlen=PREDICTIONS_KEPT)

    def on_status(self, key: str, payload: bytes) -> None:
        """Store a status published on ``status/...``; a malformed one is ignored."""
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
        """Store a prediction published on ``prediction/{camera}``; a malformed one is ignored."""
        try:
            prediction = codec.read(Prediction, payload, pack=True)
        except codec.Rejected:
            return
        with self._mutex:
            self._predictions.append(prediction)

    @property
    def empty(self) -> bool:
        """Return True if no status has arrived yet."""
        with self._mutex:
            return self._daemon is None and not self._status

    def view(self, topology: Topology | None, site: str, now: float) -> SiteView:
        """Return the state at ``now`` (seconds since the epoch)."""
        with self._mutex:
            status, said, predictions = dict(self._status), self._daemon, list(self._predictions)

        # State of the daemon.
        steady = self._steady()
        heard, daemon = said or (steady, _DaemonSaid())
        state, reason = daemon.state, daemon.reason
        if steady - heard > SILENT_SECONDS:
            state, reason = (
                "silent",
                f"no status for {steady - heard:.0f} s; what is shown below may be outdated",
            )

        # State of the cameras: those learned of, those with a status and those that are counted.
        known = {**_learned(topology), **daemon.cameras}
        cameras = [
            _camera(name, status.get(name), known.get(name, _Counted()), now, steady)
            for name in {*status, *known}
        ]
        newest = max((one.newest or 0.0 for one in known.values()), default=0.0)
        cameras = [
            _as_named(_or_gone(one, known.get(one.name), newest), daemon.names) for one in cameras
        ]
        return SiteView(
            site, now, state, reason, _counts(daemon), sorted(cameras), topology, predictions[::-1]
        )


def _camera(
    name: str, status: tuple[float, _Said] | None, known: _Counted, now: float, steady: float
) -> CameraLine:
    """Return the line of one camera.

    status: (time of arrival, status) from its own process, or None.
    known: the daemon's counters of the camera.
    """
    heard, said = status or (steady, _Said())
    state, reason = said.state, said.reason
    if not state:
        state = "unknown" if known.alive else "no grabber"
    elif state != "ended" and steady - heard > SILENT_SECONDS:
        state, reason = "silent", f"no status for {steady - heard:.0f} s"
    last = None if known.newest is None or not 0 <= now - known.newest < 1e6 else now - known.newest
    return CameraLine(name, state, reason, known.events, last)


def _learned(topology: Topology | None) -> dict[str, _Counted]:
    """Return the time of the last event of each camera of a topology."""
    if topology is None:
        return {}
    last = (
        {} if topology.model is None else {m.camera: m.last_event for m in topology.model.cameras}
    )
    return {camera.id: _Counted(newest=last.get(camera.id)) for camera in topology.cameras}


def _or_gone(camera: CameraLine, known: _Counted | None, newest: float) -> CameraLine:
    """Return the line of a camera, with the state "gone" if it is.

    newest: time of the newest event of all cameras.
    """
    last = None if known is None else known.newest
    gone = is_gone(camera.state, last, newest)
    return camera._replace(state="gone", reason="") if gone else camera


def _as_named(camera: CameraLine, names: _Names) -> CameraLine:
    """Return the line of a camera, with a note if its name was forgotten or renamed."""
    if camera.name in names.forgotten:
        cure = f"its events are refused until camtopod forget --take-back {camera.name}"
        return camera._replace(state="forgotten", reason=cure)
    if (present := names.renamed.get(camera.name)) is not None and not camera.wrong:
        return camera._replace(reason=f"counts as {present}")
    return camera


def _counts(daemon: _DaemonSaid) -> str:
    """Return the daemon's counters of events, and how far the learner is behind, in words."""
    events = daemon.events
    rejected = sum(daemon.rejects.values())
    stored = f"{events.stored} events stored, {rejected} rejected since its start"
    if (behind := daemon.catching_up) is None:
        return stored
    return f"catching up, {behind.share:.0%} ({behind.seconds / 60:.0f} minutes behind), {stored}"


def daemon_line(view: SiteView) -> str:
    """Return one line with site, state and counters of the daemon."""
    if not view.state:
        return f"site {view.site}: no status of a daemon received yet"
    because = f" ({view.reason})" if view.reason else ""
    return f"site {view.site}: daemon {view.state}{because}, {view.counts}"


def topology_lines(topology: Topology | None) -> list[str]:
    """Return lines about the newest topology and the score of its predictions."""
    if topology is None:
        return ["topology: nothing learned yet; the first version comes a minute after ten events"]
    links = len(links_between_views(topology))
    lines = [
        f"topology: version {topology.version}, {topology.events} events, "
        f"{len(topology.cameras)} cameras, {len(topology.zones)} zones, "
        f"{links_in_words(links)}, {topology.digest[:19]}"
    ]
    if waiting := waiting_for_links(topology):
        lines.append(waiting)
    if (s := topology.score) is not None:
        lines.append(
            f"predictions: next camera right {s.top1:.2f} (baseline {s.baseline_top1:.2f}), "
            f"among the first three {s.top3:.2f}, "
            f"log loss {s.log_loss:.2f} (baseline {s.baseline_log_loss:.2f}); "
            f"{s.exits} exits since version {s.since_version}"
        )
    return lines


def newest_alarms(topology: Topology | None) -> list[Alarm]:
    """Return at most `ALARMS_SHOWN` alarms, newest first."""
    return list(
        reversed(((topology.alarms if topology is not None else None) or [])[-ALARMS_SHOWN:])
    )


def alarm_line(alarm: Alarm, now: float) -> str:
    """Return one alarm in words; ``now`` in seconds since the epoch."""
    return (
        f"{(now - alarm.t) / 60:.0f} min ago, version {alarm.version}: "
        f"{alarm.kind} {alarm.subject}, {alarm.detail}"
    )


def busiest_links(topology: Topology | None) -> list[Link]:
    """Return the links between views, busiest first."""
    links = [] if topology is None else links_between_views(topology)
    return sorted(links, key=lambda link: -link.transitions)


def transit(link: Link) -> str:
    """Return a link's transit time in words: median, and the range of four in five.

    Where views overlap, an object appears in the second before it leaves the first. An operator's
    word on the link follows.
    """
    word = f", said to be {link.operator}" if link.operator else ""
    if link.transit.q50 < 0:
        return f"overlap, {-link.transit.q50:.1f} s before{word}"
    return f"{link.transit.q50:.1f} ({link.transit.q10:.1f} to {link.transit.q90:.1f}) s{word}"


def prediction_line(prediction: Prediction) -> str:
    """Return one prediction in words: departure zone, views that see the object now, and next
    zones.
    """
    seen = [
        f"now in view of {one.camera} {one.probability:.2f}"
        for one in seen_now(prediction.in_view or [])
    ]
    following = ", ".join(
        f"{_place(prediction, following)} {following.probability:.2f} {_when(following)}"
        for following in prediction.next_[:NEXT_SHOWN]
    )
    if not seen and not following:
        return f"{prediction.zone or prediction.camera} -> next camera unknown"
    return (
        f"{prediction.zone or prediction.camera} -> "
        f"{'; '.join([*seen, following] if following else seen)}"
    )


def _when(following: NextCamera) -> str:
    """Return when an object is expected; where views overlap it may have appeared already."""
    if following.q90 < 0.5:
        return "already in view"
    if following.q10 < 0:
        return f"within {following.q90:.0f} s"
    return f"in {following.q10:.0f} to {following.q90:.0f} s"


def _place(prediction: Prediction, following: NextCamera) -> str:
    """Return where an object is expected: a zone, or that it comes back to the view it left."""
    back = following.camera == prediction.camera
    return f"{'back to ' if back else ''}{following.zone}"
