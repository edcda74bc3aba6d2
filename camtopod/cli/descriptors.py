"""Limit of files (sockets included) that the process may have open at a time."""

from __future__ import annotations

import resource

WANTED_MAX = 65_536
"""Number of open files asked for; each program on the bus and each open web page takes one."""


def raise_limit() -> None:
    """Raise the limit to what the system allows, at most `WANTED_MAX`."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if soft != resource.RLIM_INFINITY:
        allowed = WANTED_MAX if hard == resource.RLIM_INFINITY else min(hard, WANTED_MAX)
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(soft, allowed), hard))
