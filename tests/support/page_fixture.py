"""The web page on a fake bus, asked by HTTP or shown in a browser."""

from __future__ import annotations

import contextlib
import http.client
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple, cast

from chromium import Browser
from fake_bus import OneBus
from msgspec.structs import replace

from camtopod.cli.commands.web import listening, names
from camtopod.config.config_file import parse
from camtopod.records import Topology
from camtopod.serve.bus import Bus
from camtopod.web import app
from camtopod.web.login import Login


class Answer(NamedTuple):
    """A response; names of headers in lower case."""

    status: int
    headers: dict[str, str]
    content: bytes

    @property
    def text(self) -> str:
        return self.content.decode()


class Shown:
    """A web page on a fake bus.

    pictures: folder of camera pictures.
    config: the configuration, as its file has it.
    """

    def __init__(
        self,
        *versions: Topology,
        pictures: Path | None = None,
        login: Login | None = None,
        config: str = "",
    ) -> None:
        self.bus = OneBus()
        self.bus.kept = {one.version: one for one in versions}
        self.login = login
        self.config = parse(config)
        if pictures is not None:
            web = replace(self.config.web, pictures=str(pictures))
            self.config = replace(self.config, web=web)
        self.port = 0

    @property
    def address(self) -> str:
        """Address of the page while it is served."""
        return f"http://127.0.0.1:{self.port}/"

    @contextlib.contextmanager
    def serving(self, port: int = 0, further_names: tuple[str, ...] = ()) -> Iterator[int]:
        """Serve the page; yield the port."""
        with (
            listening("127.0.0.1", port) as listener,
            app.serving(
                cast(Bus, self.bus),
                listener,
                names("127.0.0.1", further_names),
                time.time,
                self.config,
                login=self.login,
            ),
        ):
            self.port = listener.getsockname()[1]
            yield self.port

    def publish(self, topology: Topology) -> None:
        """Publish a new version."""
        self.bus.kept[topology.version] = topology
        self.bus.publish("topology", topology)

    def status(self, **cameras: dict[str, Any]) -> None:
        """Publish the status of the daemon and its cameras."""
        status = {"state": "running", "reason": "", "status_seconds": 3600.0, "cameras": cameras}
        self.bus.publish("status/daemon", status)

    def ask(self, path: str, method: str = "GET", body: str = "", **headers: str) -> Answer:
        """Return the answer to a request; ``_`` in the names of headers stands for ``-``."""
        given = {name.replace("_", "-"): value for name, value in headers.items()}
        with contextlib.closing(http.client.HTTPConnection("127.0.0.1", self.port, 20)) as client:
            client.request(method, path, body or None, given)
            answer = client.getresponse()
            received = {name.lower(): value for name, value in answer.getheaders()}
            return Answer(answer.status, received, answer.read())

    def json(self, path: str) -> Any:
        """Return the data that the server answers with."""
        answer = self.ask(path)
        assert answer.status == 200, answer
        return json.loads(answer.content)


def opened(browser: Browser, shown: Shown, place: str = "#/map") -> None:
    """Open the page at ``place`` and wait until it is live."""
    shown.status()
    browser.open(shown.address + place)
    browser.wait(lambda: browser.text("#live").startswith("running"), "the page to be live")
