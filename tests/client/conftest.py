"""One daemon for all tests of the client library."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from fake_bus_daemon import LearnedDaemon, running_learned_daemon


@pytest.fixture(scope="session")
def learned_daemon(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LearnedDaemon]:
    """Return a daemon that has learned, with a client that publishes."""
    with running_learned_daemon(tmp_path_factory.mktemp("site")) as one:
        yield one
