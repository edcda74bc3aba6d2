"""State of the site as `camtopod watch` shows it: filled by the bus's threads, put into words."""

from __future__ import annotations

import re
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple

from camtopod import codec
from camtopod.predict import seen_now
from camtopod.publishers import is_gone
from camtopod.records import (
    CAMERA_PATTERN,
    CameraFigures,
    DaemonStatus,
    Link,
    NextCamera,
    Prediction,
    Status,
    Topology,
)
from camtopod.topology import links_between_views, links_in_words, waiting_for_links

ALARMS_SHOWN = 5
"""Newest alarms that are shown."""
LINKS_SHOWN = 20
"""Busiest links that are shown."""
SILENT_SECONDS = 5.0
"""Time without a status after which its sender counts as silent; statuses come every second."""
_FINE = ("running", "ended", "no grabber", "unknown", "gone")
"""States that need no attention.

"gone" is a camera without a grabber, and without events for `camtopod.publishers.GONE_SECONDS`.
"no grabber" and "unknown" are cameras of another program, which sends events but no status.
"""


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


class SiteState:
    """Collects statuses and predictions as they arrive; thread-safe.

    site: its name.
    steady: monotonic clock in seconds, to notice senders that are silent.
    """

    def __init__(self, site: str, steady: Callable[[], float] = time.monotonic) -> None:
        self._site = site
        self._steady = steady
        self._mutex = threading.Lock()
        self._daemon: tuple[float, DaemonStatus] | None = None
        self._cameras: dict[str, tuple[float, Status]] = {}
        """Camera -> (time of arrival, status)."""
        self._predictions: deque[Prediction] = deque(maxlen=8)

    def on_status(self, key: str, payload: bytes) -> None:
        """Store a status published on ``status/...``; a malformed one is ignored."""
        name = key.removeprefix("status/")
        if not re.match(CAMERA_PATTERN, name):
            return
        try:
            if name == "daemon":
                daemon = codec.read(DaemonStatus, payload, pack=True)
                with self._mutex:
                    self._daemon = self._steady(), daemon
            else:
                camera = codec.read(Status, payload, pack=True)
                with self._mutex:
                    self._cameras[name] = self._steady(), camera
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
            return self._daemon is None and not self._cameras

    def daemon_line(self) -> str:
        """Return one line with site, state and counters of the daemon."""
        with self._mutex:
            heard, daemon = self._daemon or (0.0, None)
        if daemon is None:
            return f"site {self._site}: no status of a daemon received yet"
        state = daemon.state
        reason = daemon.reason
        if (silence := self._steady() - heard) > SILENT_SECONDS:
            state = "silent"
            reason = f"no status for {silence:.0f} s; what is shown below may be outdated"

        words = f"site {self._site}: daemon {state}"
        if reason:
            words += f" ({reason})"
        if behind := daemon.catching_up:
            minutes = behind.seconds / 60
            words += f", catching up, {behind.share:.0%} ({minutes:.0f} minutes behind)"
        rejected = sum(daemon.rejects.values())
        stored = daemon.events.get("stored", 0)
        return f"{words}, {stored} events stored, {rejected} rejected since its start"

    def cameras(self, topology: Topology | None, now: float) -> list[CameraLine]:
        """Return the cameras at ``now`` (Unix seconds): those with problems first, then by name.

        They are those learned of, those with a status and those that the daemon counts.
        """
        with self._mutex:
            statuses = dict(self._cameras)
            daemon = self._daemon[1] if self._daemon else DaemonStatus()
        known = {**_learned(topology), **daemon.cameras}
        newest = max((one.newest or 0.0 for one in known.values()), default=0.0)
        lines = []
        for name in {*statuses, *known}:
            counters = known.get(name, CameraFigures())
            state, reason = self._camera_state(statuses.get(name), counters)
            if is_gone(state, counters.newest, newest):
                state = "gone"
                reason = ""
            if name in daemon.names.forgotten:
                state = "forgotten"
                reason = f"its events are refused until camtopod forget --take-back {name}"
            elif name in daemon.names.renamed and state in _FINE:
                reason = f"counts as {daemon.names.renamed[name]}"
            last = None
            if counters.newest is not None and 0 <= now - counters.newest < 1e6:
                last = now - counters.newest
            lines.append(CameraLine(name, state, reason, counters.events, last))
        return sorted(lines, key=lambda line: (not line.wrong, line.name))

    def _camera_state(
        self, status: tuple[float, Status] | None, counters: CameraFigures
    ) -> tuple[str, str]:
        """Return (state, reason) of a camera by its status and the daemon's counters."""
        if status is None or not status[1].state:
            return "unknown" if counters.alive else "no grabber", ""
        silence = self._steady() - status[0]
        if silence > SILENT_SECONDS and status[1].state != "ended":
            return "silent", f"no status for {silence:.0f} s"
        return status[1].state, status[1].reason

    def prediction_lines(self) -> list[str]:
        """Return the predictions in words, newest first."""
        with self._mutex:
            predictions = list(self._predictions)
        return [prediction_line(prediction) for prediction in reversed(predictions)]


def _learned(topology: Topology | None) -> dict[str, CameraFigures]:
    """Return the time of the last event of each camera of a topology."""
    if topology is None:
        return {}
    models = [] if topology.model is None else topology.model.cameras
    last = {model.camera: model.last_event for model in models}
    return {camera.id: CameraFigures(newest=last.get(camera.id)) for camera in topology.cameras}


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


def alarm_lines(topology: Topology | None, now: float) -> list[str]:
    """Return the newest alarms in words, newest first; ``now`` in Unix seconds."""
    if topology is None or topology.alarms is None:
        return []
    return [
        f"{(now - alarm.t) / 60:.0f} min ago, version {alarm.version}: "
        f"{alarm.kind} {alarm.subject}, {alarm.detail}"
        for alarm in reversed(topology.alarms[-ALARMS_SHOWN:])
    ]


def busiest_links(topology: Topology | None) -> list[Link]:
    """Return the links between views, busiest first."""
    if topology is None:
        return []
    return sorted(links_between_views(topology), key=lambda link: -link.transitions)


def transit(link: Link) -> str:
    """Return a link's transit time in words: median, and the range of four in five.

    Where views overlap, an object appears in the second before it leaves the first.
    """
    if link.transit.q50 < 0:
        return f"overlap, {-link.transit.q50:.1f} s before"
    return f"{link.transit.q50:.1f} ({link.transit.q10:.1f} to {link.transit.q90:.1f}) s"


def prediction_line(prediction: Prediction) -> str:
    """Return one prediction in words: departure zone, views that see the object now, and next
    zones.
    """
    places = [
        f"now in view of {view.camera} {view.probability:.2f}"
        for view in seen_now(prediction.in_view or [])
    ]
    if prediction.next_:
        places.append(
            ", ".join(
                f"{_place(prediction, following)} {following.probability:.2f} {_when(following)}"
                for following in prediction.next_[:3]
            )
        )
    left = prediction.zone or prediction.camera
    return f"{left} -> {'; '.join(places) or 'next camera unknown'}"


def _when(following: NextCamera) -> str:
    """Return when an object is expected; where views overlap it may have appeared already."""
    if following.q90 < 0.5:
        return "already in view"
    if following.q10 < 0:
        return f"within {following.q90:.0f} s"
    return f"in {following.q10:.0f} to {following.q90:.0f} s"


def _place(prediction: Prediction, following: NextCamera) -> str:
    """Return where an object is expected: a zone, or that it comes back to the view it left."""
    if following.camera == prediction.camera:
        return f"back to {following.zone}"
    return following.zone
