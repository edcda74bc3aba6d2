"""One daemon for all tests of the client library."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from fake_bus_daemon import Hub, a_hub


@pytest.fixture(scope="session")
def hub(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hub]:
    """Return a daemon that has learned, with a client that publishes."""
    with a_hub(tmp_path_factory.mktemp("hub")) as one:
        yield one
