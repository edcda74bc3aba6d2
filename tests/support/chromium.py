"""A headless Chromium for tests of the web page, with its network requests and console messages."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.resources import files
from pathlib import Path
from typing import Any

import pytest
from serving import wait_for

FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--window-size=1280,800",
)
"""Command line options of the browser."""
WITHOUT = (
    "needs Chromium and its driver: apt-get install chromium chromium-driver; pip install selenium"
)
"""Reason of a skip where the browser is missing."""


@contextmanager
def chromium(profile: Path) -> Iterator[Browser]:
    """Start a browser with a new profile; skip the test where it is missing."""
    webdriver = pytest.importorskip("selenium.webdriver", reason=WITHOUT)
    binary, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if binary is None or driver is None:
        pytest.skip(WITHOUT)
    options = webdriver.ChromeOptions()
    options.binary_location = binary
    for flag in (*FLAGS, f"--user-data-dir={profile}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    opened = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    try:
        yield Browser(opened)
    finally:
        opened.quit()


class Browser:
    """The operations on a browser that tests need."""

    def __init__(self, driver: Any) -> None:
        self._driver = driver
        self._complaints: list[str] = []
        self._asked: list[str] = []

    def renew(self) -> None:
        """Open a new tab and forget requests and complaints so far.

        The old tab is closed, as its page would continue to make requests.
        """
        old = self._driver.current_window_handle
        self._driver.switch_to.new_window("tab")
        new = self._driver.current_window_handle
        self._driver.switch_to.window(old)
        self._driver.close()
        self._driver.switch_to.window(new)
        self.size(1280, 800)
        self.asked().clear()
        self.complaints().clear()

    def open(self, address: str) -> None:
        """Load a page anew."""
        self._driver.get("about:blank")
        self._driver.get(address)

    def go(self, place: str) -> None:
        """Go to another view of the page."""
        self.run("location.hash = arguments[0]", place)

    def run(self, script: str, *arguments: object) -> Any:
        """Run a script and return its result."""
        return self._driver.execute_script(script, *arguments)

    @property
    def address(self) -> str:
        """The address of the page."""
        return str(self._driver.current_url)

    def text(self, selector: str) -> str:
        """Return the text of the first element that matches; "" if it is missing or hidden."""
        script = (
            "const one = document.querySelector(arguments[0]);"
            " if (!one?.checkVisibility()) return '';"
        )
        return str(self.run(f"{script} return one.innerText ?? one.textContent", selector))

    def count(self, selector: str) -> int:
        """Return the number of elements that match."""
        return int(self.run("return document.querySelectorAll(arguments[0]).length", selector))

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        """Wait until the condition holds; on failure, report the text of the page."""
        try:
            wait_for(condition, what)
        except AssertionError as error:
            raise AssertionError(
                f"{error}; the page: {self.text('body')[:2000]}; {self.complaints()}"
            ) from None

    def press(self, *keys: str) -> None:
        """Press keys wherever the focus is.

        No element is held, as the page may replace it.
        """
        from selenium.webdriver.common.action_chains import ActionChains
        from selenium.webdriver.common.keys import Keys

        for key in keys:
            ActionChains(self._driver).send_keys(getattr(Keys, key, key)).perform()

    def drag(self, selector: str, right: int, down: int) -> None:
        """Drag the first element that matches by so many pixels."""
        from selenium.webdriver.common.action_chains import ActionChains

        element = self._driver.find_element("css selector", selector)
        actions = ActionChains(self._driver).click_and_hold(element)
        actions.move_by_offset(right, down).release().perform()

    def size(self, width: int, height: int) -> None:
        """Set the size of the viewport, pixels; widths below 500 emulate phones."""
        self._driver.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500},
        )

    def dark(self, dark: bool) -> None:
        """Set the preferred colour scheme."""
        feature = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        self._driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})

    def barriers(self) -> list[str]:
        """Return what axe finds wrong for people who do not see the page well or have no mouse."""
        package = pytest.importorskip("axe_core_python", reason="pip install .[test]")
        axe = (files(package) / "axe.min.js").read_text("utf-8")
        told = "rule.id + ': ' + rule.nodes.map((node) => node.target + ' ' + node.any.map((one) => one.message))"
        script = f"axe.run().then((all) => arguments[0](all.violations.map((rule) => {told})))"
        return list(self._driver.execute_async_script(f"{axe}; {script}"))

    def complaints(self) -> list[str]:
        """Return the page's errors and warnings so far: scripts, content policy, failed loads.

        Ask while the page is still served: it complains of a server that has gone.
        """
        self._complaints += [
            entry["message"]
            for entry in self._driver.get_log("browser")
            if entry["level"] != "INFO"
        ]
        return self._complaints

    def asked(self) -> list[str]:
        """Return the addresses of all requests so far."""
        for entry in self._driver.get_log("performance"):
            message = json.loads(entry["message"])["message"]
            if message["method"] == "Network.requestWillBeSent":
                self._asked.append(message["params"]["request"]["url"])
        return self._asked
