"""Common settings and fixtures of the tests.

With the environment variable CI set, a skip is a failure: .ci/run provides everything that tests
need. Only the data that is not part of the repository may be missing; CAMTOPOD_TEST_DATA names its
folder where it is available.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
import signal
from collections.abc import Generator, Iterator

os.environ.setdefault(
    "OMP_NUM_THREADS", "1"
)  # before numpy is loaded: matrices are small and cores are busy

# Often set in containers, not in a user's shell. With it standard output is unbuffered in all
# programs that tests start, which hides missing flushes.
os.environ.pop("PYTHONUNBUFFERED", None)
# With this one, every program that tests start would compile the package anew.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

import pytest
from chromium import Browser, chromium
from hypothesis import HealthCheck, settings

from camtopod.serve.ingest import backlogs
from camtopod.serve.learner_process import process

DATA = "CAMTOPOD_TEST_DATA"
"""Variable with the folder of the data; a skip for lack of the data names it in its reason."""
OURS = ("CAMTOPOD_", "OPENCV_")
"""Prefixes of the environment variables that the program reads, or sets for OpenCV."""

settings.register_profile(  # looks for new examples: pytest --hypothesis-profile=search
    "search", deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile(  # a busy machine may be slow; a change alone turns a test red
    "patient", settings.get_profile("search"), derandomize=True
)
settings.load_profile("patient")


if (
    signal.getsignal(signal.SIGINT) is signal.SIG_IGN
):  # ignored in background jobs of a shell script
    signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # else all programs that tests start would ignore it, too


backlogs.SETTLE_SECONDS = 0.0  # the learners of daemons in this process wait for no backlogs


@pytest.fixture(autouse=True)
def _logging_as_it_was() -> Generator[None]:
    """Restore the log's settings, which a command run inside a test changes."""
    root = logging.getLogger()
    level, handlers = root.level, root.handlers[:]
    yield
    root.setLevel(level)
    root.handlers[:] = handlers


@pytest.fixture(autouse=True)
def _environment_as_it_was() -> Generator[None]:
    """Check that no test leaves environment variables behind, which later tests would inherit."""

    def ours() -> dict[str, str]:
        return {name: value for name, value in os.environ.items() if name.startswith(OURS)}

    before = ours()
    yield
    assert ours() == before


@pytest.fixture(autouse=True, scope="session")
def _learners_start_quickly() -> Iterator[None]:
    """Fork the learners of daemons in the tests' process from one that has imported everything."""
    quick = multiprocessing.get_context("forkserver")
    quick.set_forkserver_preload([process.PROGRAM, "camtopod.serve.learner_process.process"])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(process, "context", quick)
        yield


@pytest.fixture(scope="session")
def started_browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """Start one browser for all tests, as that takes seconds."""
    with chromium(tmp_path_factory.mktemp("profile")) as started:
        yield started


@pytest.fixture
def browser(started_browser: Browser) -> Browser:
    """Return the browser with a fresh tab."""
    started_browser.renew()
    return started_browser


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Turn a skip into a failure where everything has to be provided."""
    report = yield
    if report.skipped and not hasattr(report, "wasxfail") and os.environ.get("CI"):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        if DATA in os.environ or DATA not in reason:
            report.outcome = "failed"
            report.longrepr = f"{reason}: with CI set, everything that tests need must be provided"
    return report
