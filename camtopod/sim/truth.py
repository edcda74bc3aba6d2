"""What is true of a made-up camera network: the answer that a learned topology is held against."""

from __future__ import annotations

import msgspec
import numpy as np
from msgspec import Struct

from camtopod.arrays import Floats
from camtopod.records import Pair, Relation, Transit

TRUTH_SCHEMA = "camtopod/truth/1"
CLUTTER = -1
"""In `Truth.identity`, `Truth.passage` and `Truth.zone`: the event belongs to nobody."""


class TrueZone(Struct, frozen=True, omit_defaults=True):
    """An entry/exit zone; centre and covariance in fractions of the image, `None` without
    positions.

    ``moved_at``: seconds since the epoch before which it lay at ``was`` in the image, as the camera
    was turned.
    """

    id: str
    camera: str
    x: float | None = None
    y: float | None = None
    cov: list[list[float]] | None = None
    moved_at: float | None = None
    was: tuple[float, float] | None = None


class TrueLink(Struct, frozen=True, omit_defaults=True, rename={"from_": "from"}):
    """A directed link. ``probability`` is a walker's, whether or not the next passage is recorded;
    ``transitions`` is how often it was walked, both ends recorded, in these events. ``closed_at``
    (``opened_at``): seconds since the epoch after (before) which nobody takes it."""

    from_: str
    to: str
    relation: Relation
    probability: float
    transitions: int
    transit: Transit
    closed_at: float | None = None
    opened_at: float | None = None


class Truth(Struct, frozen=True, omit_defaults=True):
    """The network and, per event line, who caused it.

    ``identity[i]`` is the walker of event ``i``, ``passage[i]`` the number of the passage within
    the walk (it rises along the walk, unrecorded passages count too) and ``zone[i]`` the index into
    ``zones``; `CLUTTER` for clutter.
    """

    schema: str
    cameras: list[str]
    zones: list[TrueZone]
    links: list[TrueLink]
    pairs: list[Pair]
    clock_offsets: dict[str, float] = msgspec.field(default_factory=dict)
    identity: list[int] = msgspec.field(default_factory=list)
    passage: list[int] = msgspec.field(default_factory=list)
    zone: list[int] = msgspec.field(default_factory=list)

    def __post_init__(self) -> None:
        if self.schema != TRUTH_SCHEMA:
            raise ValueError(f"schema is {self.schema!r}; this program reads {TRUTH_SCHEMA!r}")


def transit_of(seconds: Floats) -> Transit:
    """Figures of a sample of transit times, (n,) with n > 0."""
    q10, q50, q90 = np.quantile(seconds, (0.1, 0.5, 0.9))
    figures = (mode_of(seconds), np.mean(seconds), np.std(seconds), q10, q50, q90)
    return Transit(*(round(float(figure), 6) for figure in figures))


def mode_of(values: Floats) -> float:
    """Where a Gaussian kernel density (Silverman's bandwidth) is highest, to a 200th of the
    spread.
    """
    low, high = np.quantile(values, (0.02, 0.98))
    width = min(
        float(np.std(values)), float(np.subtract(*np.quantile(values, (0.75, 0.25)))) / 1.34
    )
    if width <= 0:
        return float(np.median(values))
    grid = np.linspace(low, high, 201)
    bandwidth = 0.9 * width * len(values) ** -0.2
    density = sum(
        np.exp(-0.5 * ((grid[:, None] - part) / bandwidth) ** 2).sum(1)
        for part in np.array_split(values, max(1, len(values) // 1000))
    )
    return float(grid[int(np.argmax(density))])


def pairs_of(links: list[TrueLink], camera_of: dict[str, str]) -> list[Pair]:
    """Related pairs of cameras: overlapped where any of their links is, else joined by an unseen
    path.
    """
    overlapped: dict[tuple[str, str], bool] = {}
    for link in links:
        a, b = sorted((camera_of[link.from_], camera_of[link.to]))
        if a != b:
            overlapped[a, b] = overlapped.get((a, b), False) or link.relation == "overlapped"
    return [
        Pair(cameras, "overlapped" if over else "unseen_path")
        for cameras, over in sorted(overlapped.items())
    ]
