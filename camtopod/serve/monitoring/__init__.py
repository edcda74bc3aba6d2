"""monitoring"""

from __future__ import annotations

__all__ = [
    "health",
    "metrics",
]
