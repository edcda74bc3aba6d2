"""How many files, sockets among them, the process may have open at a time."""

from __future__ import annotations

import resource

from camtopod.cli.exits import CommandError

NEEDED = 64
"""A daemon with its first clients has about 40. With fewer than that zenoh's threads cannot start,
and nothing gets through.
"""
WANTED_MAX = 65_536
"""Each program on the bus takes one, and each page that is open."""


def raise_limit() -> None:
    """Allow as many as the system lets this process have. Raises `CommandError` if that is too
    few.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    unlimited = hard == resource.RLIM_INFINITY
    allowed = WANTED_MAX if unlimited else min(hard, WANTED_MAX)
    if soft != resource.RLIM_INFINITY and soft < allowed:
        resource.setrlimit(resource.RLIMIT_NOFILE, (allowed, hard))
    if allowed < NEEDED:
        raise CommandError(
            f"this process may have {allowed} files open at a time, and needs {NEEDED}: raise the limit "
            f"(`ulimit -n`, LimitNOFILE= of a service)"
        )
