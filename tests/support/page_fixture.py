"""The web page on a fake bus, in a browser."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

from chromium import Browser
from fake_bus import OneBus

from camtopod.cli.commands.web import listening, names
from camtopod.records import Topology
from camtopod.serve.bus.session import Bus
from camtopod.web import Configured, Login, app


class Shown:
    """A web page on a fake bus.

    pictures: folder of camera pictures.
    """

    def __init__(
        self,
        *versions: Topology,
        pictures: Path | None = None,
        login: Login | None = None,
        configured: Configured | None = None,
    ) -> None:
        self.bus = OneBus()
        self.bus.kept = {one.version: one for one in versions}
        self.pictures, self.login = pictures, login
        self.configured = configured or Configured()
        self.address = ""

    @contextlib.contextmanager
    def serving(self, port: int = 0) -> Iterator[int]:
        """Serve the page; yield the port."""
        bus = cast(Bus, self.bus)
        with (
            listening("127.0.0.1", port) as listener,
            app.serving(
                bus,
                listener,
                names("127.0.0.1"),
                self.pictures,
                time.time,
                3600.0,
                login=self.login,
                configured=self.configured,
            ),
        ):
            port = listener.getsockname()[1]
            self.address = f"http://127.0.0.1:{port}/"
            yield port

    def publish(self, topology: Topology) -> None:
        """Publish a new version; the page's server fetches it as a whole."""
        self.bus.kept[topology.version] = topology
        self.bus.publish("topology/delta", "not a delta")

    def status(self, **cameras: dict[str, Any]) -> None:
        """Publish the status of the daemon and its cameras."""
        self.bus.publish("status/daemon", {"state": "running", "reason": "", "cameras": cameras})


def opened(browser: Browser, shown: Shown, place: str = "#/map") -> None:
    """Open the page at ``place`` and wait until it is live."""
    shown.status()
    browser.open(shown.address + place)
    browser.wait(lambda: browser.text("#live").startswith("live"), "the page to be live")
