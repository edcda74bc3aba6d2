"""The page of a site that has just begun: what it waits for, its pictures, and how far it is."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np
import pytest
from chromium import Browser
from model_rows import with_rows
from msgspec.structs import replace
from page_fixture import Shown, opened
from synthetic_topology import made_link, synthetic_topology

from camtopod.records import Lacks, NextCamera, Prediction, SeenEvent
from camtopod.web.map_data import draw

SITE = synthetic_topology(4)
NAMES = [camera.id for camera in SITE.cameras]
A, B = SITE.zones[0], SITE.zones[-1]
LIKELY = replace(made_link(A.id, B.id, 20.0, 4.0), q_value=0.5, lacks=Lacks(3.0, 1800.0))
YOUNG = with_rows(replace(SITE, links=[], pairs=[]), weak=[LIKELY])

HIDDEN = """
const boxes = (all) =>
  [...document.querySelectorAll(all)].map((one) => one.getBoundingClientRect()).filter((box) => box.width);
const stage = document.querySelector(".stage").getBoundingClientRect();
return boxes(".node > image, .node > circle").filter((camera) =>
  camera.left < stage.left || camera.right > stage.right || boxes(".overlay").some((box) =>
    box.left < camera.right && camera.left < box.right && box.top < camera.bottom && camera.top < box.bottom)).length;
"""
"""How many cameras are out of sight, or under something."""


def test_before_the_first_version_configured_cameras_and_events_are_shown(
    browser: Browser, tmp_path: Path
) -> None:
    cv2.imwrite(str(tmp_path / "a.jpg"), np.full((90, 160, 3), 120, np.uint8))
    shown = Shown(pictures=tmp_path, config='[cameras.a]\nsource = "a.mp4"\n')
    with shown.serving():
        opened(browser, shown)
        browser.wait(lambda: browser.count(".node.pictured image") == 1, "the picture")
        browser.wait(lambda: "No camera has sent an event yet" in browser.text(".waiting"), "why")
        now = time.time()
        shown.status(a={"events": 3, "newest": now}, b={"events": 4, "newest": now, "alive": True})
        browser.wait(lambda: browser.count(".node") == 2, "the other one")
        shown.bus.seen = [SeenEvent(now, "b", "entry", None, 0.5, 0.5)]
        browser.wait(lambda: browser.count(".pulse") == 1, "its entry")
        browser.wait(lambda: "7 events from 2 cameras so far" in browser.text(".waiting"), "them")
        browser.go("#/camera/a")
        browser.wait(lambda: "No zone has been learned yet" in browser.text(".panel"), "the panel")
        assert browser.complaints() == []


def test_what_is_likely_and_what_is_not_known_are_told_apart(browser: Browser) -> None:
    """Nobody is said to leave the site before that is known, and half a chance is no fact."""
    exits = {A.id: 100, B.id: 99}
    zones = [replace(zone, exits=exits.get(zone.id, 0)) for zone in SITE.zones]
    shown = Shown(with_rows(replace(YOUNG, zones=zones), weak=[]))
    with shown.serving():
        opened(browser, shown)
        for camera, leave, share, words in (
            (A.camera, 0.9, 0.1, "leaves the site 90 %; west 10 %, in 5 to 9 s"),
            (B.camera, 0.9, 0.1, "not known yet"),
            (A.camera, 0.35, 0.19, "perhaps west 19 %, in 5 to 9 s; leaves the site 35 %"),
            (B.camera, 0.3, 0.6, "west 60 %, in 5 to 9 s"),
        ):
            next_ = [NextCamera("west", "west/1", share, 5.0, 7.0, 9.0)]
            young = camera == B.camera
            said = Prediction(
                camera, f"{camera}/1", time.time(), None, 1, leave, next_, prior=young
            )

            def told(said: Prediction = said, words: str = f"{camera} → {words}") -> bool:
                shown.bus.publish(f"prediction/{said.camera}", said)
                return words in browser.text(".predictions")

            browser.wait(told, words)
        old = replace(said, t=time.time() - 10.5)
        for _ in range(5):
            shown.bus.publish(f"prediction/{old.camera}", old)
        browser.wait(lambda: "No open predictions" in browser.text(".predictions"), "the end")


def test_without_a_link_it_says_what_it_waits_for_and_dots_what_is_likely(browser: Browser) -> None:
    shown = Shown(YOUNG)
    with shown.serving():
        opened(browser, shown)
        waiting = draw(YOUNG).waiting
        browser.wait(lambda: browser.text(".waiting") == waiting, "what it waits for")

        assert "57% of the evidence is there, the rest takes about half an hour" in waiting
        assert browser.count(".edge.likely") == browser.count(".edge") == 1
        assert browser.text(".key summary .quiet").endswith("0 pairs (0 overlapping), 1 likely")
        browser.go(f"#/pair/{A.camera}/{B.camera}")
        browser.wait(lambda: "about 3 more passages" in browser.text(".panel"), "what it lacks")
        assert "Likely link" in browser.text(".panel .kind")
        browser.go("#/links")
        browser.wait(lambda: "0 links and 1 likely" in browser.text(".page"), "the table")
        assert waiting in browser.text(".page")
        shown.publish(replace(SITE, version=2))
        browser.go("#/map")
        browser.wait(lambda: browser.count(".edge.likely") == 0, "the links")
        assert browser.text(".waiting") == ""


def test_cameras_with_a_picture_are_shown_by_it(browser: Browser, tmp_path: Path) -> None:
    for name in (NAMES[0], "not a camera"):
        cv2.imwrite(str(tmp_path / f"{name}.jpg"), np.full((160, 90, 3), 120, np.uint8))
    shown = Shown(YOUNG, pictures=tmp_path)
    with shown.serving():
        opened(browser, shown)
        browser.wait(lambda: browser.count(".node.pictured image") == 1, "the picture")
        assert browser.count(".node circle") == len(NAMES)
        height = "return document.querySelector(arguments[0]).getBoundingClientRect().height"
        assert browser.run(height, f".node[data-id={NAMES[0]}] image") > 40
        assert browser.run(height, f".node[data-id={NAMES[0]}] circle") == 0
        width = height.replace("height", "width")
        box = [browser.run(one, f".node[data-id={NAMES[0]}] image") for one in (width, height)]
        assert box[1] == pytest.approx(box[0] * 160 / 90, rel=0.01), "all of one that is high"
        for _ in range(12):
            browser.run("document.querySelector('[title=\"Zoom out\"]').click()")
        browser.wait(
            lambda: browser.run(height, f".node[data-id={NAMES[0]}] image") == 0,
            "a circle where there is no room for a picture",
        )
        browser.run("document.querySelector('[title=\"Show all\"]').click()")
        for name in NAMES:
            browser.go("#/map")
            browser.wait(lambda: browser.text(".panel") == "", "the map alone")
            browser.go(f"#/camera/{name}")
            browser.wait(lambda name=name: browser.text(".panel h2") == name, "its panel")  # type: ignore[misc]
            browser.wait(lambda: browser.run(HIDDEN) == 0, "all cameras beside it")

        assert browser.complaints() == []
