"""Limit of files (sockets included) that the process may have open at a time."""

from __future__ import annotations

import resource

from camtopod.cli.exits import CommandError

NEEDED = 64
"""Least number of open files to start with.

A daemon with its first clients has about 40. With fewer than `NEEDED`, zenoh's threads cannot start
and no message gets through.
"""
WANTED_MAX = 65_536
"""Number of open files asked for; each program on the bus and each open web page takes one."""


def raise_limit() -> None:
    """Raise the limit to what the system allows, at most `WANTED_MAX`.

    Raises `CommandError` if that is fewer than `NEEDED`.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    allowed = WANTED_MAX
    if hard != resource.RLIM_INFINITY:
        allowed = min(hard, WANTED_MAX)
    if soft != resource.RLIM_INFINITY and soft < allowed:
        resource.setrlimit(resource.RLIMIT_NOFILE, (allowed, hard))
    if allowed < NEEDED:
        raise CommandError(
            f"this process may have {allowed} files open at a time, but needs {NEEDED}: raise the "
            f"limit (`ulimit -n`, LimitNOFILE= of a service)"
        )
