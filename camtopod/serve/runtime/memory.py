"""Settings of glibc's memory allocator."""

from __future__ import annotations

import ctypes

_M_TRIM_THRESHOLD, _M_MMAP_THRESHOLD, _M_ARENA_MAX = -1, -3, -8
"""Parameters of mallopt(3)."""
LARGE_BYTES = 1_000_000
"""Blocks from this size on are returned to the system as soon as they are free."""
TOP_FREE_BYTES = 6_000_000
"""Most free memory that is kept at the top of the heap; a fit reuses as much again and again."""


def tune_allocator() -> None:
    """Have glibc return free memory to the system; to be called before there are threads.

    With one arena for all threads and large blocks apart, fewer holes are left between blocks in
    use. Measured on two cores: the daemon and its learner take 204 instead of 214 MB at most with
    100 cameras and 3,000 events; a learner alone takes 124 instead of 138 MB after 12,000 events of
    40 cameras. Other C libraries are left as they are.
    """
    library = ctypes.CDLL(None)
    if hasattr(library, "mallopt"):
        library.mallopt(_M_ARENA_MAX, 1)
        library.mallopt(_M_MMAP_THRESHOLD, LARGE_BYTES)
        library.mallopt(_M_TRIM_THRESHOLD, TOP_FREE_BYTES)
