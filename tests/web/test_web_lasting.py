"""The page over hours, and with little data, in a real browser.

Its texts stay true, keyboard focus stays, and missing parts do not break it.
"""

from __future__ import annotations

import re
import time
from pathlib import Path
from typing import Any
from urllib.parse import quote

import msgspec
import numpy as np
import pytest
from chromium import Browser
from page_fixture import Shown, opened
from synthetic_topology import synthetic_topology

from camtopod.records import (
    Camera,
    EventHours,
    Histogram,
    Link,
    Prediction,
    SeenEvent,
    Topology,
    Transit,
)
from camtopod.topology import LagBins
from camtopod.web import outbox, report
from camtopod.web.single_file import page

SITE = synthetic_topology(9)
FIRST = SITE.cameras[0].id
VISIBLE = next(link for link in SITE.links if link.relation == "visible")
PATH = next(link for link in SITE.links if link.relation == "unseen")
ZONE = msgspec.structs.replace(SITE.zones[0], id="a/1", camera="a", x=None, y=None, cov=None)
BARE = msgspec.structs.replace(
    SITE,
    cameras=[Camera("a", ["a/1"])],
    zones=[ZONE],
    links=[],
    pairs=[],
    model=None,
    alarms=None,
    score=None,
)
PLACES = (
    "#/map",
    "#/links",
    "#/versions",
    "#/versions/1",
    "#/health",
    f"#/camera/{FIRST}",
    "#/camera/a",
    "#/map",
)


def newer(version: int, **changed: Any) -> Topology:
    return msgspec.structs.replace(SITE, version=version, **changed)


def place_of(link: Link) -> str:
    return "#/link/" + "/".join(
        quote(part, safe="") for part in (link.from_, link.to, link.relation)
    )


def test_a_cameras_page_follows_the_versions_and_keeps_its_events(browser: Browser) -> None:
    shown = Shown(SITE)
    with shown.serving():
        opened(browser, shown, f"#/camera/{FIRST}")
        shown.bus.seen = [SeenEvent(time.time(), FIRST, "exit", None, 0.5, 0.5)]
        browser.wait(lambda: browser.count(".event.exit") == 1, "the event")
        zones = [msgspec.structs.replace(zone, entries=777_777) for zone in SITE.zones]
        shown.publish(newer(2, zones=zones))
        browser.wait(lambda: "777,777" in browser.text(".panel table"), "the newer figures")

        assert browser.count(".event.exit") == 1


def test_a_way_grows_longer_than_the_longest_that_was_looked_for(browser: Browser) -> None:
    bins = LagBins(-120.0, 900.0)
    at = bins.first + int(bins.index(np.array([600.0]))[0])
    longer = msgspec.structs.replace(
        PATH,
        transit=Transit(600.0, 600.0, 9.0, 590.0, 600.0, 610.0, 0.1, 0.1),
        histogram=Histogram(at, [90.0]),
    )
    links = [longer if link == PATH else link for link in SITE.links]
    shown = Shown(SITE)
    with shown.serving():
        opened(browser, shown, place_of(PATH))
        curve = "return document.querySelector('.panel svg')?.textContent ?? ''"
        browser.wait(lambda: browser.run(curve) != "", "the transit times")
        before = browser.run(curve)
        assert SITE.model is not None
        shown.publish(
            newer(2, links=links, model=msgspec.structs.replace(SITE.model, lag_max=900.0))
        )
        browser.wait(lambda: "600" in browser.run(curve), "the longer way")
        assert "600" not in before
        browser.go("#/versions")
        browser.wait(lambda: "900 s" in browser.text(".page .figures"), "the longest way")


def test_who_uses_keys_stays_where_they_are(browser: Browser) -> None:
    focused = (
        "const one = document.activeElement; return one.getAttribute('href') ?? one.textContent"
    )
    shown = Shown(SITE)
    with shown.serving():
        opened(browser, shown, f"#/pair/{PATH.from_.split('/')[0]}/{PATH.to.split('/')[0]}")
        browser.wait(lambda: browser.count(".panel .links a") > 0, "the links")
        browser.run("document.querySelector('.panel .links a').focus()")
        before = browser.run(focused)
        links = [msgspec.structs.replace(link, probability=0.11) for link in SITE.links]
        shown.publish(newer(2, links=links))
        browser.wait(lambda: "11 %" in browser.text(".panel .links"), "the newer share")

        assert browser.run(focused) == before
        browser.go("#/links")
        browser.wait(lambda: browser.count(".sort") > 0, "the table")
        browser.run("document.querySelectorAll('.sort')[3].focus()")
        browser.press("ENTER")
        browser.wait(lambda: browser.text("[aria-sort]") == "Share", "the order")
        assert browser.run(focused) == "Share"
        assert (
            browser.run("return document.querySelector('[aria-sort]').getAttribute('aria-sort')")
            == "descending"
        )
        browser.go("#/health")
        browser.wait(lambda: browser.count(".page tbody a") == 9, "the cameras")
        browser.run("document.querySelector('.page tbody a').focus()")
        before = browser.run(focused)
        shown.status(another={"events": 1})
        browser.wait(lambda: browser.count(".page tbody a") == 10, "health asked again")
        assert browser.run(focused) == before


def test_a_server_that_is_not_reached_is_not_one_that_refused_before(
    browser: Browser, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outbox, "PAGES_MAX", 0)
    shown = Shown(SITE)
    with shown.serving():
        shown.status()
        browser.open(shown.address)
        browser.wait(lambda: "too many pages are open" in browser.text(".banner"), "the refusal")
        monkeypatch.setattr(outbox, "PAGES_MAX", 64)
        browser.wait(lambda: browser.text(".banner") == "", "the page to be live")
    browser.wait(lambda: "cannot reach its server" in browser.text(".banner"), "the reason")


def test_a_wrong_clock_of_the_reader_moves_no_time(browser: Browser) -> None:
    late = "const now = Date.now.bind(Date); Date.now = () => now() - 3_600_000;"
    news = Prediction(FIRST, None, time.time(), None, 1, 1.0, [])
    shown = Shown(SITE)
    with shown.serving():
        opened(browser, shown)
        browser.run(f"{late} document.dispatchEvent(new Event('visibilitychange'))")
        shown.bus.publish(f"prediction/{FIRST}", news)
        browser.wait(lambda: browser.count(".predictions .age") == 1, "news, after the time")
    browser.wait(lambda: "Not live since" in browser.text(".banner"), "the banner")
    assert re.search(r"\((now|\d+ s ago)\)", browser.text(".banner")), browser.text(".banner")


HOLD = """
    const [ask, held] = [fetch, arguments[0]];
    window.fetch = async (path, ...options) => {
      const answer = await ask(path, ...options);
      if (path === held && !window.release) await new Promise((ready) => (window.release = ready));
      return answer;
    };
"""
"""The first answer of a path is on its way until `release()`."""


@pytest.mark.parametrize(
    ("path", "place"), [("data/pictures", "#live"), (f"data/camera/{FIRST}", ".panel table")]
)
def test_an_answer_that_comes_late_takes_no_newer_ones_place(
    browser: Browser, path: str, place: str
) -> None:
    shown = Shown(SITE)
    with shown.serving():
        opened(browser, shown, f"#/camera/{FIRST}")
        browser.wait(lambda: browser.text(".panel table") != "", "its zones")
        browser.run(HOLD, path)
        for version in (2, 3):
            zones = [msgspec.structs.replace(zone, entries=version) for zone in SITE.zones]
            shown.publish(newer(version, zones=zones))
            browser.wait(lambda: browser.run("return Boolean(window.release)"), "an answer to wait")
        browser.wait(lambda: browser.text("#live").endswith("version 3"), "the newer map")
        browser.wait(lambda: "\t3\t" in browser.text(".panel table"), "the newer panel")
        newest = browser.text(place)
        browser.run("release(); return new Promise((ready) => setTimeout(ready))")
        assert browser.text(place) == newest


def test_a_way_within_one_view_is_that_whatever_its_address_says(browser: Browser) -> None:
    place = place_of(VISIBLE)
    shown = Shown(SITE)
    with shown.serving():
        opened(browser, shown, place)
        browser.wait(lambda: "objects that enter" in browser.text(".panel .lead"), "the way")
        figures = browser.text(".panel")
        browser.open(shown.address + place.removesuffix("/visible"))
        browser.wait(lambda: browser.text(".panel .lead") != "", "the same way")
        assert browser.text(".panel") == figures


@pytest.mark.parametrize("name", ["constructor", "__proto__"])
def test_a_camera_may_be_named_like_what_objects_inherit(browser: Browser, name: str) -> None:
    shown = Shown(config=f'[cameras.{name}]\nsource = "rtsp://recorder/1"\n')
    hour = time.time() // 3600 * 3600
    shown.bus.hours = EventHours(hour, hour, {})
    with shown.serving():
        opened(browser, shown)
        shown.bus.seen = [SeenEvent(time.time(), name, "entry", None, 0.5, 0.5)]
        browser.wait(lambda: browser.text(".node .today") == "1 in", "its entry")
        assert browser.complaints() == []


@pytest.mark.parametrize(
    "topology", [BARE, newer(1, model=None, alarms=None, score=None), newer(1, links=[])]
)
def test_nothing_that_is_missing_breaks_it(browser: Browser, topology: Topology) -> None:
    shown = Shown(topology)
    with shown.serving():
        opened(browser, shown)
        for place in (*PLACES, place_of(VISIBLE), place_of(PATH)):
            browser.go(place)
            browser.wait(lambda place=place: browser.run("return location.hash") == place, place)  # type: ignore[misc]
            browser.wait(lambda: "…" not in browser.text("main"), "all of it")

    expected = ("404", "net::ERR_", "503")  # and a server that ends takes no page back
    assert [text for text in browser.complaints() if not any(one in text for one in expected)] == []


def test_a_report_of_a_recording_counts_its_seconds(browser: Browser, tmp_path: Path) -> None:
    versions = [newer(k, as_of=400.0 * k) for k in (1, 2)]
    path = tmp_path / "report.html"
    path.write_text(page(report.gather(versions[1], versions[:1], None)), "utf-8")
    browser.open(path.as_uri())
    browser.wait(lambda: browser.text("#live") == "report, version 2, 800 s", "the report")
    browser.go("#/versions")
    browser.wait(lambda: browser.count(".page .mark") == 2, "the versions")
    axis = browser.run(
        "return [...document.querySelectorAll('.axis text')].map((one) => one.textContent)"
    )

    assert {"400 s", "800 s"} <= set(axis)
    assert "1970" not in browser.text("body")
    assert browser.complaints() == []


def contrast(one: str, other: str) -> float:
    """Return the contrast of two colours as a browser computes them (WCAG 2.2)."""

    def light(colour: str) -> float:
        parts = [int(part) / 255 for part in re.findall(r"\d+", colour)[:3]]
        r, g, b = (p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts)
        return 0.2126 * r + 0.7152 * g + 0.0722 * b

    low, high = sorted((light(one), light(other)))
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("dark", [False, True])
def test_what_is_drawn_can_be_seen(browser: Browser, dark: bool) -> None:
    style = "return getComputedStyle(document.querySelector(arguments[0]))[arguments[1]]"
    shown = Shown(SITE)
    with shown.serving():
        browser.dark(dark)
        opened(browser, shown, f"#/camera/{VISIBLE.from_.split('/')[0]}")
        for what in (".passage", ".labels .time", ".labels .name"):
            browser.wait(lambda what=what: browser.count(what) > 0, what)  # type: ignore[misc]
        browser.run(
            "for (const one of document.querySelectorAll('.edge')) one.classList.remove('chosen')"
        )
        ground = browser.run(style, ".stage", "backgroundColor")
        for what, part, least in (
            (".edge.unseen_path", "stroke", 3.0),
            (".edge.overlapped", "stroke", 3.0),
            (".labels .time", "fill", 4.5),
            (".labels .name", "fill", 4.5),
        ):
            assert contrast(browser.run(style, what, part), ground) >= least, what
        browser.dark(False)

        assert float(browser.run(style, ".labels .time", "strokeWidth").removesuffix("px")) >= 10, (
            "a line behind the dot of 1.5 s made it 1:5 s"
        )
        apart = browser.run(
            "const path = document.querySelector('.passage'); const end = path.getPointAtLength(1e9);"
            "return Math.min(...[...document.querySelectorAll('.zone ellipse')].map((one) => {"
            "const { e, f } = one.transform.baseVal.consolidate().matrix; return Math.hypot(e - end.x, f - end.y); }))"
        )
        assert apart > 40, "its head is beside the zone's number, not under it"
