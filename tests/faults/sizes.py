"""Sizes of the campaigns."""

from __future__ import annotations

import os


def size(name: str, default: int) -> int:
    """Return the size of a campaign: the variable CAMTOPOD_FAULTS_``name``, or ``default``."""
    return int(os.environ.get(f"CAMTOPOD_FAULTS_{name}", default))
