"""Memory given back. glibc keeps an arena for each thread and seldom returns what was freed in it, so that a process
that fits a model now and then seems to grow for ever. Elsewhere than on glibc these do nothing.
"""

from __future__ import annotations

import ctypes

ARENAS_MAX = 2
"""More would be faster only for many threads that allocate at the same time."""
_M_ARENA_MAX = -8


def limit_arenas() -> None:
    """To be called before there are threads."""
    library = ctypes.CDLL(None)
    if hasattr(library, "mallopt"):
        library.mallopt(_M_ARENA_MAX, ARENAS_MAX)


def give_back() -> None:
    """Return what is free to the system; takes some milliseconds."""
    library = ctypes.CDLL(None)
    if hasattr(library, "malloc_trim"):
        library.malloc_trim(0)
