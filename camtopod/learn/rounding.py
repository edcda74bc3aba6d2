"""Figures as versions carry them: no reader needs more digits, and the last bits differ between processors."""

from __future__ import annotations

DIGITS = 6


def short(value: float) -> float:
    """Six significant digits; minus zero and nan become zero."""
    return float(f"{value:.{DIGITS}g}") + 0.0 if value == value else 0.0
