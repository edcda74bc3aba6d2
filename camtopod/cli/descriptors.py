"""Limit of files (sockets included) that the process may have open at a time."""

from __future__ import annotations

import resource

WANTED_MAX = 65_536
"""Number of open files asked for; each program on the bus and each open web page takes one."""


def raise_limit() -> None:
    """Raise the limit to what the system allows, at most `WANTED_MAX`."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, WANTED_MAX), hard))
