"""Memory that is kept, and memory given back. glibc has several arenas for threads, and of all but
the first it does not return what is free at the end, even when asked: each that the learner's
thread once came to would keep as much as a fit takes, so that the process seems to grow for weeks.
Elsewhere than on glibc nothing is given back.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
from collections.abc import Iterator

ARENAS_MAX = 1
"""More would be faster only for many threads that allocate at the same time."""
_M_ARENA_MAX, _M_MMAP_THRESHOLD, _M_TRIM_THRESHOLD = -8, -3, -1
LARGE_BYTES = 1_000_000
"""What is so large is given back as soon as it is free: versions and snapshots on their way come
several times that.
"""
IN_HAND_BYTES = 6_000_000
"""So much of what is small and free is kept: what a fit works with at a time, and events on their
way, come and go thousands of times, and it takes an eighth longer if the system is asked for it
each time.
"""
YOUNG_MAX = 20_000
"""Objects made and not yet gone before the collector looks for circles among them. Most are events
on their way, which are in no circle and are gone soon: with the usual 700 it goes through each of
them, which takes longer than to decode it.
"""


def limit_arenas() -> None:
    """To be called before there are threads."""
    library = ctypes.CDLL(None)
    if hasattr(library, "mallopt"):
        library.mallopt(_M_ARENA_MAX, ARENAS_MAX)


def keep_large_apart() -> None:
    """What is large is asked of the system by itself, from now on. Else glibc would do so only
    until the first of them is free, and with what is small between them the next finds no room
    where the last ones were.
    """
    library = ctypes.CDLL(None)
    if hasattr(library, "mallopt"):
        library.mallopt(_M_MMAP_THRESHOLD, LARGE_BYTES)
        library.mallopt(_M_TRIM_THRESHOLD, IN_HAND_BYTES)


def collect_rarely() -> None:
    """The collector looks less often than usual."""
    _, *older = gc.get_threshold()
    gc.set_threshold(YOUNG_MAX, *older)


def settle() -> None:
    """What is there now stays, and the collector need not go through it again and again: that would
    hold everything up for a tenth of a second.
    """
    gc.unfreeze()
    gc.collect()
    gc.freeze()


@contextlib.contextmanager
def kept(thorough: bool = False) -> Iterator[None]:
    """What is made in the block, which is as large as all the rest, stays for long, too: it goes
    when nothing refers to it any more. ``thorough``: now and then what refers to itself is looked
    for among all that was kept.
    """
    collecting = gc.isenabled()
    gc.collect(1)
    gc.disable()
    try:
        yield
    finally:
        if thorough:
            settle()
        gc.freeze()
        if collecting:
            gc.enable()


def give_back() -> None:
    """Return what is free to the system; takes some milliseconds."""
    library = ctypes.CDLL(None)
    if hasattr(library, "malloc_trim"):
        library.malloc_trim(0)
