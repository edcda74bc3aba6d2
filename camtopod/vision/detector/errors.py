"""Why a model cannot be used."""

from __future__ import annotations

from typing import Literal


class DetectorError(Exception):
    """The model cannot be used; ``str()`` says why.

    key: the setting that is to be changed.
    """

    def __init__(self, key: Literal["model", "labels", "layout"], reason: str) -> None:
        super().__init__(reason)
        self.key = key
