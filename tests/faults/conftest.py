"""Fixtures of the fault tests: where files are, the watched disk, whole sites."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
import site_of
import vfs

IN_MEMORY = Path("/dev/shm")
"""File system in memory."""


@pytest.fixture
def quick_path(tmp_path: Path) -> Iterator[Path]:
    """Return a directory in memory if possible: many files are written that need not survive."""
    if not os.access(IN_MEMORY, os.W_OK):
        yield tmp_path
        return
    with tempfile.TemporaryDirectory(dir=IN_MEMORY) as name:
        yield Path(name)


@pytest.fixture
def disk_watch() -> vfs.Vfs:
    """Return the VFS that records and spoils SQLite's operations."""
    if vfs.VFS is None:
        pytest.skip("the functions of the SQLite that Python uses cannot be reached")
    return vfs.VFS


@pytest.fixture
def make_site(tmp_path: Path) -> Iterator[site_of.MakeSite]:
    """Return a function that makes a `site_of.Site`, given what follows the directory."""
    made: list[site_of.Site] = []

    def make(*given: float, **more: bool) -> site_of.Site:
        made.append(site_of.Site(tmp_path, *given, **more))  # type: ignore[arg-type]
        return made[-1]

    yield make
    for site in made:
        site.close()
