"""State of the site as `camtopod watch` shows it: filled by the bus's threads, put into words."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Callable

from camtopod import codec
from camtopod.publishers import ELSEWHERE, is_gone
from camtopod.records import CameraFigures, DaemonStatus, Link, Prediction, Status, Topology
from camtopod.topology import (
    links_between_views,
    links_in_words,
    range_in_words,
    waiting_for_links,
)

ALARMS_SHOWN = 5
"""Newest alarms that are shown."""
LINKS_SHOWN = 20
"""Busiest links that are shown."""
SILENT_SECONDS = 5.0
"""Time without a status after which its sender counts as silent; statuses come every second."""
_FINE = ("running", "ended", "no grabber", "other", "gone")
"""States that need no attention.

"gone" is a camera without a grabber, and without events for `camtopod.publishers.GONE_SECONDS`.
"other" is a camera of another program, which sends events but no status.
"""


class SiteState:
    """Collects statuses and predictions as they arrive; each is replaced as a whole.

    site: its name.
    steady: monotonic clock in seconds, to notice senders that are silent.
    """

    def __init__(self, site: str, steady: Callable[[], float] = time.monotonic) -> None:
        self._site = site
        self._steady = steady
        self._daemon = DaemonStatus()
        self._cameras: dict[str, Status] = {}
        self._heard: dict[str, float] = {}
        """Camera, or "daemon" -> time of arrival of its status."""
        self._predictions: deque[Prediction] = deque(maxlen=8)

    def on_status(self, key: str, payload: bytes) -> None:
        """Store a status published on ``status/...``; a malformed one is ignored."""
        name = key.removeprefix("status/")
        with contextlib.suppress(codec.Rejected):
            if name == "daemon":
                self._daemon = codec.read(DaemonStatus, payload, pack=True)
            else:
                self._cameras[name] = codec.read(Status, payload, pack=True)
            self._heard[name] = self._steady()

    def on_prediction(self, key: str, payload: bytes) -> None:
        """Store a prediction published on ``prediction/{camera}``; a malformed one is ignored."""
        with contextlib.suppress(codec.Rejected):
            self._predictions.append(codec.read(Prediction, payload, pack=True))

    def daemon_line(self) -> str:
        """Return one line with site, state and counters of the daemon."""
        if "daemon" not in self._heard:
            return f"site {self._site}: no status of a daemon received yet"
        daemon = self._daemon
        words = f"site {self._site}: daemon {daemon.state}"
        silence = self._steady() - self._heard["daemon"]
        if silence > SILENT_SECONDS:
            words = (
                f"site {self._site}: daemon silent (no status for {silence:.0f} s; what is shown "
                f"below may be outdated)"
            )
        elif daemon.reason:
            words += f" ({daemon.reason})"
        elif daemon.warnings:
            words += f" ({'; '.join(daemon.warnings)})"
        if behind := daemon.catching_up:
            minutes = behind.seconds / 60
            words += f", catching up, {behind.share:.0%} ({minutes:.0f} minutes behind)"
        rejected = sum(daemon.rejects.values())
        stored = daemon.events.stored
        return f"{words}, {stored} events stored, {rejected} rejected since its start"

    def camera_lines(self, topology: Topology | None, now: float) -> list[str]:
        """Return a line for each camera at ``now`` (Unix seconds).

        They are those learned of, those with a status and those that the daemon counts. Those with
        problems come first, with an exclamation mark.
        """
        known = {**_learned(topology), **self._daemon.cameras}
        newest = max((one.newest or 0.0 for one in known.values()), default=0.0)
        names = self._daemon.names
        wrong = []
        fine = []
        for name in {*self._cameras, *known}:
            figures = known.get(name, CameraFigures())
            state, reason = self._camera_state(name)
            if is_gone(state, figures.newest, newest) and not figures.alive:
                state = "gone"
                reason = ""
            elif name in names.forgotten:
                state = "forgotten"
                reason = f"its events are refused until camtopod forget --take-back {name}"
            elif name in names.renamed:
                reason = reason or f"counts as {names.renamed[name]}"
            elif state == "no grabber" and (figures.alive or figures.events):
                state = "other"
                reason = ELSEWHERE
            last = ""
            if figures.newest is not None and 0 <= now - figures.newest < 1e6:
                last = f"{now - figures.newest:.0f} s"
            line = f"{name:<20} {state:<11} {figures.events:>8} {last:>9}  {reason}"
            if state in _FINE:
                fine.append(f"  {line}")
            else:
                wrong.append(f"! {line}")
        return [*sorted(wrong), *sorted(fine)]

    def _camera_state(self, name: str) -> tuple[str, str]:
        """Return (state, reason) of a camera by its status."""
        status = self._cameras.get(name, Status())
        if not status.state:
            return "no grabber", ""
        silence = self._steady() - self._heard[name]
        if silence > SILENT_SECONDS and status.state != "ended":
            return "silent", f"no status for {silence:.0f} s"
        return status.state, status.reason

    def prediction_lines(self) -> list[str]:
        """Return the predictions in words, newest first."""
        return [f"{one.zone or one.camera} -> {one}" for one in reversed([*self._predictions])]


def _learned(topology: Topology | None) -> dict[str, CameraFigures]:
    """Return the time of the last event of each camera of a topology."""
    if topology is None or topology.model is None:
        return {}
    last = {model.camera: model.last_event for model in topology.model.cameras}
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
    if looked_for := range_in_words(topology):
        lines.append(f"looked for: {looked_for}")
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


def busiest_links(topology: Topology) -> list[Link]:
    """Return the links between views, busiest first."""
    return sorted(links_between_views(topology), key=lambda link: -link.transitions)


def transit(link: Link) -> str:
    """Return a link's transit time in words: median, and the range of four in five.

    Where views overlap, an object appears in the second before it leaves the first.
    """
    if link.transit.q50 < 0:
        return f"overlap, {-link.transit.q50:.1f} s before"
    return f"{link.transit.q50:.1f} ({link.transit.q10:.1f} to {link.transit.q90:.1f}) s"
