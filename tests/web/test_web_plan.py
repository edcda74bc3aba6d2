"""The floor plan beneath the map, and the cameras' places on it."""

from __future__ import annotations

import threading
import time
import tomllib
from pathlib import Path

import cv2
import numpy as np
import pytest
from chromium import Browser
from page_fixture import Shown, opened
from starlette.responses import Response
from synthetic_topology import synthetic_topology

from camtopod import redact
from camtopod.config.config_file import load, parse
from camtopod.config.settings import ConfigError
from camtopod.web import app

SITE = synthetic_topology(4)
NAMES = [camera.id for camera in SITE.cameras]
AT = {NAMES[0]: (0.25, 0.5), NAMES[1]: (1.0, 0.0)}
SHARES = """
const plan = document.querySelector('.plan').getBoundingClientRect();
return Object.fromEntries([...document.querySelectorAll('.node')].map((node) => {
  const box = node.querySelector('circle').getBoundingClientRect();
  const [x, y] = [(box.left + box.right) / 2, (box.top + box.bottom) / 2];
  return [node.dataset.id, [(x - plan.left) / plan.width, (y - plan.top) / plan.height]];
}));
"""


COVERED = """
const plan = document.querySelector('.plan').getBoundingClientRect();
return [...document.querySelectorAll('.overlay')].map((one) => one.getBoundingClientRect()).filter((box) =>
  box.left < plan.right && plan.left < box.right && box.top < plan.bottom && plan.top < box.bottom).length;
"""


@pytest.fixture(autouse=True)
def no_secrets(monkeypatch: pytest.MonkeyPatch) -> None:
    """Forget the secrets of other tests: one may be "password", which messages have, too."""
    monkeypatch.setattr(redact, "_secrets", set())


@pytest.mark.parametrize("size", [(1280, 800), (390, 844)])
def test_cameras_stand_where_they_are_on_the_plan_on_every_screen(
    browser: Browser, tmp_path: Path, size: tuple[int, int]
) -> None:
    plan = tmp_path / "floor.png"
    cv2.imwrite(str(plan), np.full((300, 600, 3), 230, np.uint8))
    cameras = [f'[cameras.{name}]\nsource = "0"\nat = {list(at)}' for name, at in AT.items()]
    shown = Shown(SITE, config="\n".join([f'[map]\nplan = "{plan}"', *cameras]))
    with shown.serving():
        browser.size(*size)
        opened(browser, shown)
        browser.wait(lambda: browser.count(".node") == len(NAMES), "the map")
        browser.wait(lambda: browser.count(".labels .name") == len(NAMES), "it to be drawn")
        shares = browser.run(SHARES)
        for name, place in AT.items():
            assert shares[name] == pytest.approx(place, abs=0.01)
        assert all(shares[name][1] > 1.0 for name in NAMES[2:]), "the others are below"
        box = browser.run("return document.querySelector('.plan').getBoundingClientRect().toJSON()")
        assert box["width"] == pytest.approx(2 * box["height"], rel=0.01)
        assert browser.run(COVERED) == 0, "nothing lies on it"
        assert box["left"] >= 0
        assert box["right"] <= size[0]

        assert browser.complaints() == []


def test_cameras_are_dragged_to_their_places_for_the_configuration(
    browser: Browser, tmp_path: Path
) -> None:
    plan = tmp_path / "floor.png"
    cv2.imwrite(str(plan), np.full((300, 600, 3), 230, np.uint8))
    last = NAMES[-1]
    shown = Shown(SITE, config=f'[map]\nplan = "{plan}"')
    with shown.serving():
        opened(browser, shown)
        browser.wait(lambda: browser.count(".labels .name") == len(NAMES), "the map")

        # As long as nobody places them, they stay where they are.
        before = browser.run(SHARES)[last]
        browser.drag(f".node[data-id={last}]", 0, -100)
        assert browser.run(SHARES)[last] == pytest.approx(before, abs=0.01)

        browser.run("document.querySelector('.places summary').click()")
        browser.drag(f".node[data-id={last}]", 40, -300)
        browser.wait(lambda: "at = " in browser.text(".places pre"), "its place")
        said = tomllib.loads(browser.text(".places pre"))["cameras"]
        assert list(said) == [last]
        assert said[last]["at"] == pytest.approx(browser.run(SHARES)[last], abs=0.01)
        assert 0.0 < said[last]["at"][1] < 1.0, "on the plan"
        parse(f'{browser.text(".places pre")}source = "1"')

        assert browser.complaints() == []


# --- the configuration


def test_a_camera_that_comes_while_the_plan_is_loaded_brings_no_second_one(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = tmp_path / "floor.png"
    cv2.imwrite(str(plan), np.full((300, 600, 3), 230, np.uint8))
    asked, release = threading.Event(), threading.Event()
    answer = app._file

    def held(path: str) -> Response:
        asked.set()
        release.wait(20)
        return answer(path)

    monkeypatch.setattr(app, "_file", held)
    count = "window.images = 0; const Old = Image; window.Image = function () { images += 1; return new Old(); }"
    shown = Shown(SITE, config=f'[map]\nplan = "{plan}"')
    with shown.serving():
        shown.status()
        browser.open(shown.address)
        browser.wait(asked.is_set, "the plan to be loaded")
        browser.run(count)
        shown.status(another={"events": 1, "newest": time.time(), "alive": True})
        browser.wait(lambda: browser.run("return images") == 1, "the same once more")
        release.set()
        browser.wait(lambda: browser.count(".node") == len(NAMES) + 1, "all cameras")
        assert browser.count(".places") == browser.count("image.plan") == 1


def test_the_plan_is_beside_the_configuration(tmp_path: Path) -> None:
    path = tmp_path / "camtopod.toml"
    path.write_text('[map]\nplan = "floor.png"\n')

    assert load(path).map.plan == str(tmp_path / "floor.png")


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("at = [0.5]", "expected two numbers, x and y"),
        ("at = [0.1, 0.2, 0.3]", "expected two numbers from 0 to 1"),
        ("at = [0.5, 1.5]", "expected two numbers from 0 to 1"),
        ('page = "javascript:alert(1)"', "begins with http:// or https://"),
        ('page = "http://user:secret@nvr/"', "without a password"),
    ],
)
def test_a_wrong_place_or_address_is_a_mistake(line: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        parse(f'[cameras.a]\nsource = "1"\n{line}\n')
