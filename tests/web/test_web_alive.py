"""What lives on the page: pulses, counts of today, walks, and the replay; the same in one file."""

from __future__ import annotations

import json
import re
import time
from pathlib import Path

import pytest
from chromium import Browser
from msgspec.structs import replace
from page_fixture import Shown, opened
from serving import wait_for
from synthetic_topology import synthetic_topology

from camtopod.records import (
    Alarm,
    EventHours,
    Kind,
    Match,
    MatchedPassage,
    NextCamera,
    Prediction,
    SeenEvent,
    Topology,
)
from camtopod.web import app, growth

SITE = synthetic_topology(4, version=3, as_of=time.time())
WAY = next(link for link in SITE.links if link.relation == "unseen")
A, B = WAY.from_.split("/")[0], WAY.to.split("/")[0]
PAIRS = {" ".join(sorted(pair.cameras)): pair.relation for pair in SITE.pairs}
WATCH = """
    window.shown = []; // of each dot and pulse its look, and how far it is right of the middle of arguments[0]
    window.edges = new Set(); // how many edges there have been
    const middle = (one) => one.getBoundingClientRect().x + one.getBoundingClientRect().width / 2;
    const node = document.querySelector(`[data-id=${arguments[0]}] circle`);
    new MutationObserver((changes) => {
      edges.add(document.querySelectorAll(".edge").length);
      for (const one of changes.flatMap((change) => [...change.addedNodes]))
        if (one.matches?.(".pulse, .dot")) shown.push([one.getAttribute("class"), middle(one) - middle(node)]);
    }).observe(document.querySelector(".map"), { childList: true, subtree: true });
"""
"""What is shown for a moment only, a slow machine would miss."""
DRAG = """
    const bar = document.querySelector(".replay input");
    bar.value = arguments[0];
    bar.dispatchEvent(new Event("input"));
"""


def older(version: int, pairs: int) -> Topology:
    return replace(
        SITE, version=version, as_of=SITE.as_of - 60.0 * (3 - version), pairs=SITE.pairs[:pairs]
    )


def seen(camera: str, kind: Kind, t: float, x: float = 0.5) -> SeenEvent:
    return SeenEvent(t, camera, kind, None, x, 0.5)


def test_an_entry_is_a_pulse_where_it_was_and_one_more_today(browser: Browser) -> None:
    shown = Shown(SITE)
    hour = time.time() // 3600 * 3600
    shown.bus.hours = EventHours(hour, hour, {A: [[41, 7]]})
    with shown.serving():
        opened(browser, shown)
        today = f"[data-id={A}] .today"
        browser.wait(lambda: browser.text(today) == "41 in", "the entries of today")
        browser.run(WATCH, A)
        now = time.time()
        shown.bus.seen = [
            SeenEvent(now, A, "entry", None, 0.9, 0.5),
            SeenEvent(now, A, "exit", None, 0.1, 0.5),
            SeenEvent(now - 600.0, A, "exit", None, 0.1, 0.5),
        ]
        browser.wait(lambda: browser.text(today) == "42 in", "one more")
        told = f"return document.querySelector('[data-id={A}]').getAttribute('aria-label')"
        assert "42 entries today" in browser.run(told)
        (entry, right), (exit_, left) = browser.run("return shown")
        assert (entry, exit_) == ("pulse entry", "pulse exit"), "one of ten minutes ago is no news"
        assert right > 4 > -4 > left
        browser.wait(lambda: browser.count(".pulse") == 0, "the pulses to go")
        assert browser.complaints() == []


def test_a_walk_goes_on_along_the_map_and_is_shown_on_it(browser: Browser) -> None:
    shown = Shown(SITE)
    now = time.time()
    before = MatchedPassage(A, now - 5.0, 0.93, "somebody")
    match = Match(B, now, 3, [before], 0.07, f"{A}@{now - 20.0}", "somebody")
    with shown.serving():
        opened(browser, shown)
        assert browser.text(".walks") == ""
        shown.bus.publish(f"match/{B}", match)
        browser.wait(lambda: browser.count(".dot.walk.late") == 1, "the dot to arrive")
        browser.wait(lambda: browser.text(".walks summary") == "Walks", "the list")
        browser.run("document.querySelector('.walks').open = true")
        line = rf"{A} \d\d:\d\d:\d\d → {B} \d\d:\d\d:\d\d, 93 %"
        assert re.fullmatch(line, browser.text(".walks li")), browser.text(".walks li")
        assert browser.text(".predictions ul") == "", "one list at a time"

        at = "return [...arguments].map((one) => document.querySelector(one).getBoundingClientRect())"

        def has_arrived() -> bool:
            dot, camera = browser.run(at, ".dot.walk", f"[data-id={B}] circle")
            aside = abs(dot["x"] + dot["width"] / 2 - camera["x"] - camera["width"] / 2)
            return bool(aside < 2 and dot["y"] < camera["y"] < dot["y"] + dot["height"])

        browser.wait(has_arrived, "it at the camera's upper edge; the map makes room for the list")
        browser.run("document.querySelector('.walks a').click()")
        browser.wait(lambda: browser.count(".node.chosen") == 2, "its cameras")
        assert browser.count(".edge.chosen") == 1
        again = replace(match, from_=[replace(before, probability=0.4)], walk=f"{B}@{now}")
        shown.bus.publish(f"match/{B}", again)
        browser.wait(lambda: browser.text(".walks") == "", "no walk any more")
        assert browser.complaints() == []


def test_walks_of_one_picture_are_two_and_stay_when_the_page_asks_for_them(
    browser: Browser,
) -> None:
    shown = Shown(SITE)
    now = round(time.time(), 3)
    other = next(camera.id for camera in SITE.cameras if camera.id not in (A, B))
    begin = f"{A}@{now - 9.0}"
    entries = [Match(A, now - 9.0, 3, [], 1.0, name, name) for name in (begin, f"{begin}/2")]
    before = [MatchedPassage(A, now - 9.0, 0.9, match.track) for match in entries]
    matches = [
        Match(B, now - 1.0, 3, before[:1], 0.1, begin, "one"),
        Match(other, now, 3, before[1:], 0.1, f"{begin}/2", "another"),
        Match(other, now, 3, before[:1], 0.1, f"{B}@{now - 99.0}", "a third"),
    ]
    line = r"\S+ \d\d:\d\d:\d\d → \S+ \d\d:\d\d:\d\d, 90 %"
    with shown.serving():
        opened(browser, shown)
        for match in entries + matches:
            shown.bus.publish(f"match/{match.camera}", match)
        browser.run("document.querySelector('.walks').open = true")

        def walks() -> list[str]:
            lines = "return [...document.querySelectorAll('.walks li')].map((one) => one.innerText)"
            return [str(one) for one in browser.run(lines)]

        browser.wait(lambda: len(walks()) == 3, "each walk")
        assert all(re.fullmatch(line, one) for one in walks()), walks()
        browser.run("document.querySelector('.walks ul').replaceChildren()")
        shown.publish(replace(SITE, version=4))  # upon which the page asks
        browser.wait(lambda: len(walks()) == 3, "each walk again")
        assert browser.complaints() == []


def test_a_walk_through_a_forgotten_camera_leaves_the_page(browser: Browser) -> None:
    shown = Shown(SITE)
    now = time.time()
    other = next(camera.id for camera in SITE.cameras if camera.id not in (A, B))
    with shown.serving():
        opened(browser, shown)
        for t, camera in ((now - 2.0, A), (now, other)):
            came = [MatchedPassage(camera, t - 1.0, 0.9)]
            match = Match(B, t, 3, came, 0.1, f"{camera}@{now - 20.0}")
            shown.bus.publish(f"match/{B}", match)
        browser.run("document.querySelector('.walks').open = true")
        browser.wait(lambda: browser.count(".walks li") == 2, "both walks")
        browser.run("document.querySelector('.walks li:last-child a').click()")
        browser.wait(lambda: browser.count(".node.chosen") == 2, "the older one on the map")
        shown.bus.publish("status/daemon", {"state": "running", "names": {"forgotten": {A: 0}}})
        shown.publish(replace(SITE, version=4))
        browser.wait(lambda: browser.count(".walks li") == 1, "one less")
        assert A not in browser.text(".walks li")
        browser.wait(lambda: browser.count(".node.chosen") == 0, "nothing to be marked")
        assert browser.complaints() == []


def test_the_last_hour_is_replayed_and_so_is_how_the_map_grew(browser: Browser) -> None:
    shown = Shown(older(1, 0), older(2, 1), SITE)
    now = time.time()
    shown.bus.told = [
        seen(A, "exit", now - 3550.0),
        seen(B, "entry", now - 3550.0 + WAY.transit.q50),
    ]
    doubtful = MatchedPassage(A, now - 3550.0, 0.4)
    sure = replace(doubtful, probability=0.9)
    match = Match(B, now - 3550.0 + WAY.transit.q50, 3, [doubtful], 0.6, f"{B}@1")
    with shown.serving(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(app, "MATCHES_SHOWN", 1)  # of those that a page begins with
        for entry in (replace(match, from_=[sure]), replace(match, t=now - 3549.0)):
            shown.bus.publish(f"match/{B}", entry)
        opened(browser, shown)
        browser.run(WATCH, A)
        browser.run("document.querySelector('.replay').open = true")
        press = "document.querySelectorAll('.replay button')[arguments[0]].click()"
        browser.run(press, 0)
        browser.wait(lambda: browser.count("circle.dot") == 1, "the first event at once, its way")
        browser.run(DRAG, 1000 * (WAY.transit.q50 - 0.1) / (WAY.transit.q50 + 1.0))
        browser.wait(lambda: browser.text(f"[data-id={B}] .today") == "1 in", "the entry")
        assert browser.text(f"[data-id={A}] .today") == "0 in", "only what is replayed"
        looks = {look for look, _ in browser.run("return shown")}
        assert looks == {"pulse exit", "dot walk", "pulse entry"}
        browser.run(press, 2)
        browser.wait(lambda: "The last hour" in browser.text(".replay"), "the end")

        browser.run(press, 1)
        counts = {0, 1, len(SITE.pairs)}
        browser.wait(lambda: counts <= set(browser.run("return [...edges]")), "the versions")
        assert browser.complaints() == []


def test_a_new_version_waits_until_the_replay_of_older_ones_is_over(browser: Browser) -> None:
    shown = Shown(older(1, 0), older(2, 0), SITE)
    with shown.serving():
        opened(browser, shown)
        browser.wait(lambda: browser.count(".edge") == len(SITE.pairs), "the map")
        browser.run("document.querySelector('.replay').open = true")
        browser.run("performance.now = () => 1e6")  # the replay stands at its begin
        browser.run("document.querySelectorAll('.replay button')[1].click()")
        browser.wait(lambda: browser.count(".edge") == 0, "the first version")
        shown.publish(replace(SITE, version=4))
        browser.wait(lambda: "version 4" in browser.text("#live"), "a new one")
        assert browser.count(".edge") == 0
        browser.run("document.querySelectorAll('.replay button')[2].click()")
        browser.wait(lambda: browser.count(".edge") == len(SITE.pairs), "it")


def test_no_walk_from_before_the_first_event_is_replayed(browser: Browser) -> None:
    shown = Shown(SITE)
    now = time.time()
    shown.bus.told = [seen(A, "exit", now - 60.0), seen(B, "entry", now - 50.0)]
    with shown.serving():
        for t in (now - 3000.0, now - 50.0):
            before = MatchedPassage(A, t - 10.0, 0.9)
            shown.bus.publish(f"match/{B}", Match(B, t, 3, [before], 0.1, f"{A}@{t - 10.0}"))
        opened(browser, shown)
        browser.run("document.querySelector('.replay').open = true")
        browser.run(WATCH, A)
        browser.run("document.querySelector('.replay button').click()")
        browser.wait(lambda: "Stop" in browser.text(".replay"), "its begin")
        assert [look for look, _ in browser.run("return shown")].count("dot walk") == 1


def test_a_second_press_begins_no_second_replay(browser: Browser) -> None:
    shown = Shown(SITE)
    shown.bus.told = [seen(A, "exit", time.time() - t) for t in (3550.0, 50.0)]
    with shown.serving():
        opened(browser, shown)
        browser.run("document.querySelector('.replay').open = true")
        press = "const button = document.querySelector('.replay button'); button.click(); "
        browser.run(press + "button.click()")
        browser.wait(lambda: "Stop" in browser.text(".replay"), "the replay")
        assert sum("data/recent" in address for address in browser.asked()) == 1


def test_a_recording_is_dated_by_its_events(browser: Browser) -> None:
    t = 1_700_000_000.0
    alarm = Alarm(1, t, "camera_silent", B, "no event")
    shown = Shown(replace(synthetic_topology(4, as_of=t), alarms=[alarm]))
    shown.bus.hours = EventHours(t, t // 3600 * 3600, {A: [[5, 0]]})
    with shown.serving():
        opened(browser, shown)
        shown.status(**{A: {"events": 5, "newest": t}})
        browser.wait(lambda: "recording of 14 November 2023" in browser.text("#live"), "its day")
        browser.wait(lambda: browser.text(f"[data-id={A}] .today") == "5 in", "those of that day")
        told = f"return document.querySelector('[data-id={A}]').getAttribute('aria-label')"
        browser.wait(lambda: "5 entries on 14 November 2023" in browser.run(told), "the day")
        browser.run("document.querySelector('.key').open = true")
        assert "entries on 14 November 2023" in browser.text(".key")
        browser.go("#/health")
        browser.wait(lambda: "2023-11-14" in browser.text(".page table"), "its last event")


def test_a_camera_with_an_open_alarm_is_marked_wherever_it_is_shown(browser: Browser) -> None:
    alarm = Alarm(1, SITE.as_of, "camera_silent", B, "no event")
    shown = Shown(replace(SITE, alarms=[alarm]))
    with shown.serving():
        opened(browser, shown)
        words = "running, 1 alarm, 1 camera needs attention"
        browser.wait(lambda: browser.text("#live").startswith(words), "the header")
        browser.wait(lambda: browser.count(".node.ill") == 1, "the map")
        assert browser.count(f".node.ill[data-id={B}]") == 1
        browser.go("#/health")
        browser.wait(lambda: "1 needs attention" in browser.text(".page"), "their number")
        assert f"camera silent {B}: no event" in browser.text(".page tbody tr")


def test_objects_between_cameras_are_counted_once_there_was_an_event(browser: Browser) -> None:
    shown = Shown(SITE)
    since = time.time()
    between = {"t": since, "since": since, "number": 0.0, "low": 0, "high": 0}

    def tell(newest: float) -> None:
        cameras = {A: {"events": 5, "newest": newest, "alive": True}}
        status = {"state": "running", "status_seconds": 3600.0, "cameras": cameras}
        shown.bus.publish("status/daemon", {**status, "between": between})

    with shown.serving():
        opened(browser, shown, "#/health")
        tell(since - 5.0)
        browser.wait(lambda: "other program" in browser.text(".page"), "the camera")
        assert "Between cameras" not in browser.text(".page")
        tell(since + 0.1)
        browser.wait(lambda: "about 0.0, 0 to 0" in browser.text(".page"), "a number")


def test_a_prediction_ages_and_leaves_though_the_time_of_a_recording_stands(
    browser: Browser,
) -> None:
    t = 1_700_000_000.0
    shown = Shown(synthetic_topology(4, as_of=t))
    with shown.serving():
        opened(browser, shown)
        shown.status(**{A: {"events": 5, "newest": t}})
        browser.wait(lambda: "recording" in browser.text("#live"), "the recording")
        rows = [
            NextCamera(B, f"{B}/1", 0.2, 5.0, 7.0, 9.0),
            NextCamera(B, f"{B}/2", 0.1, 5.0, 90.0, 600.0, prior=True),
            NextCamera("c", "c/2", 0.005, 5.0, 90.0, 600.0),
        ]
        shown.bus.publish(f"prediction/{A}", Prediction(A, f"{A}/1", t - 3.0, None, 1, 0.7, rows))
        browser.wait(lambda: "leaves the site 70 %" in browser.text(".predictions"), "the exit")
        browser.wait(lambda: "5 s ago" in browser.text(".predictions .age"), "its age")
        browser.run("const now = performance.now(); performance.now = () => now + 11000")
        browser.wait(lambda: "No open predictions" in browser.text(".predictions"), "the end")


def test_a_page_that_comes_back_lists_each_prediction_once(browser: Browser) -> None:
    shown = Shown(SITE)
    now = time.time()
    rows = [NextCamera(B, f"{B}/1", 0.8, 5.0, 7.0, 600.0)]
    with shown.serving():
        opened(browser, shown)
        shown.bus.publish(f"prediction/{A}", Prediction(A, None, now - 1.0, None, 1, 0.2, rows))
        browser.wait(lambda: browser.count(".predictions .age") == 1, "the prediction")
        browser.run("document.dispatchEvent(new Event('visibilitychange'))")
        shown.bus.publish(f"prediction/{A}", Prediction(A, None, now, None, 1, 0.2, rows))
        browser.wait(lambda: browser.count(".predictions .age") > 1, "what it has missed")
        assert browser.count(".predictions .age") == 2


def test_growth_is_of_the_versions_that_the_daemon_has_kept() -> None:
    shown = Shown(older(2, 1), SITE)
    with shown.serving():
        wait_for(lambda: bool(shown.json("/data/versions")), "the newest version")
        told = shown.json("/data/growth")

    assert [one["version"] for one in told] == [2, 3], "the first one is not kept"
    assert [len(one["pairs"]) for one in told] == [1, len(SITE.pairs)]
    assert told[-1]["pairs"] == PAIRS
    assert growth.thinned(range(1, 1000))[:2] == [1, 27]
    assert growth.thinned(range(1, 1000))[-1] == 999
    assert growth.thinned(range(0)) == []


def test_a_replay_joins_nothing_that_the_daemon_has_not(browser: Browser) -> None:
    shown = Shown(SITE)
    now = time.time()
    shown.bus.told = [
        seen(A, "exit", now - 3550.0),
        seen(B, "entry", now - 3550.0 + WAY.transit.q50),
    ]
    with shown.serving():
        opened(browser, shown)
        browser.run(WATCH, A)
        browser.run("document.querySelector('.replay button').click()")
        browser.wait(lambda: len(browser.run("return shown")) > 0, "the exit")
        browser.run(DRAG, 1000 * (WAY.transit.q50 + 0.1) / (WAY.transit.q50 + 1.0))
        browser.wait(lambda: browser.text(f"[data-id={B}] .today") == "1 in", "the entry")
        assert {look for look, _ in browser.run("return shown")} <= {"pulse exit", "pulse entry"}


def test_one_file_has_the_last_hour_and_no_walk(browser: Browser, tmp_path: Path) -> None:
    shown = Shown(older(2, 1), SITE)
    now = time.time()
    times = [now - 3550.0, now - 3550.0 + WAY.transit.q50]
    shown.bus.told = [seen(A, "exit", times[0]), seen(B, "entry", times[1])]
    with shown.serving():
        wait_for(lambda: bool(shown.json("/data/versions")), "the newest version")
        shown.bus.publish(f"match/{B}", Match(B, now, 3, [], 1.0, f"{B}@{now}", "somebody"))
        answer = shown.ask("/report.html")
    assert answer.headers["content-disposition"] == "attachment"
    held = json.loads(re.findall(r'id="report">(.*?)</script>', answer.text)[0])
    assert [one["t"] for one in held["recent"]["events"]] == times
    assert [one["version"] for one in held["growth"]] == [2, 3]
    assert f"{B}@" not in answer.text
    assert '"track"' not in answer.text

    (tmp_path / "report.html").write_text(answer.text, "utf-8")
    browser.open((tmp_path / "report.html").as_uri())
    browser.wait(lambda: browser.count(".node") == 4, "the cameras")
    browser.run(WATCH, A)
    browser.run("document.querySelector('.replay button').click()")
    browser.wait(lambda: bool(browser.run("return shown")), "the exit")
    browser.run(DRAG, 1000)
    browser.wait(lambda: len(browser.run("return shown")) == 2, "the exit and the entry")
    assert {look for look, _ in browser.run("return shown")} == {"pulse exit", "pulse entry"}
    assert browser.complaints() == []
