"""The default answer to the question which cameras a daemon owns: all, unless it is a shard."""

from __future__ import annotations


def owns_every_camera(camera: str) -> bool:
    """Return True: a daemon that serves its site alone owns every camera."""
    return True
