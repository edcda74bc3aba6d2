"""Fixtures of the fault tests: where files are, and the watched disk."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
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
