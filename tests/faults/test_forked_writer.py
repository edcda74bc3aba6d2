"""A writer is killed at any moment; steps that it reported durable are there."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from sizes import size

NAMES = ("journal", "spool")


def killed(name: str, directory: Path, kills: int, *more: str) -> dict[str, int]:
    """Run in a process of its own: only programs with one thread can fork safely."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [
        sys.executable,
        str(Path(__file__).with_name("forking.py")),
        name,
        str(directory),
        str(kills),
        *more,
    ]
    done = subprocess.run(command, env=environment, capture_output=True, timeout=600, check=False)
    assert done.returncode == 0, done.stderr.decode()
    return dict(json.loads(done.stdout))


@pytest.mark.parametrize("name", NAMES)
def test_a_killed_writer_loses_nothing(name: str, quick_path: Path) -> None:
    told = killed(name, quick_path, 20)
    assert told["lost"] == 0
    assert told["durable"] > 20


@pytest.mark.parametrize("name", NAMES)
def test_the_harness_sees_a_writer_that_speaks_too_early(name: str, quick_path: Path) -> None:
    assert killed(name, quick_path, 25, "early")["lost"] > 0


@pytest.mark.campaign
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", NAMES)
def test_campaign_of_killed_writers(name: str, tmp_path: Path) -> None:
    """On the real disk."""
    told = killed(name, tmp_path, size("FORKED_KILLS", 1000))
    print(f"{name}: {told}")
    assert told["lost"] == 0
