"""With CI set, skips are failures, unless they are for lack of the optional data."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from paths import TESTS

CONFTEST = TESTS / "conftest.py"
SUITE = """
import pytest

@pytest.mark.skipif(True, reason="no ffmpeg")
def test_package(): pass

def test_inside():
    pytest.skip("no ffmpeg")

@pytest.mark.skipif(True, reason="CAMTOPOD_TEST_DATA is not set")
def test_data(): pass

@pytest.mark.xfail(reason="known")
def test_known(): assert False

def test_good(): pass
"""


@pytest.mark.parametrize(
    ("environment", "closing"),
    [
        ({}, "1 passed, 3 skipped, 1 xfailed"),
        ({"CI": "true"}, "1 failed, 1 passed, 1 skipped, 1 xfailed, 1 error"),
        (
            {"CI": "true", "CAMTOPOD_TEST_DATA": "/nowhere"},
            "1 failed, 1 passed, 1 xfailed, 2 errors",
        ),
    ],
)
def test_what_is_missing_fails_in_ci(
    tmp_path: Path, environment: dict[str, str], closing: str
) -> None:
    (tmp_path / "conftest.py").write_text(CONFTEST.read_text())
    (tmp_path / "test_some.py").write_text(SUITE)
    inherited = {
        name: value
        for name, value in os.environ.items()
        if name not in ("CI", "CAMTOPOD_TEST_DATA")
    }
    inherited["PYTHONPATH"] = os.pathsep.join(
        filter(None, sys.path)
    )  # it imports what stands beside it
    done = subprocess.run(
        [
            sys.executable,
            "-m",
            "pytest",
            "-q",
            "-p",
            "no:cacheprovider",
            "--rootdir",
            str(tmp_path),
            str(tmp_path),
        ],
        env=inherited | environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.splitlines()[-1].startswith(closing), done.stdout + done.stderr
