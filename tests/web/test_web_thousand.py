"""The live page of a site with a thousand cameras, in a real browser."""

from __future__ import annotations

import time

import msgspec
from chromium import Browser
from page_fixture import Shown
from synthetic_topology import synthetic_topology

from camtopod.records import NextCamera, Prediction

CAMERAS = 1000
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
    site = synthetic_topology(CAMERAS)
    path = next(link for link in site.links if link.relation == "unseen")
    cameras = [end.split("/")[0] for end in (path.from_, path.to)]
    shown = Shown(site)
    with shown.serving():
        shown.status()
        browser.open(shown.address)
        browser.wait(lambda: browser.count(".node") == CAMERAS, "a thousand cameras")
        browser.wait(lambda: browser.text("#live").endswith("· version 1"), "the page to be live")
        assert browser.count(".edge") == len(site.pairs)

        # No camera is under what lies on the map, and none is kept away further than need be.
        browser.run("document.querySelector('.predictions').hidden = false")
        browser.wait(lambda: browser.run(COVERED) == 0, "room")
        assert browser.run(WIDTH) > 700

        # Predictions move.
        next_ = NextCamera(cameras[1], path.to, 0.9, 20.0, 30.0, 40.0)
        said = Prediction(cameras[0], path.from_, time.time(), "x", 1, 0.1, [next_])
        shown.bus.publish(f"prediction/{cameras[0]}", said)
        browser.wait(lambda: browser.count("circle.dot") > 0, "a dot under way")
        before = browser.run(DOT)
        browser.wait(lambda: browser.run(DOT) != before, "the dot to move")

        # A new version takes the place of the old one.
        ends = {path.from_, path.to}
        links = [link for link in site.links if {link.from_, link.to} != ends]
        pairs = [pair for pair in site.pairs if set(pair.cameras) != set(cameras)]
        shown.publish(msgspec.structs.replace(site, version=2, links=links, pairs=pairs))
        browser.wait(lambda: browser.text("#live").endswith("· version 2"), "the new version")
        assert browser.count(".edge") == len(site.pairs) - 1

        browser.go("#/health")
        browser.wait(lambda: browser.text(".page").count("cam0") > 100, "the cameras' health")
        assert "1,000 cameras" in browser.text(".page")

        assert browser.complaints() == []
