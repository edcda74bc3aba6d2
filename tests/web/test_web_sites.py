"""The page of two sites with real daemons, in a real browser."""

from __future__ import annotations

import time
from pathlib import Path

from chromium import Browser
from two_sites import TwoSites

from camtopod.cli.commands.web import listening, names
from camtopod.config import Config
from camtopod.web import app

LEARNED = {"border", "gate", "hall", "ramp", "yard"}
SHOWN = "return [...document.querySelectorAll('.node')].map((one) => one.dataset.id)"


def test_two_sites_are_one_map_and_one_that_is_away_is_named(
    tmp_path: Path, browser: Browser
) -> None:
    sites = TwoSites(tmp_path)

    def shown() -> set[str]:
        return set(browser.run(SHOWN))

    with (
        sites.running("north"),
        sites.joined() as city,
        listening("127.0.0.1", 0) as listener,
        app.serving(city, listener, names("127.0.0.1"), time.time, Config()),
    ):
        with sites.running("south"):
            browser.open(f"http://127.0.0.1:{listener.getsockname()[1]}/")
            browser.wait(lambda: shown() >= LEARNED, "the cameras of both")
            assert browser.count('.edge[data-key="border gate"]') == 1
            assert browser.count('.edge[data-key="border yard"]') == 1
            assert browser.text(".site") == "north, south"
            browser.wait(
                lambda: "south" not in browser.text("#live"), "the header to say that all is well"
            )

            # Of the border, both hear an exit; a prediction is shown of the owner alone.
            sites.leave("border", "b2", "north", "south")
            browser.wait(lambda: "border" in browser.text(".predictions"), "a prediction")

        browser.wait(
            lambda: "running, south cannot be reached" in browser.text("#live"), "who is away"
        )
        assert shown() >= LEARNED, "what was known of it stays"
        sites.leave("gate", "g2", "north")
        browser.wait(lambda: "gate" in browser.text(".predictions"), "north to go on")
        assert browser.complaints() == []
