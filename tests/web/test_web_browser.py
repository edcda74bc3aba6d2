"""The web page in a real browser with a real daemon: its contents, and that it stays live."""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import quote, urlsplit

import cv2
import msgspec
import numpy as np
import pytest
from chromium import Browser
from serving import (
    SPAN_SECONDS,
    T0,
    closing_event,
    free_endpoint,
    numbered,
    small_config,
    wait_for,
    walkers,
)
from synthetic_topology import synthetic_topology

from camtopod.cli.commands.web import listening, names
from camtopod.config.settings import BusSettings, Config, WebSettings
from camtopod.records import Event
from camtopod.serve import bus as buses
from camtopod.serve.bus import Bus
from camtopod.serve.daemon import Daemon
from camtopod.web import app, report
from camtopod.web.single_file import page

HOSTILE = "<img src=x onerror=\"document.title='owned'\"><script>document.title='owned'</script> no frame for 31 s"
DOTTED = "gate.1-_x"


class Site:
    """A daemon and its page; time runs, from long after `T0`."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.endpoint = free_endpoint()
        self._began = time.monotonic()
        self._open = contextlib.ExitStack()
        config = msgspec.structs.replace(
            small_config(directory / "state"), bus=BusSettings(listen=(self.endpoint,))
        )
        self.daemon = self._open.enter_context(Daemon(config, clock=self.now))
        bus = self._open.enter_context(self.client())
        cv2.imwrite(str(directory / "a.png"), np.full((90, 120, 3), 200, np.uint8))
        self.port = self._open.enter_context(self.page(bus))
        self.address = f"http://127.0.0.1:{self.port}/"

    def now(self) -> float:
        return T0 + 20 * SPAN_SECONDS + time.monotonic() - self._began

    @property
    def cameras(self) -> int:
        """Number of cameras in the newest version."""
        return len(self.daemon.topology.cameras) if self.daemon.topology else 0

    def client(self) -> Bus:
        return buses.dial(small_config(self.directory, self.endpoint))

    @contextlib.contextmanager
    def page(self, bus: Bus, port: int = 0) -> Iterator[int]:
        """Serve the page; yield its port."""
        config = Config(web=WebSettings(pictures=str(self.directory)))
        with (
            listening("127.0.0.1", port) as listener,
            app.serving(bus, listener, names("127.0.0.1"), self.now, config),
        ):
            yield listener.getsockname()[1]

    def learn(self, bus: Bus) -> None:
        """Publish enough walkers for a topology."""
        events = [
            msgspec.structs.replace(event, camera=DOTTED if event.camera == "b" else event.camera)
            for event in (*walkers(60), closing_event())
        ]
        for event in numbered(events):
            bus.publish(f"event/{event.camera}", event, "event")
        wait_for(
            lambda: bool(self.daemon.topology and len(self.daemon.topology.pairs) == 2), "two pairs"
        )

    def close(self) -> None:
        self._open.close()


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory, started_browser: Browser) -> Iterator[Site]:
    one = Site(tmp_path_factory.mktemp("site"))
    with one.client() as bus:
        one.learn(bus)
    yield one
    one.close()


@pytest.fixture
def shown(site: Site, browser: Browser) -> Iterator[Browser]:
    """Open the page; at the end there must be no complaint and no request to another host."""
    browser.open(site.address)
    browser.wait(lambda: browser.text("#live").startswith("running"), "the page to be live")
    browser.wait(lambda: browser.count(".node") == site.cameras, "the cameras")
    yield browser
    away = "net::ERR_"  # of a server that a test has stopped
    assert [text for text in browser.complaints() if away not in text] == []
    strange = [
        url for url in browser.asked() if not url.startswith((site.address, "data:", "chrome:"))
    ]
    assert strange == []


def leave(site: Site, bus: Bus, camera: str = "a", seq: int = 0) -> None:
    """Publish an exit now."""
    bus.publish(
        f"event/{camera}",
        Event(camera, "exit", site.now(), 0.9, 0.5, "x", f"live{seq}", 1),
        "event",
    )


def test_the_map_shows_what_was_learned(site: Site, shown: Browser) -> None:
    topology = site.daemon.topology

    assert topology is not None
    names = shown.run(
        "return [...document.querySelectorAll('.node')].map((node) => node.dataset.id)"
    )
    assert sorted(names) == sorted(camera.id for camera in topology.cameras)
    edges = shown.run(
        "return [...document.querySelectorAll('.edge')].map((line) => line.dataset.key)"
    )
    assert sorted(edges) == ["a " + other for other in ("c", DOTTED)]
    assert shown.count(".edge.unseen_path") == 2
    shown.wait(lambda: "s" in shown.text(".labels .time"), "transit times on the edges")
    between = next(
        link
        for link in topology.links
        if link.from_.startswith("a/") and link.to.startswith(DOTTED)
    )
    assert f"{between.transit.mode:.1f}"[:2] in shown.run(
        "return [...document.querySelectorAll('.labels .time')].map((text) => text.textContent).join()"
    )


def test_edges_say_how_many_are_on_their_way(site: Site, shown: Browser) -> None:
    with site.client() as bus:
        for seq in range(8):
            leave(site, bus, seq=300 + seq)
        shown.wait(
            lambda: shown.run(
                "return [...document.querySelectorAll('.labels .time')].some((text) => /· [1-9]/.test(text.textContent))"
            ),
            "a number on an edge",
        )
        shown.go("#/pair/a/c")
        shown.wait(
            lambda: "On the way now: about" in shown.text(".panel"), "the number of the pair"
        )
    shown.go("#/health")
    shown.wait(lambda: "Between cameras" in shown.text(".figures.wide"), "that of the site")


def test_keys_open_a_camera_and_its_link(site: Site, shown: Browser) -> None:
    shown.run("document.querySelector('nav a:last-child').focus()")
    shown.press("TAB")
    reached = shown.run("return document.activeElement.dataset.id")

    assert reached, "Tab reaches a camera"
    for key in ("ARROW_LEFT", "ARROW_RIGHT", "ARROW_UP", "ARROW_DOWN"):
        shown.press(key)
    assert shown.run("return document.querySelectorAll('.node[tabindex=\"0\"]').length") == 1
    shown.run("document.querySelector('.node[data-id=\"a\"]').focus()")
    shown.press("ENTER")
    shown.wait(lambda: shown.text(".panel h2") == "a", "the camera's page")
    assert shown.run("return document.activeElement.tagName") == "H2"
    shown.run("document.querySelector('.panel .links a').focus()")
    assert shown.run("return getComputedStyle(document.activeElement).outlineStyle") == "solid"
    shown.press("ENTER")
    shown.wait(lambda: "→" in shown.text(".panel h2"), "the link's page")
    assert shown.count(".chart .count") > 1
    assert shown.count(".chart .sample") > 20
    assert "appeared next at" in shown.text(".panel .why")
    assert shown.run("return document.querySelector('.chart .curve').getAttribute('d').length") > 40
    shown.press("ESCAPE")
    shown.wait(
        lambda: shown.run("return document.querySelector('.panel').hidden"), "Escape to close it"
    )
    assert shown.run("return document.activeElement.classList.contains('node')")


def test_a_cameras_page_has_its_picture_zones_and_live_events(site: Site, shown: Browser) -> None:
    shown.go("#/camera/a")
    shown.wait(lambda: shown.count(".scene image") == 1, "the picture")
    box = shown.run("return document.querySelector('.scene svg').getAttribute('viewBox')")

    assert [float(part) for part in box.split()] == pytest.approx([-7.2, -5.4, 134.4, 100.8])
    assert shown.count(".scene .zone ellipse") == 2
    with site.client() as bus:
        for seq in range(2, 12):
            leave(site, bus, seq=seq)
            time.sleep(0.1)  # until the page has subscribed
            if shown.count(".scene .event.exit"):
                break
    shown.wait(lambda: shown.count(".scene .event.exit") > 0, "the exit on the picture")
    assert shown.run(
        "return document.querySelector('.event.exit').x.baseVal.value"
    ) == pytest.approx(108, abs=2)


def test_hostile_text_and_odd_names_stay_text(site: Site, shown: Browser) -> None:
    with site.client() as bus:
        bus.publish(
            f"status/{DOTTED}",
            {"camera": DOTTED, "state": "stalled", "reason": HOSTILE, "t": 0.0},
            "status",
        )
        shown.wait(lambda: shown.count(".node.ill") == 1, "the camera to be marked")
        shown.go(f"#/camera/{DOTTED}")
        shown.wait(lambda: shown.text(".panel h2") == DOTTED, "the camera's page")
        shown.wait(lambda: HOSTILE in shown.text(".panel .reason"), "the reason as it is")
        shown.go("#/health")
        shown.wait(lambda: HOSTILE in shown.text(".page table"), "the reason in the table")

    assert shown.count("img, script:not([src])") == 0
    assert "owned" not in shown.run("return document.title")
    shown.go("#/camera/%3Cimg%20src%3Dx%3E")
    shown.wait(
        lambda: "is not in the newest version" in shown.text(".panel"),
        "an unknown camera to be told",
    )
    assert shown.run("return document.querySelector('.panel h2').textContent") == "<img src=x>"
    shown.complaints()  # the 404 it answered is in the browser's log
    shown._complaints[:] = [text for text in shown._complaints if "404" not in text]


@pytest.mark.parametrize("dark", [False, True])
def test_a_phone_has_nothing_to_scroll_sideways(site: Site, shown: Browser, dark: bool) -> None:
    shown.size(360, 740)
    shown.dark(dark)
    for place in ("#/map", "#/camera/a", f"#/pair/a/{DOTTED}", "#/links", "#/versions", "#/health"):
        shown.go(place)
        shown.wait(lambda place=place: shown.run("return location.hash") == place, place)  # type: ignore[misc]
        assert shown.run("return document.documentElement.scrollWidth") <= 360, place
        assert shown.barriers() == [], place
        assert (
            shown.run(
                "return Math.max(...[...document.querySelectorAll('.panel')].map((e) => e.scrollWidth))"
            )
            <= 360
        )
    background = shown.run("return getComputedStyle(document.body).backgroundColor")
    level = sum(int(part) for part in re.findall(r"\d+", background)[:3]) / 3

    assert (level < 60) is dark
    shown.dark(False)


def test_it_is_live_again_after_its_own_server_is_restarted(site: Site, browser: Browser) -> None:
    with site.client() as bus:
        with site.page(bus) as port:
            browser.open(f"http://127.0.0.1:{port}/")
            browser.wait(lambda: browser.text("#live").startswith("running"), "the page to be live")

        browser.wait(lambda: "cannot reach its server" in browser.text(".banner"), "the banner")
        browser.go("#/camera/a")
        browser.wait(lambda: "The server cannot be reached" in browser.text("main"), "its panel")

        # What it could not say is fetched once it is back.
        with site.page(bus, port):
            browser.wait(lambda: browser.text("#live").startswith("running"), "live again")
            browser.wait(lambda: browser.count(".panel .zone") > 0, "the panel by itself")
            assert browser.text(".banner") == ""
    assert [text for text in browser.complaints() if "ncaught" in text] == []


def test_a_report_of_many_cameras_needs_no_server(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report, "LINKS_MAX", 50)
    topology = synthetic_topology(450)
    few = [
        msgspec.structs.replace(link, transitions=5.0) for link in topology.links[:2]
    ]  # both ways of one path
    topology = msgspec.structs.replace(topology, links=[*few, *topology.links[2:]])
    links = sorted(topology.links, key=lambda link: (link.relation == "visible", -link.transitions))
    path = tmp_path / "report.html"
    path.write_text(page(report.gather(topology, [], None)), "utf-8")
    browser.open(path.as_uri())
    browser.wait(lambda: browser.count(".node") == 450, "the cameras")
    browser.wait(lambda: browser.count(".labels .name") > 20, "names, as many as fit")

    assert browser.count(".labels text") < 300
    assert browser.text(".key summary .quiet").startswith(
        f"450 cameras, {len(topology.pairs):,} pairs"
    )
    assert "1 provisional" in browser.text(".key summary .quiet")
    browser.run("document.querySelector('.search input').focus()")
    browser.press("cam042")
    browser.wait(lambda: browser.count(".hits a") == 8, "the first of ten that fit")
    assert browser.count(".node.faint") == 440
    browser.press("TAB")
    assert browser.run("return document.activeElement.textContent") == "cam0420", (
        "the hits are reached by Tab"
    )
    browser.press("ENTER")
    browser.wait(lambda: browser.text(".panel h2") == "cam0420", "the camera found")
    assert browser.count(".node.faint") == 0, (
        "who has found what was looked for sees the whole again"
    )
    browser.wait(lambda: browser.count(".labels .first") == 1, "its name before others")
    assert browser.count(".scene .zone") > 0
    for link, condition in (
        (links[0], lambda: browser.count(".chart .count") > 3),
        (links[60], lambda: "does not contain it" in browser.text(".panel")),
    ):
        browser.go(
            "#/link/"
            + "/".join(quote(part, safe="") for part in (link.from_, link.to, link.relation))
        )
        browser.wait(condition, "the link's chart, or why there is none")
    browser.go("#/versions")
    browser.wait(lambda: "180,000" in browser.text(".page"), "the versions")
    assert browser.complaints() == []
    assert {urlsplit(url).scheme for url in browser.asked()} <= {"file", "data", "about"}
