"""The live page of a site with a thousand cameras, in a real browser."""

from __future__ import annotations

import time

import msgspec
from chromium import Browser
from page_fixture import Shown
from synthetic_topology import synthetic_topology

from camtopod.records import NextCamera, Prediction

CAMERAS = 1000
SITE = synthetic_topology(CAMERAS)
PATH = next(link for link in SITE.links if link.relation == "unseen")
FROM = PATH.from_.split("/")[0]
TO = PATH.to.split("/")[0]
COVERED = """
const boxes = (selector) => [...document.querySelectorAll(selector)].map((one) => one.getBoundingClientRect());
const upon = (a, b) => a.left < b.right && b.left < a.right && a.top < b.bottom && b.top < a.bottom;
const over = boxes('.overlay');
return boxes('.node circle, .labels text').filter((one) => over.some((box) => upon(one, box))).length;
"""
WIDTH = """
const all = [...document.querySelectorAll('.node circle')].map((one) => one.getBoundingClientRect().x);
return Math.max(...all) - Math.min(...all);
"""
DOT = """
const dot = document.querySelector('circle.dot');
return dot && [dot.cx, dot.cy].map((c) => c.baseVal.value);
"""


def test_a_thousand_cameras_are_shown_live(browser: Browser) -> None:
    shown = Shown(SITE)
    with shown.serving():
        shown.status()
        browser.open(shown.address)
        browser.wait(lambda: browser.count(".node") == CAMERAS, "a thousand cameras")
        browser.wait(lambda: browser.text("#live").endswith("· version 1"), "the page to be live")
        assert browser.count(".edge") == len(SITE.pairs)

        # No camera is under what lies on the map, and none is kept away further than need be.
        browser.run("document.querySelector('.predictions').hidden = false")
        browser.wait(lambda: browser.run(COVERED) == 0, "room")
        assert browser.run(WIDTH) > 700

        # Predictions move.
        next_ = NextCamera(TO, PATH.to, 0.9, 20.0, 30.0, 40.0)
        said = Prediction(FROM, PATH.from_, time.time(), "x", 1, 0.1, [next_])
        shown.bus.publish(f"prediction/{FROM}", said)
        browser.wait(lambda: browser.count("circle.dot") > 0, "a dot under way")
        before = browser.run(DOT)
        browser.wait(lambda: browser.run(DOT) != before, "the dot to move")

        # A new version takes the place of the old one.
        ends = {PATH.from_, PATH.to}
        links = [link for link in SITE.links if {link.from_, link.to} != ends]
        pairs = [pair for pair in SITE.pairs if set(pair.cameras) != {FROM, TO}]
        shown.publish(msgspec.structs.replace(SITE, version=2, links=links, pairs=pairs))
        browser.wait(lambda: browser.text("#live").endswith("· version 2"), "the new version")
        assert browser.count(".edge") == len(SITE.pairs) - 1

        browser.go("#/health")
        browser.wait(lambda: browser.text(".page").count("cam0") > 100, "the cameras' health")
        assert "1,000 cameras" in browser.text(".page")

        assert browser.complaints() == []
