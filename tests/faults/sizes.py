"""How long the campaigns are."""

from __future__ import annotations

import os


def size(name: str, default: int) -> int:
    """How much of something a campaign does: the environment variable CAMTOPOD_FAULTS_``name``, or
    ``default``.
    """
    return int(os.environ.get(f"CAMTOPOD_FAULTS_{name}", default))
