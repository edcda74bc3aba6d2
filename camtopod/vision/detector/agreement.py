"""How far a detector and motion agree at one camera: whether the detector is believed there.

Measured without ground truth, as the share of the moving area that is inside of the detector's
boxes. On real views a detector sees most of what moves (0.7 to 0.9) or hardly any of it (0.1 and
less): people from above, cars where it looks for people, a dark picture. Where it is believed, it
decides who is there and how many; elsewhere motion alone does.
"""

from __future__ import annotations

BELIEVED_FROM = 0.45
"""Agreement from which a detector is believed."""
BELIEVED_DOWN_TO = 0.3
"""Agreement below which a detector is believed no more."""
USELESS_BELOW = 0.1
"""Agreement below which looks are a waste of time."""
PRIOR = 0.25
"""Agreement before the first look."""
PRIOR_AREA = 0.03
"""Moving area (share of the picture) that counts as much as the prior."""
LOOKS_MEMORY = 200
"""Looks after which an area counts 1/e as much."""
USELESS_LOOKS_MIN = 30
"""Looks that are needed to call a detector useless."""


class Agreement:
    """Running mean of the share of moving area inside of a detector's boxes."""

    def __init__(self) -> None:
        self._area = PRIOR_AREA
        self._inside = PRIOR * PRIOR_AREA
        self._looks = 0
        self._believed = False

    def add(self, area: float, inside: float) -> None:
        """Count the moving area of a look, and how much of it is inside of boxes.

        Both as shares of the picture.
        """
        kept = 1.0 - 1.0 / LOOKS_MEMORY
        self._area = kept * self._area + area
        self._inside = kept * self._inside + inside
        self._looks += 1
        self._believed = self.share >= (BELIEVED_DOWN_TO if self._believed else BELIEVED_FROM)

    @property
    def share(self) -> float:
        """The running mean, 0 to 1."""
        return self._inside / self._area

    @property
    def believed(self) -> bool:
        """True if the detector decides who is there and how many."""
        return self._believed

    @property
    def useless(self) -> bool:
        """True if the detector has seen hardly anything of what moves."""
        return self._looks >= USELESS_LOOKS_MIN and self.share < USELESS_BELOW
