"""A camera's panel: its recorder's page, events an hour, who is in view now; and cameras gone."""

from __future__ import annotations

import time

from chromium import Browser
from model_rows import rows_of, with_rows
from msgspec.structs import replace
from page_fixture import Shown, opened
from synthetic_topology import synthetic_topology

from camtopod.records import (
    Alarm,
    DaemonStatus,
    EventHours,
    InView,
    Look,
    NamesStatus,
    NextCamera,
    Prediction,
    Status,
)

NOW = time.time()
SITE = replace(
    synthetic_topology(4, as_of=NOW),
    alarms=[Alarm(1, NOW, "link_closed", "a/1->b/1", "0.00 since")],
)
WITH_A_CAMERA = "running, 1 alarm, 1 camera needs attention · version 1"
A, B, C = (camera.id for camera in SITE.cameras[:3])


def test_it_links_to_the_recorder_and_counts_events_by_the_hour(browser: Browser) -> None:
    page = "http://frigate.example/#" + A
    shown = Shown(SITE, config=f'[cameras.{A}]\nsource = "0"\npage = "{page}"\n')
    hour = time.time() // 3600 * 3600
    shown.bus.hours = EventHours(hour, hour, {A: [[4, 3]]})
    with shown.serving():
        opened(browser, shown, f"#/camera/{A}")
        browser.wait(lambda: "At the recorder" in browser.text(".panel"), "the link")
        assert browser.run("return document.querySelector('.panel a[target]').href") == page
        browser.wait(lambda: browser.count(".hours .count") in (1, 2), "this hour")
        titles = "return [...document.querySelectorAll('.hours title')].map((one) => one.textContent).join()"
        assert "7 events" in browser.run(titles)
        browser.go(f"#/camera/{B}")
        browser.wait(lambda: browser.text(".panel h2") == B, "another camera")
        assert "At the recorder" not in browser.text(".panel")

        assert browser.complaints() == []


def test_the_header_leads_to_a_camera_that_needs_attention(browser: Browser) -> None:
    shown = Shown(SITE)
    with shown.serving():
        opened(browser, shown)
        browser.wait(
            lambda: browser.text("#live") == "running, 1 alarm · version 1", "all to be well"
        )
        assert browser.count("nav .ill") == 0
        shown.bus.publish(f"status/{A}", Status("stalled", "no picture for 9 s"))
        browser.run("document.querySelector('#live').click()")  # which asks for the health
        browser.wait(lambda: browser.text("#live") == WITH_A_CAMERA, "it")
        assert browser.text(".page h1") == "Health"
        assert browser.text("nav .ill") == "Health"
        shown.bus.publish(f"status/{A}", Status("running"))
        browser.go("#/map")
        browser.go("#/health")
        browser.wait(lambda: browser.count("nav .ill") == 0, "the end of it")


def test_the_page_shows_the_words_that_it_is_sent(browser: Browser) -> None:
    """As on every other display: see test_states."""
    names = NamesStatus(forgotten={A: 3})
    warned = DaemonStatus("running", status_seconds=3600.0, names=names, warnings=["a sentence"])
    shown = Shown(SITE)
    with shown.serving():
        opened(browser, shown)
        assert browser.count("#live.warn") == 1, "an alarm is open"
        shown.bus.publish("status/daemon", warned)
        shown.bus.publish(f"status/{A}", Status("running"))
        shown.bus.publish(f"status/{B}", Status("stalled", "no picture"))
        browser.go("#/health")
        browser.wait(lambda: browser.text("#live") == WITH_A_CAMERA, "the header")
        assert browser.count("#live.bad") == 1
        assert "running, 1 alarm, 1 camera needs attention" in browser.text(".page .card h2")
        assert browser.text(".page .card .reason") == "a sentence"
        look = (
            "return [...document.querySelectorAll('tbody tr')].map((row) => [row.querySelector('a')"
        )
        look += ".textContent, row.querySelector('.pill').textContent, row.querySelector('.pill').className])"
        rows = {name: (state, pill) for name, state, pill in browser.run(look)}
        assert rows[A] == ("forgotten", "pill off")
        assert rows[B] == ("stalled", "pill bad")
        assert next(iter(rows)) == B, "what needs attention comes first"
        assert browser.complaints() == []


POINT = """
const { x, y, width, height } = document.querySelector(arguments[0]).getBoundingClientRect();
const at = { clientX: x + width / 2, clientY: y + height / 2 };
document.querySelector('svg.map').dispatchEvent(new PointerEvent('pointermove', at));
"""


def test_a_camera_that_is_forgotten_leaves_its_open_panel(browser: Browser) -> None:
    shown = Shown(SITE)
    without = replace(
        SITE,
        version=2,
        cameras=[camera for camera in SITE.cameras if camera.id != A],
        zones=[zone for zone in SITE.zones if zone.camera != A],
        links=[link for link in SITE.links if A not in f"{link.from_}/{link.to}".split("/")],
        pairs=[pair for pair in SITE.pairs if A not in pair.cameras],
        model=None,
    )
    with shown.serving():
        opened(browser, shown, f"#/camera/{A}")
        browser.wait(lambda: browser.count(".panel .zone") > 0, "its zones")
        browser.run(POINT, f"[data-id={A}] circle")
        assert A in browser.text(".tip")
        shown.publish(without)
        browser.wait(lambda: "not in the newest version" in browser.text(".panel"), "the news")
        assert browser.count(".panel .zone") == 0
        assert browser.text(".tip") == ""
        shown.publish(replace(SITE, version=3))
        browser.wait(lambda: browser.count(".panel .zone") > 0, "the camera again")


OVERLAPPING = """
const texts = [...document.querySelectorAll('.zone text')].map((one) => one.getBoundingClientRect());
const apart = (a, b) => a.right <= b.left || b.right <= a.left || a.bottom <= b.top || b.bottom <= a.top;
const inner = texts.map(({ left, right, top, bottom }) => {
  const air = 0.2 * (bottom - top);
  return { left, right, top: top + air, bottom: bottom - air };
});
return inner.filter((a, k) => inner.slice(k + 1).some((b) => !apart(a, b))).length;
"""


def test_counts_of_zones_stand_beside_each_other(browser: Browser) -> None:
    numbers = range(50, 72)
    zones = [*SITE.zones] + [
        replace(
            SITE.zones[0],
            id=f"{A}/{k}",
            x=0.1 + 0.08 * (k % 10),
            y=0.2 + 0.06 * (k // 10),
            entries=30 * k,
            exits=20 * k,
        )
        for k in numbers
    ]
    ids = [zone.id for zone in zones]
    cameras = [
        replace(one, zones=[id for id in ids if id.startswith(f"{one.id}/")])
        for one in SITE.cameras
    ]
    shown = Shown(with_rows(replace(SITE, cameras=cameras, zones=zones), rows_of(SITE)))
    with shown.serving():
        opened(browser, shown, f"#/camera/{A}")
        browser.wait(lambda: browser.count(".scene .zone") > len(numbers), "the zones")
        assert browser.run(OVERLAPPING) == 0
        assert f"{A}/71: 2,130 in" in browser.run(
            "return document.querySelector('.scene .zone title').textContent"
        )


def test_who_left_one_view_and_is_in_another_is_shown_at_both(browser: Browser) -> None:
    shown = Shown(SITE)
    seen = InView(B, "x", time.time() - 3.0, 0.83)
    said = Prediction(A, None, time.time(), "y", 1, 0.2, [], [Look(B, 0.9)], [seen])
    with shown.serving():
        opened(browser, shown, f"#/camera/{B}")
        browser.wait(lambda: browser.count(".scene") == 1, "the camera")

        def told() -> bool:
            shown.bus.publish(f"prediction/{A}", said)
            return f"who left {A} is in view now (83 %)" in browser.text(".panel")

        browser.wait(told, "who is in view")
        assert browser.count(f".node.sees[data-id={B}]") == 1
        follows = [NextCamera(B, f"{B}/1", 0.8, -9.0, 1.0, 4.0)]
        later = replace(said, zone=f"{A}/1", in_view=None, next=follows)
        shown.bus.publish(f"prediction/{A}", later)
        where = f"{A} → {B} 80 %, within 4 s; leaves the site 20 %"
        browser.wait(lambda: where in browser.text(".predictions"), "where to look")
        browser.wait(lambda: browser.count(".node.sees") == 0, "the mark to go")
