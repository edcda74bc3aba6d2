"""State of the site as `camtopod watch` shows it: filled by the bus's threads, put into words."""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Callable

from camtopod import codec
from camtopod.records import Link, Prediction, Topology
from camtopod.statuses import Statuses
from camtopod.topology import (
    links_between_views,
    range_in_words,
    waiting_for_links,
)
from camtopod.words import alarms_in_words, counted

ALARMS_SHOWN = 5
"""Newest alarms that are shown."""
LINKS_SHOWN = 20
"""Busiest links that are shown."""

SITE_WIDTH = 12
"""Width of the column of sites, if there are several, characters."""


class SiteState:
    """Collects statuses and predictions as they arrive; each is replaced as a whole.

    site: its name.
    steady: monotonic clock in seconds, to notice senders that are silent.
    owner: returns the site of a camera, for its lines, if there are several sites.
    """

    def __init__(
        self,
        site: str,
        steady: Callable[[], float] = time.monotonic,
        owner: Callable[[str], str | None] | None = None,
    ) -> None:
        self._site = site
        self._statuses = Statuses(steady)
        self.on_status = self._statuses.on_status
        self._owner = owner
        self._predictions: deque[Prediction] = deque(maxlen=8)

    def on_prediction(self, key: str, payload: bytes) -> None:
        """Store a prediction published on ``prediction/{camera}``; a malformed one is ignored."""
        with contextlib.suppress(codec.Rejected):
            self._predictions.append(codec.read(Prediction, payload, pack=True))

    def beginning(self, camera: str = "") -> str:
        """Return the site that owns a camera, as the first column of a line; "" if it is one site.

        camera: "" for the column's head.
        """
        if self._owner is None:
            return ""
        return f"{(self._owner(camera) or '') if camera else 'SITE':<{SITE_WIDTH}} "

    def daemon_line(self, topology: Topology | None) -> str:
        """Return one line with site, state and counters of the daemon."""
        state = self._statuses.daemon_state(topology)
        reason = f" ({state.reason})" if state.reason else ""
        words = f"site {self._site}: daemon {state.words}{reason}"
        if not state.live:
            return words
        daemon = self._statuses.daemon
        reject_count = sum(daemon.rejects.values())
        stored_count = daemon.events.stored
        return f"{words}, {stored_count} events stored, {reject_count} rejected since its start"

    def camera_lines(self, topology: Topology | None, now: float) -> list[str]:
        """Return a line for each camera at ``now`` (Unix seconds).

        Those with problems come first, with an exclamation mark.
        """
        lines = []
        for camera in self._statuses.cameras(topology):
            last = ""
            if camera.newest is not None and 0 <= now - camera.newest < 1e6:
                last = f"{now - camera.newest:.0f} s"
            mark = "!" if camera.look == "bad" else " "
            lines.append(
                f"{mark} {self.beginning(camera.id)}{camera.id:<20} {camera.state:<13}"
                f" {camera.events or 0:>8} {last:>9}  {camera.reason}"
            )
        return lines

    def prediction_lines(self) -> list[str]:
        """Return the predictions in words, newest first."""
        return [
            f"{self.beginning(prediction.camera)}{prediction.zone or prediction.camera} -> "
            f"{prediction}"
            for prediction in reversed([*self._predictions])
        ]


def topology_lines(topology: Topology | None) -> list[str]:
    """Return lines about the newest topology and the score of its predictions."""
    if topology is None:
        return ["topology: nothing learned yet; the first version comes a minute after ten events"]
    links = len(links_between_views(topology))
    lines = [
        f"topology: version {topology.version}, {counted(topology.events, 'event')}, "
        f"{counted(len(topology.cameras), 'camera')}, {counted(len(topology.zones), 'zone')}, "
        f"{counted(links, 'link')} between views, {topology.digest[:19]}"
    ]
    if looked_for := range_in_words(topology):
        lines.append(f"looked for: {looked_for}")
    if remark := waiting_for_links(topology):
        lines.append(remark)
    if (s := topology.score) is not None:
        lines.append(
            f"predictions: next camera right {s.top1:.2f} (baseline {s.baseline_top1:.2f}), "
            f"among the first three {s.top3:.2f}, "
            f"log loss {s.log_loss:.2f} (baseline {s.baseline_log_loss:.2f}); "
            f"{s.exits} exits since version {s.since_version}"
        )
    return lines


def alarm_lines(topology: Topology | None, now: float) -> list[str]:
    """Return the newest open alarms in words, newest first; ``now`` in Unix seconds."""
    alarms = [
        f"{(now - alarm.t) / 60:.0f} min ago, version {alarm.version}: "
        f"{alarm.title}: {alarm.detail}"
        for alarm in alarms_in_words(topology)
        if alarm.open
    ]
    return alarms[:ALARMS_SHOWN]


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
