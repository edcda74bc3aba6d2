"""Prometheus metrics equal the status, with a real daemon and Prometheus's own parser."""

from __future__ import annotations

import http.client
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from paths import DEPLOY
from serving import (
    WAIT_SECONDS,
    all_out,
    closing_event,
    numbered,
    small_config,
    wait_for,
    walkers,
)

from camtopod import records
from camtopod.records import DaemonStatus, Event
from camtopod.serve import bus as buses
from camtopod.serve.daemon import Daemon
from camtopod.serve.monitoring import health, metrics
from camtopod.topology import links_between_views

parser = pytest.importorskip(
    "prometheus_client.parser", reason="needs prometheus-client (camtopod[metrics])"
)

NAMES = {
    f"camtopod_{name}"
    for path in (*Path(records.__file__).parent.glob("*.py"), Path(metrics.__file__))
    for name in re.findall(r'metric\(\s*"(\w+)"', path.read_text(encoding="utf-8"))
}
"""Names of all metrics that are made of fields and topologies."""
Samples = dict[tuple[str, str], float]
"""(name, camera) -> value; camera "" is the site's."""


def scraped(daemon: Daemon, cameras_max: int = 1000) -> Samples:
    page = metrics.page(daemon, cameras_max)
    assert page.status == 200
    return parsed(page.body)


def parsed(body: bytes) -> Samples:
    found: Samples = {}
    for family in parser.text_string_to_metric_families(body.decode()):
        assert family.documentation.endswith("."), family.name
        for sample in family.samples:
            assert set(sample.labels) <= {"camera"}
            key = (sample.name, sample.labels.get("camera", ""))
            assert key not in found
            assert (family.type == "counter") == sample.name.endswith("_total")
            found[key] = sample.value
    return found


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Daemon]:
    with Daemon(small_config(tmp_path)) as one:
        yield one


@pytest.fixture(scope="module")
def idle(tmp_path_factory: pytest.TempPathFactory) -> set[str]:
    """Return the names of the metrics of an idle daemon."""
    with Daemon(small_config(tmp_path_factory.mktemp("idle"))) as one:
        return {name for name, _ in scraped(one)}


def test_the_figures_are_those_of_the_status(daemon: Daemon, tmp_path: Path) -> None:
    events = numbered([*walkers(150), closing_event()])
    with buses.dial(small_config(tmp_path, daemon.endpoint)) as bus:
        for event in [*events, *events[:10]]:
            bus.publish(f"event/{event.camera}", event, "event")
        bus.publish_raw("event/a", b"\xc1", "event")
        bus.publish("event/b", Event("a", "entry", 1.0), "event")
    wait_for(lambda: daemon.status().events.received == len(events) + 12, "all that was sent")
    wait_for(lambda: all_out(daemon, len(events)), "all to be learned")
    moments: list[tuple[Samples, DaemonStatus]] = []

    def settled() -> bool:
        """Return True if the journal was the same before and after; it may still
        write a version.
        """
        before = daemon.status().journal
        moments.append((scraped(daemon), daemon.status()))
        return bool(moments[-1][1].journal == before)

    wait_for(settled, "the journal to be written")
    (samples, status), topology = moments[-1], daemon.topology
    assert topology is not None
    assert topology.score is not None
    expected = {
        "events_stored_total": len(events),
        "events_duplicate_total": 10,
        "rejected_total": 2,
        "predictions_total": status.predictions,
        "events_waiting": 0,
        "watermark_timestamp_seconds": status.learner.watermark,
        "journal_bytes": status.journal.bytes,
        "topology_version": topology.version,
        "topology_links": len(links_between_views(topology)),
        "alarm_timestamp_seconds": 0,  # not absent, or nobody would see it change when the first one comes
        "score_top1": topology.score.top1,
        "score_baseline_top1": topology.score.baseline_top1,
        "healthy": 1,
        "ready": 1,
        "degraded": 0,
    }
    assert {name: samples[f"camtopod_{name}", ""] for name in expected} == pytest.approx(expected)
    for camera, counters in status.cameras.items():
        assert samples["camtopod_events_total", camera] == counters.events
        assert samples["camtopod_event_timestamp_seconds", camera] == counters.newest
        assert samples["camtopod_camera_alive", camera] == 0
    assert sum(
        value for (name, _), value in samples.items() if name == "camtopod_events_total"
    ) == len(events)
    assert samples["camtopod_learner_process_resident_memory_bytes", ""] > 1e6
    assert samples["process_resident_memory_bytes", ""] > 1e6


def test_counters_are_there_from_the_start(idle: set[str]) -> None:
    """An alert on a missing counter would never fire."""
    counters = {name for name in NAMES if name.endswith("_total")}
    of_cameras = {name for name in counters if re.search("_grabber_|_spool_|_events_total", name)}

    assert len(counters - of_cameras) > 8
    assert counters - of_cameras <= idle


def test_the_cameras_processes_are_asked(daemon: Daemon, tmp_path: Path) -> None:
    def status(camera: str) -> Any:
        return {
            "camera": camera,
            "state": "running",
            "restarts": 2,
            "frames_analysed": 70,
            "waiting": 3,
            "last_frame_t": 5.5,
            "reason": "x" * 9,
        }

    with buses.dial(small_config(tmp_path, daemon.endpoint)) as bus:
        bus.answer_queries("status/lobby", lambda key, parameters: status("lobby"), "status")
        bus.answer_queries("status/hall", lambda key, parameters: {"state": "connecting"}, "status")
        bus.answer_queries("status/broken", lambda key, parameters: {"restarts": "many"}, "status")
        bus.answer_queries("status/no camera", lambda key, parameters: status("x"), "status")
        wait_for(lambda: len(metrics.grabbers(daemon.bus)) == 2, "the answers")
        samples = scraped(daemon)
    assert {(name, camera): value for (name, camera), value in samples.items() if camera} == {
        ("camtopod_grabber_running", "lobby"): 1,
        ("camtopod_grabber_running", "hall"): 0,
        ("camtopod_grabber_restarts_total", "lobby"): 2,
        ("camtopod_grabber_frames_analysed_total", "lobby"): 70,
        ("camtopod_grabber_frame_timestamp_seconds", "lobby"): 5.5,
        ("camtopod_spool_events", "lobby"): 3,
    }


def test_the_number_of_cameras_has_a_limit(daemon: Daemon, tmp_path: Path) -> None:
    with buses.dial(small_config(tmp_path, daemon.endpoint)) as bus:
        for number in range(20):
            bus.publish(f"event/c{number:02}", Event(f"c{number:02}", "entry", 1.0), "event")
            bus.answer_queries(
                f"status/c{number:02}", lambda key, parameters: {"state": "running"}, "status"
            )
        wait_for(lambda: len(daemon.status().cameras) == 20, "the cameras")
        wait_for(lambda: len(metrics.grabbers(daemon.bus)) == 20, "the answers")
        samples = scraped(daemon, 5)
    assert {camera for _, camera in samples} == {"", "c00", "c01", "c02", "c03", "c04"}


def test_before_the_start_and_after_the_end(tmp_path: Path) -> None:
    daemon = Daemon(small_config(tmp_path))
    early = scraped(daemon)
    assert (early["camtopod_ready", ""], early["camtopod_healthy", ""]) == (0, 1)
    assert ("camtopod_events_stored_total", "") not in early
    daemon.start()
    daemon.stop()
    late = scraped(daemon)
    assert (late["camtopod_ready", ""], late["camtopod_events_stored_total", ""]) == (0, 0)


def ask(address: str, path: str) -> tuple[int, str, bytes]:
    connection = http.client.HTTPConnection(address, timeout=WAIT_SECONDS)
    try:
        connection.request("GET", path)
        answer = connection.getresponse()
        return answer.status, answer.headers["Content-Type"], answer.read()
    finally:
        connection.close()


def test_the_page(daemon: Daemon, monkeypatch: pytest.MonkeyPatch) -> None:
    pages = {"/metrics": lambda: metrics.page(daemon, 10)}
    with health.serving("127.0.0.1:0", daemon.failing, daemon.unready, pages) as address:
        status, kind, body = ask(address, "/metrics")
        assert (status, kind) == (200, "text/plain; version=0.0.4; charset=utf-8")
        assert parsed(body)["camtopod_ready", ""] == 1
        assert ask(address, "/healthz")[0] == 200
        monkeypatch.setitem(sys.modules, "prometheus_client", None)
        status, kind, body = ask(address, "/metrics")
        assert (status, b"pip install 'camtopod[metrics]'" in body) == (501, True)
    with health.serving("127.0.0.1:0", list, list) as address:
        assert ask(address, "/metrics")[0] == 404


# --- who asks for them ----------------------------------------------------------------------------


def rules() -> list[dict[str, Any]]:
    groups = yaml.safe_load((DEPLOY / "prometheus-rules.yml").read_text())["groups"]
    return [rule for group in groups for rule in group["rules"]]


def board() -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((DEPLOY / "grafana-dashboard.json").read_text())
    return loaded


def expressions() -> list[str]:
    """Return every expression of the rules and the dashboard."""
    found = [rule["expr"] for rule in rules()]
    found += [target["expr"] for panel in board()["panels"] for target in panel.get("targets", [])]
    found += [
        one["query"]["query"]
        for one in board()["templating"]["list"]
        if isinstance(one["query"], dict)
    ]
    return found + [one["expr"] for one in board()["annotations"]["list"]]


def test_rules_and_board_ask_for_what_there_is(idle: set[str]) -> None:
    there = idle | NAMES | {"up"}
    functions = r"(?!\s*\()"
    asked = {
        name
        for one in expressions()
        for name in re.findall(rf"\b(?:camtopod|process)_\w+|\bup\b{functions}", one)
    }
    assert len(asked) > 40
    assert asked - there == set()
    for one in expressions():
        for label in re.findall(r"(\w+)=~?\"", one):
            assert label in ("camera", "instance", "job"), one
        for counter in re.findall(r"(\w+)(?:\{[^}]*\})?\[", one):
            kinds = ("rate(", "increase(") if counter.endswith("_total") else ("changes(",)
            assert re.search("|".join(re.escape(f"{kind}{counter}") for kind in kinds), one), one


def test_every_rule_says_what_to_do() -> None:
    names = [rule["alert"] for rule in rules()]
    assert len(set(names)) == len(names)
    for rule in rules():
        assert rule["labels"]["severity"] in ("critical", "warning", "info")
        assert rule["annotations"]["summary"].endswith((".", "?"))
        if "$labels.camera" in rule["annotations"]["summary"]:
            assert re.search("_(camera|grabber|spool|clock)_", rule["expr"]), rule["alert"]
