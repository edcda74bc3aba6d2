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
    command = [sys.executable, str(Path(__file__).with_name("forking.py")), name, str(directory)]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [*command, str(kills), *more],
        env=environment,
        capture_output=True,
        timeout=900,
        check=False,
    )
    assert done.returncode == 0, done.stderr.decode()
    told: dict[str, int] = json.loads(done.stdout)
    return told


@pytest.mark.parametrize("name", NAMES)
def test_a_killed_writer_loses_nothing(name: str, quick_path: Path) -> None:
    told = killed(name, quick_path, 12)

    assert told["lost"] == 0
    assert told["durable"] > 12


def test_the_harness_sees_a_writer_that_speaks_too_early(quick_path: Path) -> None:
    assert killed("journal", quick_path, 20, "early")["lost"] > 0


@pytest.mark.campaign
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", NAMES)
def test_campaign_of_killed_writers(name: str, tmp_path: Path) -> None:
    """On the real disk."""
    told = killed(name, tmp_path, size("FORKED_KILLS", 500))

    print(f"{name}: {told}")
    assert told["lost"] == 0
