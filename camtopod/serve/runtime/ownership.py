"""Which cameras a daemon answers for: all of them, unless it is one shard of several."""

from __future__ import annotations


def everything(camera: str) -> bool:
    """Return True: a daemon that has the site to itself owns every camera."""
    return True
