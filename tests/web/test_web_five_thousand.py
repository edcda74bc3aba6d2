"""The live page of a city's cameras, in a real browser: the part on the screen is drawn."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from chromium import Browser
from page_fixture import Shown
from synthetic_topology import synthetic_topology

from camtopod.records import Topology

CAMERAS = 5000
NEAR = "cam2500"
DRAWN_MAX = 1200
"""Cameras that are elements of their own."""
OUTSIDE = """
const map = document.querySelector('svg.map').getBoundingClientRect();
const air = 60;
return [...document.querySelectorAll('.node:not(.chosen, .ill, [tabindex="0"]) circle')].filter((one) => {
  const { left, right, top, bottom } = one.getBoundingClientRect();
  return right < map.left - air || left > map.right + air || bottom < map.top - air || top > map.bottom + air;
}).length;
"""
NAMES = "return [...document.querySelectorAll('.node:not(.ill)')].map((one) => one.dataset.id)"


@pytest.fixture(scope="module")
def site() -> Topology:
    return synthetic_topology(CAMERAS)


@pytest.fixture
def city(browser: Browser, site: Topology) -> Iterator[Shown]:
    """Show the page until all its cameras are in sight; at the end there must be no complaint."""
    shown = Shown(site)
    with shown.serving():
        shown.status()
        browser.open(shown.address)
        browser.wait(lambda: browser.count(".labels .name") > 0, "the map with names")
        browser.wait(lambda: browser.text("#live").startswith("running"), "the page to be live")
        yield shown
        assert browser.complaints() == []


def names(browser: Browser) -> set[str]:
    """Return the cameras that are elements of the page, but those in need, which always are."""
    return set(browser.run(NAMES))


def near(browser: Browser) -> None:
    """Find a camera, and wait for it and its neighbours."""
    browser.run("document.querySelector('.search input').focus()")
    browser.press(NEAR, "ENTER")
    browser.wait(lambda: NEAR in names(browser) and not browser.count(".far"), "its surroundings")


def test_all_of_a_city_is_a_few_paths(browser: Browser, site: Topology, city: Shown) -> None:
    assert browser.text(".key summary .quiet").startswith(
        f"5,000 cameras, {len(site.pairs):,} pairs"
    )
    assert 0 < browser.count(".nodes .far") + browser.count(".edges .far") < 1500
    assert browser.count(".node") < 20
    assert browser.count(".map *") < 3000
    dots = "return [...document.querySelectorAll('.far.core')].map((one) => one.getAttribute('d').split('M').length - 1)"
    assert sum(browser.run(dots)) == CAMERAS
    lines = dots.replace(".far.core", ".far.edge")
    assert sum(browser.run(lines)) == len(site.pairs)


def test_cameras_in_need_are_marked_among_all(browser: Browser, city: Shown) -> None:
    city.bus.publish(f"status/{NEAR}", {"camera": NEAR, "state": "failed", "reason": "no frame"})
    browser.wait(
        lambda: browser.count(".node.ill") == 2, "the camera in need, and that of the alarm"
    )

    assert browser.count(".far.core") > 0


def test_what_is_found_stands_out_among_all(browser: Browser, city: Shown) -> None:
    browser.run("document.querySelector('.search input').focus()")
    browser.press("cam012")
    found = {f"cam012{digit}" for digit in range(10)}
    browser.wait(lambda: found <= names(browser), "the cameras found")

    opacity = "return getComputedStyle(document.querySelector(arguments[0])).opacity"
    assert float(browser.run(opacity, ".far.core")) < 0.5
    assert float(browser.run(opacity, '.node[data-id="cam0120"]')) == 1


def test_what_is_near_is_drawn_and_nothing_outside(browser: Browser, city: Shown) -> None:
    near(browser)

    assert 3 < browser.count(".node") < DRAWN_MAX
    assert 3 < browser.count("line.edge") < 2 * DRAWN_MAX
    assert browser.run(OUTSIDE) == 0
    assert browser.count(".labels .name") > 3

    # A pan brings others, and leaves behind those that have gone.
    before = names(browser)
    browser.press("ESCAPE")
    for _ in range(2):
        browser.drag("svg.map", -500, -200)
    browser.wait(lambda: not before & (names(browser) - {NEAR}), "others")
    assert 1 < browser.count(".node") < DRAWN_MAX
    assert browser.run(OUTSIDE) == 0

    # All of it again.
    browser.run("document.querySelector('[aria-label=\"Show all\"]').click()")
    browser.wait(lambda: browser.count(".far.core") > 0, "all of the city")
    assert browser.count(".node") < 20


def test_keys_go_on_to_cameras_that_are_not_drawn_yet(browser: Browser, city: Shown) -> None:
    near(browser)

    def is_closed() -> bool:  # the panel, which may open after a first Escape
        browser.press("ESCAPE")
        return bool(browser.run("return document.activeElement.dataset.id") == NEAR)

    browser.wait(is_closed, "the focus")
    before = names(browser)

    for _ in range(20):
        browser.press("ARROW_RIGHT")
    reached = browser.run("return document.activeElement.dataset.id")
    assert reached
    assert reached not in before
    browser.wait(lambda: browser.run(OUTSIDE) == 0, "what is around it")
    assert browser.count(".node:focus") == 1
