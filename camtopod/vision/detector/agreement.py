"""Agreement of a detector with motion at one camera; it decides whether the detector is trusted.

Measured without ground truth, as the share of the moving area that is inside of the detector's
boxes. On real views a detector sees most of what moves (0.7 to 0.9) or hardly any of it (0.1 and
less): people from above, cars where it looks for people, a dark image. Where it is trusted, its
detections are the objects that are tracked; elsewhere the blobs of motion are.
"""

from __future__ import annotations

TRUSTED_FROM = 0.45
"""Agreement from which a detector is trusted."""
TRUSTED_DOWN_TO = 0.3
"""Agreement below which a detector is trusted no longer."""
USELESS_BELOW = 0.1
"""Agreement below which inferences are a waste of time."""
PRIOR = 0.25
"""Agreement before the first inference."""
PRIOR_AREA = 0.03
"""Moving area (share of the image) that counts as much as the prior."""
INFERENCES_MEMORY = 200
"""Inferences after which an area counts 1/e as much."""
USELESS_INFERENCES_MIN = 30
"""Inferences that are needed to call a detector useless."""


class Agreement:
    """Running mean of the share of moving area inside of a detector's boxes."""

    def __init__(self) -> None:
        self._area = PRIOR_AREA
        self._inside = PRIOR * PRIOR_AREA
        self._inferences = 0
        self._trusted = False

    def add(self, area: float, inside: float) -> None:
        """Update with one inference: moving area, and the part of it covered by boxes.

        Both as shares of the image.
        """
        kept = 1.0 - 1.0 / INFERENCES_MEMORY
        self._area = kept * self._area + area
        self._inside = kept * self._inside + inside
        self._inferences += 1
        self._trusted = self.share >= (TRUSTED_DOWN_TO if self._trusted else TRUSTED_FROM)

    @property
    def share(self) -> float:
        """The running mean, 0 to 1."""
        return self._inside / self._area

    @property
    def trusted(self) -> bool:
        """True if the detections of the detector are tracked, not the blobs of motion alone."""
        return self._trusted

    @property
    def useless(self) -> bool:
        """True if the detector has seen hardly anything of what moves."""
        return self._inferences >= USELESS_INFERENCES_MIN and self.share < USELESS_BELOW
