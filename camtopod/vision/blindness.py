"""Blindness: whether anything can be told from the pictures of a view at present, and why not."""

from __future__ import annotations

from collections import deque
from math import inf
from typing import Literal

Cause = Literal["light", "contrast", "turning"]
"""Why a frame shows no objects.

light: it changes large parts of the picture.
contrast: the scene has hardly any.
turning: the scene was learned anew for the third time within minutes.
"""

BLIND_SECONDS = 10.0
"""Time over which frames that show no objects count against those that do."""
BLIND_SHARE_MAX = 0.5
"""Share of such frames above which the view is blind."""
TURNS_MIN = 3
"""Number of changes of the scene that make a camera one that turns."""
TURNS_SECONDS = 300.0
"""Time within which they are made."""
TURNED_SECONDS = 8.0
"""Time after its latest turn for which a camera that turns is blind."""
REASONS: dict[Cause, str] = {
    "light": (
        "most pictures show nothing, as light changes large parts of them again and again: turn "
        "the camera away from the lamp, or draw an ignore area where it shines"
    ),
    "contrast": (
        "the scene has too little contrast to show anything in front of it: is the lens covered, "
        "the picture too bright, or is there too little light?"
    ),
    "turning": (
        "the scene changes again and again, as when a camera turns, strong light comes and goes or "
        "large vehicles halt: let the camera stand still, with a wider view"
    ),
}
"""Words for each cause."""


class Blindness:
    """Whether a view is blind, by the share of its latest frames that show no objects."""

    def __init__(self) -> None:
        self._shares = dict.fromkeys(REASONS, 0.0)
        self._turns = deque([-inf] * TURNS_MIN, TURNS_MIN)
        self.reason = ""
        """Why nothing can be told; "" if the view is not blind."""
        self.seconds = 0.0
        """Time for which it has been blind since the start."""

    def turned(self, t: float) -> None:
        """Note that the scene has changed at ``t`` (seconds)."""
        self._turns.append(t)

    def step(self, t: float, dt: float, cause: Cause | None) -> None:
        """Take the frame at ``t`` into account, ``dt`` seconds after the last.

        cause: why it shows no objects; None if it does.
        """
        weight = min(dt / BLIND_SECONDS, 1.0)
        for name, share in self._shares.items():
            self._shares[name] += weight * ((name == cause) - share)
        first, last = self._turns[0], self._turns[-1]
        if sum(self._shares.values()) > BLIND_SHARE_MAX:
            self.reason = REASONS[max(self._shares, key=self._shares.__getitem__)]
        elif last - first < TURNS_SECONDS and t - last < TURNED_SECONDS:
            self.reason = REASONS["turning"]
        else:
            self.reason = ""
        self.seconds += dt if self.reason else 0.0
