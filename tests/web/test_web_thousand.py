"""The live page of a site with a thousand cameras: a real browser and a real daemon."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from chromium import Browser
from serving import small_config, wait_for
from synthetic_topology import AS_OF, synthetic_topology

from camtopod import codec
from camtopod.cli.commands.web import listening, names
from camtopod.records import Event, Topology
from camtopod.serve.bus import session as buses
from camtopod.serve.daemon import Daemon
from camtopod.serve.storage.journal import Journal, StoredVersion
from camtopod.serve.storage.packed_version import Version
from camtopod.topology.versions import make_delta, with_digest
from camtopod.web import app

CAMERAS = 1000
SITE = synthetic_topology(CAMERAS)
PATH = next(link for link in SITE.links if link.relation == "unseen")
FROM, TO = PATH.from_.split("/")[0], PATH.to.split("/")[0]
SHOWN_SECONDS = 15.0
"""A machine that does other things as well takes some to lay out a thousand."""


@pytest.fixture
def daemon(tmp_path: Path) -> Iterator[Daemon]:
    """Run a daemon that had published `SITE` before it was restarted."""
    config = small_config(tmp_path)
    with contextlib.closing(Journal(config.state_directory)) as journal:
        stored = StoredVersion(SITE.epoch, SITE.version, SITE.digest, codec.to_json(SITE))
        journal.commit([], [stored], None, AS_OF)
    began = time.monotonic()
    with Daemon(config, clock=lambda: AS_OF + time.monotonic() - began) as started:
        yield started


def without_a_path() -> Topology:
    """Return the next version, without the links of `PATH` in either direction."""
    ends = {PATH.from_, PATH.to}
    links = [link for link in SITE.links if {link.from_, link.to} != ends]
    pairs = [pair for pair in SITE.pairs if set(pair.cameras) != {FROM, TO}]
    return with_digest(
        msgspec.structs.replace(SITE, version=2, as_of=AS_OF + 60, links=links, pairs=pairs)
    )


def publish(daemon: Daemon, topology: Topology) -> None:
    """Store a version and publish its delta, as if the learner had made it."""
    delta = codec.to_msgpack(make_delta(SITE, topology))
    daemon._on_version(Version.of(topology, delta))


def test_a_thousand_cameras_are_shown_live(
    daemon: Daemon, browser: Browser, tmp_path: Path
) -> None:
    assert daemon.topology is not None
    assert daemon.topology.digest == SITE.digest
    with (
        contextlib.closing(buses.dial(small_config(tmp_path, daemon.endpoint))) as bus,
        listening("127.0.0.1", 0) as listener,
        app.serving(bus, listener, names("127.0.0.1"), None, daemon._clock, 1.0),
    ):
        began = time.monotonic()
        browser.open(f"http://127.0.0.1:{listener.getsockname()[1]}/")
        browser.wait(lambda: browser.count(".node") == CAMERAS, "a thousand cameras")
        assert time.monotonic() - began < SHOWN_SECONDS
        browser.wait(lambda: browser.text("#live") == "live · version 1", "the page to be live")
        assert browser.count(".edge") == len(SITE.pairs)

        bus.publish(
            f"event/{FROM}",
            Event(FROM, "exit", daemon._clock(), *zone_of(PATH.from_), "x", "b1", 1),
            "event",
        )
        browser.wait(lambda: browser.count("circle.dot") > 0, "a dot under way")
        where = "const dot = document.querySelector('circle.dot'); return dot && [dot.cx, dot.cy].map((c) => c.baseVal.value)"
        before = browser.run(where)
        browser.wait(lambda: browser.run(where) != before, "the dot to move")

        maps = sum(url.endswith("/data/map") for url in browser.asked())
        publish(daemon, without_a_path())
        browser.wait(lambda: browser.text("#live") == "live · version 2", "the new version")
        assert browser.count(".edge") == len(SITE.pairs) - 1
        assert sum(url.endswith("/data/map") for url in browser.asked()) == maps, (
            "only what changed was sent"
        )

        browser.go("#/health")
        browser.wait(lambda: browser.text(".page").count("cam0") > 100, "the cameras' health")
        assert "1,000 cameras" in browser.text(".page")
    assert browser.complaints() == []
    wait_for(lambda: daemon.status()["version"] == 2, "it to be stored")


def zone_of(zone: str) -> tuple[float, float]:
    """Return the middle of a zone."""
    found = next(one for one in SITE.zones if one.id == zone)
    assert found.x is not None
    assert found.y is not None
    return found.x, found.y
