"""With the environment variable CI set, a skip is a failure: .ci/run provides everything that tests
need.

Only the data that is not part of the repository may be missing: CAMTOPOD_TEST_DATA names its folder
where it is there.
"""

from __future__ import annotations

import logging
import os
import signal
from collections.abc import Generator, Iterator

os.environ.setdefault(
    "OMP_NUM_THREADS", "1"
)  # before numpy is loaded: the matrices are small, the cores are taken

# Containers often set it, a user's shell does not: with it C's standard output waits for nothing,
# too, in all programs that tests start, and what is stuck there is not seen.
os.environ.pop("PYTHONUNBUFFERED", None)

import pytest
from chromium import Browser, chromium
from hypothesis import HealthCheck, settings

DATA = "CAMTOPOD_TEST_DATA"
"""A skip for want of the data names this variable in its reason."""
OURS = ("CAMTOPOD_", "OPENCV_")
"""How the variables begin that the program reads, or sets for OpenCV."""

settings.register_profile("patient", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")  # that a busy machine is slow says nothing about what is tested


if (
    signal.getsignal(signal.SIGINT) is signal.SIG_IGN
):  # as of what a shell script runs in the background
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # or every program a test starts would ignore it, too


@pytest.fixture(autouse=True)
def _logging_as_it_was() -> Generator[None]:
    """A command run inside a test sets up the process's log; what the next test finds in its own is
    not its doing.
    """
    root = logging.getLogger()
    level, handlers = root.level, root.handlers[:]
    yield
    root.setLevel(level)
    root.handlers[:] = handlers


@pytest.fixture(autouse=True)
def _environment_as_it_was() -> Generator[None]:
    """What a test, or a command inside it, leaves in the environment is found by every program of a
    later test.
    """

    def ours() -> dict[str, str]:
        return {name: value for name, value in os.environ.items() if name.startswith(OURS)}

    before = ours()
    yield
    assert ours() == before


@pytest.fixture(scope="session")
def started_browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """One for all tests: it takes seconds to start."""
    with chromium(tmp_path_factory.mktemp("profile")) as started:
        yield started


@pytest.fixture
def browser(started_browser: Browser) -> Browser:
    """As new, whatever page an earlier test has left open."""
    started_browser.renew()
    return started_browser


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Turn a skip into a failure where nothing may be missing."""
    report = yield
    if report.skipped and not hasattr(report, "wasxfail") and os.environ.get("CI"):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        if DATA in os.environ or DATA not in reason:
            report.outcome = "failed"
            report.longrepr = f"{reason}: what is missing must be provided where CI is set"
    return report
