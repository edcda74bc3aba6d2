"""``GET /metrics``: the daemon's counters for Prometheus. Only this module uses prometheus-client.

That package is an extra (``[metrics]``). Nothing is counted here: at each request the figures are
read from the daemon's status and, by a query on the bus, from those of the grabbers. The fields in
`camtopod.records` say which metric they are. Counters end in ``_total``, all others are gauges; the
only label is ``camera``.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from http import HTTPStatus
from typing import TYPE_CHECKING

from msgspec import Struct
from msgspec.structs import fields

from camtopod import codec
from camtopod.records import CAMERA_PATTERN, GrabberStatus
from camtopod.serve.bus import Bus, QueryError
from camtopod.serve.daemon import Daemon
from camtopod.serve.monitoring.health import Page
from camtopod.topology import links_between_views

if TYPE_CHECKING:
    from prometheus_client import Metric

PREFIX = "camtopod_"
"""Beginning of every metric's name."""
TEXT = "text/plain; charset=utf-8"
"""Content type of plain text."""
EXPOSITION = "text/plain; version=0.0.4; charset=utf-8"
"""Content type of the format that every Prometheus reads."""
_MISSING = "/metrics needs the package prometheus-client: pip install 'camtopod[metrics]'\n"


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

    def collect(self) -> Iterator[Metric]:
        """Yield all metrics."""
        # Liveness and readiness, also before the daemon has started.
        daemon = self._daemon
        yield _metric("healthy", "1 while all components make progress", not daemon.failing())
        yield _metric("ready", "1 while the daemon is ready", not daemon.unready())
        if not daemon.started:
            return

        # The site.
        status = daemon.status()
        yield from _metrics({"": status})
        yield _metric("degraded", "1 while the status gives a reason", bool(status.reason))
        if (newest := daemon.topology) is not None:
            links = len(links_between_views(newest))
            alarm = newest.alarms[-1].t if newest.alarms else 0.0
            yield _metric("topology_timestamp_seconds", "Event time of the version", newest.as_of)
            yield _metric("topology_links", "Links between views", links)
            yield _metric("alarm_timestamp_seconds", "Event time of the newest alarm", alarm)

        # The cameras, and their grabbers.
        yield from _metrics(dict(sorted(status.cameras.items())[: self._cameras_max]))
        statuses = dict(sorted(grabbers(daemon.bus).items())[: self._cameras_max])
        values = {camera: float(grabber.state == "running") for camera, grabber in statuses.items()}
        yield _metric("grabber_running", "1 while the camera delivers frames", values)
        yield from _metrics(statuses)


def grabbers(bus: Bus) -> dict[str, GrabberStatus]:
    """Return the statuses of the grabbers by camera; malformed ones are left out.

    A grabber that hangs delays the answer, by `QUERY_SECONDS` at most.
    """
    try:
        answers = bus.query("status/*")
    except QueryError:
        return {}
    statuses = {}
    for key, payload in answers:
        camera = key.removeprefix("status/")
        if not re.match(CAMERA_PATTERN, camera):
            continue
        with suppress(codec.Rejected):
            statuses[camera] = codec.read(GrabberStatus, payload, pack=True)
    return statuses


def _metrics(figures: Mapping[str, Struct]) -> Iterator[Metric]:
    """Yield the metrics of structs of one type by camera; "" stands for the site."""
    meanings: dict[str, str] = {}
    values: dict[str, dict[str, float]] = {}
    for camera, record in figures.items():
        for name, meaning, value in _samples(record):
            meanings[name] = meaning
            values.setdefault(name, {})[camera] = value
    for name, meaning in meanings.items():
        yield _metric(name, meaning, values[name])


def _samples(figures: Struct) -> Iterator[tuple[str, str, float]]:
    """Yield the metrics in the fields of a struct: name, meaning, value. None is left out."""
    for field in fields(figures):
        value = getattr(figures, field.name)
        if isinstance(value, Struct):
            yield from _samples(value)
        for meta in getattr(field.type, "__metadata__", ()):
            if meta.title and value is not None:
                yield meta.title, meta.description, _number(value)


def _number(value: object) -> float:
    """Return a figure as a number: of a list its length, of counts their sum."""
    if isinstance(value, dict):
        return float(sum(value.values()))
    if isinstance(value, list):
        return float(len(value))
    assert isinstance(value, int | float)
    return float(value)


def _metric(name: str, meaning: str, values: Mapping[str, float] | float) -> Metric:
    """Return a metric with its values by camera, or its value of the site."""
    from prometheus_client import Metric

    kind = "counter" if name.endswith("_total") else "gauge"
    metric = Metric(PREFIX + name.removesuffix("_total"), f"{meaning}.", kind)
    for camera, value in (values if isinstance(values, Mapping) else {"": values}).items():
        metric.add_sample(PREFIX + name, {"camera": camera} if camera else {}, value)
    return metric
