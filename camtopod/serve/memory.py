"""Memory given back. glibc has several arenas for threads, and of all but the first it does not return what is free
at the end, even when asked: each that the learner's thread once came to would keep as much as a fit takes, so that the
process seems to grow for weeks. Elsewhere than on glibc these do nothing.
"""

from __future__ import annotations

import ctypes
import gc

ARENAS_MAX = 1
"""More would be faster only for many threads that allocate at the same time."""
_M_ARENA_MAX = -8


def limit_arenas() -> None:
    """To be called before there are threads."""
    library = ctypes.CDLL(None)
    if hasattr(library, "mallopt"):
        library.mallopt(_M_ARENA_MAX, ARENAS_MAX)


def settle() -> None:
    """What is there after the start stays, and the collector need not go through it again and again: that would hold
    everything up for a tenth of a second.
    """
    gc.collect()
    gc.freeze()


def give_back() -> None:
    """Return what is free to the system; takes some milliseconds."""
    library = ctypes.CDLL(None)
    if hasattr(library, "malloc_trim"):
        library.malloc_trim(0)
