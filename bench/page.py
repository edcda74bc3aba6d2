"""Time the page of a large site in a real browser: the first map, and a step of a pan.

    python -m bench page [--cameras 5000] [--steps 40]

The site is synthetic; its newest version is there before the browser opens the page, in a headless
Chromium of 1280 by 800 pixels. The first map is there when it has names. A step moves the pointer
by 12 pixels, and lasts until the page has drawn it: with all cameras on the screen, and near enough
to read all names.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from bench.support.parts import part_parser

SUPPORT = Path(__file__).parents[1] / "tests" / "support"
"""The browser, the page and the synthetic site of the tests."""
NAMED = "return document.querySelectorAll('.labels .name').length"
PAN = """
const [count, done] = arguments;
const map = document.querySelector("svg.map");
const box = map.getBoundingClientRect();
const [x, y] = [box.left + box.width / 2, box.top + box.height / 2];
map.setPointerCapture = () => {};  // of a pointer that does not exist
const fire = (type, k) => {
  const at = { clientX: x + 12 * k, clientY: y + 5 * k };
  map.dispatchEvent(new PointerEvent(type, { pointerId: 1, buttons: 1, bubbles: true, ...at }));
};
const times = [];
fire("pointerdown", 0);
const step = () => {
  const began = performance.now();
  fire("pointermove", times.length + 1);
  requestAnimationFrame(() => {
    const drawn = new MessageChannel();
    drawn.port1.onmessage = () => {
      times.push(performance.now() - began);
      if (times.length < count) return step();
      fire("pointerup", times.length);
      done(times);
    };
    drawn.port2.postMessage(0);
  });
};
step();
"""
"""Returns the milliseconds of each step."""


def main(argv: Sequence[str]) -> int:
    """Measure, and print a line for each figure."""
    arguments = _parse(argv)
    sys.path.append(str(SUPPORT))
    site = importlib.import_module("synthetic_topology").synthetic_topology(arguments.cameras)
    page = importlib.import_module("page_fixture").Shown(site)
    chromium = importlib.import_module("chromium").chromium
    with tempfile.TemporaryDirectory() as profile, chromium(Path(profile)) as browser:
        driver = browser._driver
        driver.set_script_timeout(120)
        browser.size(1280, 800)
        with page.serving():
            page.status()
            print(f"{arguments.cameras} cameras, {len(site.pairs)} pairs")
            print(f"map on the server: {_waited(lambda: page.ask('/data/map').text != 'null')}")
            start = time.monotonic()
            driver.get(page.address)
            print(f"first map: {_waited(lambda: browser.run(NAMED) > 0, start)}")
            browser.wait(lambda: browser.text("#live").startswith("running"), "the page to be live")
            print(f"pan, all on the screen: {_steps(driver, arguments.steps)}")
            browser.run("document.querySelector('.search input').focus()")
            browser.press(site.cameras[arguments.cameras // 2].id, "ENTER", "ESCAPE")
            browser.wait(lambda: not browser.count(".far"), "a camera near")
            print(f"pan, near: {_steps(driver, arguments.steps)}")
    return 0


def _waited(condition: Callable[[], bool], start: float | None = None) -> str:
    """Wait for a condition; return the seconds since ``start``, in words."""
    start = time.monotonic() if start is None else start
    while not condition():
        time.sleep(0.02)
    return f"{time.monotonic() - start:.1f} s"


def _steps(driver: Any, count: int) -> str:
    """Pan; return the median and the longest time of a step, in words."""
    times = driver.execute_async_script(PAN, count)
    return f"median {median(times):.0f} ms, longest {max(times):.0f} ms"


def _parse(argv: Sequence[str]) -> argparse.Namespace:
    parser = part_parser(__name__, __doc__)
    parser.add_argument("--cameras", type=int, default=5000, help="cameras of the site")
    parser.add_argument("--steps", type=int, default=40, help="steps of each pan")
    return parser.parse_args(argv)
