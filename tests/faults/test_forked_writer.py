"""A writer is killed at any moment; steps that it reported durable are there."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from real_daemon import script
from sizes import size

NAMES = ("journal", "spool")


def told_of(name: str, directory: Path, kills: int, *more: str) -> dict[str, int]:
    """Return what `forking.py` counted; only programs with a single thread can fork safely."""
    forking = script("forking.py", name, str(directory), str(kills), *more)
    out, _ = forking.communicate(timeout=900)
    assert forking.returncode == 0
    told: dict[str, int] = json.loads(out)
    return told


@pytest.mark.parametrize("name", NAMES)
def test_a_killed_writer_loses_nothing(name: str, quick_path: Path) -> None:
    told = told_of(name, quick_path, 12)

    assert told["lost"] == 0
    assert told["durable"] > 12


def test_the_harness_sees_a_writer_that_speaks_too_early(quick_path: Path) -> None:
    assert told_of("journal", quick_path, 20, "early")["lost"] > 0


@pytest.mark.campaign
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", NAMES)
def test_campaign_of_killed_writers(name: str, tmp_path: Path) -> None:
    """On the real disk."""
    told = told_of(name, tmp_path, size("FORKED_KILLS", 500))

    print(f"{name}: {told}")
    assert told["lost"] == 0
