"""``GET /metrics``: the daemon's counters for Prometheus. Only this module uses prometheus-client.

That package is an extra (``[metrics]``). Nothing is counted here: at each request the figures are
read from the daemon's status and, by a query on the bus, from those of the grabbers. The only label
is ``camera``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from http import HTTPStatus
from typing import TYPE_CHECKING, Any, NamedTuple

import msgspec

from camtopod import codec
from camtopod.records import CAMERA_PATTERN
from camtopod.serve.bus import Bus, QueryError
from camtopod.serve.daemon import Daemon
from camtopod.serve.monitoring.health import Page
from camtopod.topology import links_between_views

if TYPE_CHECKING:
    from prometheus_client import Metric as Family

PREFIX = "camtopod_"
"""Beginning of every metric's name."""
TEXT = "text/plain; charset=utf-8"
"""Content type of plain text."""
EXPOSITION = "text/plain; version=0.0.4; charset=utf-8"
"""Content type of the format that every Prometheus reads."""
_MISSING = "/metrics needs the package prometheus-client: pip install 'camtopod[metrics]'\n"


class Metric(NamedTuple):
    """One metric.

    name: its name after `PREFIX`; counters end in ``_total``, all others are gauges.
    path: where its value is in a status, as names joined by dots.
    help: its meaning.
    """

    name: str
    path: str
    help: str


SITE = (
    Metric("events_received_total", "events.received", "Events received"),
    Metric("events_stored_total", "events.stored", "Events in the journal since the start"),
    Metric("events_duplicate_total", "events.duplicate", "Events received again"),
    Metric(
        "events_future_total",
        "events.future",
        "Events too far ahead of this machine's clock, set aside",
    ),
    Metric(
        "events_flood_total", "events.flood", "Events beyond what one view can show, not learned"
    ),
    Metric("events_lost_total", "events.lost", "Events missing between others"),
    Metric("events_learned_total", "learner.learned", "Events learned in this epoch"),
    Metric(
        "events_late_total",
        "learner.late",
        "Events later than the allowed lateness, stored and not learned",
    ),
    Metric(
        "events_not_learned_total",
        "learner.refused",
        "Events of too many cameras or incarnations, not learned",
    ),
    Metric("events_waiting", "events.waiting", "Events stored and not learned yet"),
    Metric("events_merging", "events.merging", "Events that wait for others or their time"),
    Metric(
        "learner_held_events",
        "learner.held",
        "Events the learner holds until the watermark has passed them",
    ),
    Metric("learner_window_events", "learner.window", "Events in the window that is learned from"),
    Metric(
        "watermark_timestamp_seconds",
        "learner.watermark",
        "Event time up to which everything is learned",
    ),
    Metric("predictions_total", "predictions", "Predictions published"),
    Metric(
        "predictions_skipped_total",
        "predictions_skipped",
        "Exits without a prediction because there was no time",
    ),
    Metric(
        "questions_refused_total",
        "questions_refused",
        "Queries for a prediction that could not be answered",
    ),
    Metric("journal_entries_total", "journal.entries", "Entries the journal has ever had"),
    Metric("journal_bytes", "journal.bytes", "Size of the journal"),
    Metric("journal_damaged_entries", "journal.damaged", "Damaged entries that were left out"),
    Metric(
        "journal_missing_entries",
        "journal.missing",
        "Entries the journal had lost when it was opened",
    ),
    Metric("journal_damaged_files", "journal.damaged_files", "Files set aside for damage"),
    Metric("degraded", "degraded", "1 while the status gives a reason for a degraded state"),
    Metric("topology_version", "version", "Newest version of the topology"),
    Metric("topology_timestamp_seconds", "topology.as_of", "Event time of the newest version"),
    Metric("topology_cameras", "topology.cameras", "Cameras in the topology"),
    Metric("topology_zones", "topology.zones", "Zones in the topology"),
    Metric("topology_links", "topology.links", "Links between views"),
    Metric("alarm_timestamp_seconds", "topology.alarm", "Event time of the newest alarm"),
    Metric("score_exits", "score.exits", "Number of predictions that are scored"),
    Metric("score_top1", "score.top1", "Share of next cameras that were the likeliest"),
    Metric("score_top3", "score.top3", "Share of next cameras among the likeliest three"),
    Metric("score_log_loss", "score.log_loss", "Mean log loss of the predictions, nats"),
    Metric(
        "score_baseline_top1",
        "score.baseline_top1",
        "Top-1 score of a baseline that always names the most frequent next camera",
    ),
    Metric("score_baseline_log_loss", "score.baseline_log_loss", "Log loss of that baseline, nats"),
)
"""Metrics of the site, from the daemon's status."""
REASONS = (
    "malformed",
    "bad-value",
    "not-utf8",
    "too-deep",
    "too-long",
    "half-position",
    "half-sequence",
    "wrong-camera",
    "too-many-cameras",
    "too-many-streams",
    "seq-jump",
    "future",
    "spool-refuses",
    "bad-batch",
)
"""Reasons of rejection that have a metric of their own; others are in the sum only."""
CAMERA = (
    Metric("events_total", "events", "Events taken from the camera since the start"),
    Metric("event_timestamp_seconds", "newest", "Time of the camera's newest event"),
    Metric(
        "clock_ahead_seconds",
        "ahead",
        "Seconds by which the camera's last event was ahead of this machine's clock",
    ),
    Metric("camera_alive", "alive", "1 while the publisher of the camera's events is on the bus"),
    Metric(
        "events_dropped_total",
        "dropped",
        "Publications dropped for lack of room; a spool still has them",
    ),
)
"""Metrics of each camera, from the daemon's status."""
GRABBER = (
    Metric("grabber_running", "running", "1 while the camera delivers frames"),
    Metric("grabber_restarts_total", "restarts", "Restarts of the camera's process"),
    Metric("grabber_connections_total", "connections", "Connections to the camera"),
    Metric("grabber_failures_total", "failures", "Connections that failed or were lost"),
    Metric("grabber_frames_total", "frames_grabbed", "Frames received"),
    Metric(
        "grabber_frames_dropped_total", "frames_dropped", "Frames dropped because they were too old"
    ),
    Metric("grabber_frames_analysed_total", "frames_analysed", "Frames analysed"),
    Metric(
        "grabber_analysis_cpu_seconds_total",
        "analysis_cpu_seconds",
        "CPU time of the analysis, seconds",
    ),
    Metric("grabber_entries_total", "entries", "Entries of objects"),
    Metric("grabber_exits_total", "exits", "Exits of objects"),
    Metric("grabber_frame_timestamp_seconds", "last_frame_t", "Capture time of the latest frame"),
    Metric("spool_events", "waiting", "Events that the daemon has not stored yet"),
    Metric("spool_dropped_total", "dropped", "Events lost because the spool was full"),
    Metric("spool_damaged_files", "damaged_files", "Files of the spool set aside for damage"),
)
"""Metrics of each camera, from its grabber's status."""


def page(daemon: Daemon, cameras_max: int) -> Page:
    """Return the answer to a request, with at most ``cameras_max`` cameras.

    Without the extra its status is 501 and its text says how to install it.
    """
    try:
        from prometheus_client import CollectorRegistry, ProcessCollector, generate_latest
    except ModuleNotFoundError:
        return Page(HTTPStatus.NOT_IMPLEMENTED, TEXT, _MISSING.encode())
    registry = CollectorRegistry()
    ProcessCollector(registry=registry)
    if daemon.started:
        ProcessCollector(f"{PREFIX}learner", lambda: daemon.learner_pid, registry=registry)
    registry.register(_Scrape(daemon, cameras_max))
    return Page(HTTPStatus.OK, EXPOSITION, generate_latest(registry))


class _Scrape:
    """A collector that reads the figures of one moment."""

    def __init__(self, daemon: Daemon, cameras_max: int) -> None:
        self._daemon = daemon
        self._cameras_max = cameras_max

    def collect(self) -> Iterator[Family]:
        """Yield all metrics."""

        # Liveness and readiness, also before the daemon has started.
        daemon = self._daemon
        yield _family(
            "healthy", "1 while all components make progress", {"": float(not daemon.failing())}
        )
        yield _family("ready", "1 while the daemon is ready", {"": float(not daemon.unready())})
        if not daemon.started:
            return

        # The site.
        status = site_status(daemon)
        yield from (_family(one.name, one.help, _number({"": status}, one.path)) for one in SITE)

        # Rejected input, by reason.
        rejects: dict[str, int] = status["rejects"]
        yield _family("rejected_total", "Inputs that were rejected", {"": sum(rejects.values())})
        for reason in REASONS:
            name = f"rejected_{reason.replace('-', '_')}_total"
            yield _family(name, f"Inputs rejected as {reason}", {"": rejects.get(reason, 0)})

        # The cameras, and their grabbers.
        yield from self._families(CAMERA, status["cameras"])
        yield from self._families(GRABBER, grabbers(daemon.bus))

    def _families(self, metrics: Iterable[Metric], cameras: Mapping[str, Any]) -> Iterator[Family]:
        """Yield metrics of the first cameras by name, at most ``cameras_max``."""
        some = {camera: cameras[camera] for camera in sorted(cameras)[: self._cameras_max]}
        yield from (_family(one.name, one.help, _number(some, one.path)) for one in metrics)


def site_status(daemon: Daemon) -> dict[str, Any]:
    """Return ``status/daemon`` as a dictionary, with figures of the newest topology."""
    status: dict[str, Any] = msgspec.to_builtins(daemon.status())
    status["degraded"] = status["state"] != "running"
    status["journal"]["damaged_files"] = len(status["journal"].get("damaged_files", ()))
    status["learner"]["watermark"] = status["learner"]["watermark"] or None

    # Add the newest topology.
    if (newest := daemon.topology) is not None:
        status["topology"] = {
            "as_of": newest.as_of,
            "cameras": len(newest.cameras),
            "zones": len(newest.zones),
            "links": len(links_between_views(newest)),
            "alarm": newest.alarms[-1].t if newest.alarms else 0.0,
        }

    # Add dropped publications to the cameras; those of unknown cameras are summed under "".
    for camera, counters in status["cameras"].items():
        counters["dropped"] = status["dropped"].pop(camera, 0)
    if others := sum(status["dropped"].values()):
        status["cameras"][""] = {"dropped": others}
    return status


def grabbers(bus: Bus) -> dict[str, dict[str, Any]]:
    """Return the statuses of the grabbers by camera.

    A grabber that hangs delays the answer, by `QUERY_SECONDS` at most.
    """
    try:
        answers = bus.query("status/*")
    except QueryError:
        return {}
    found: dict[str, dict[str, Any]] = {}
    for key, payload in answers:
        camera = key.removeprefix("status/")
        if camera == "daemon" or not re.match(CAMERA_PATTERN, camera):
            continue
        try:
            status = codec.read(dict[str, Any], payload, pack=True)
        except codec.Rejected:
            continue
        found[camera] = {**status, "running": status.get("state") == "running"}
    return found


def _number(statuses: Mapping[str, Any], path: str) -> dict[str, float]:
    """Return the number at ``path`` of each camera's status; cameras without one are left out."""
    found = {}
    for camera, value in statuses.items():
        for name in path.split("."):
            value = value.get(name) if isinstance(value, dict) else None
        if isinstance(value, int | float):
            found[camera] = float(value)
    return found


def _family(name: str, text: str, values: Mapping[str, float]) -> Family:
    """Return a metric with its values by camera; the value of "" has no label."""
    from prometheus_client import Metric as Family

    counter = name.endswith("_total")
    family = Family(
        PREFIX + name.removesuffix("_total"), f"{text}.", "counter" if counter else "gauge"
    )
    for camera, value in values.items():
        family.add_sample(PREFIX + name, {"camera": camera} if camera else {}, value)
    return family
