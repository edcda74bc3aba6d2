"""Ground truth of a simulated camera network, against which a learned topology is scored."""

from __future__ import annotations

import msgspec
import numpy as np
from msgspec import Struct

from camtopod.arrays import Floats
from camtopod.records import Pair, Relation, Transit

TRUTH_SCHEMA = "camtopod/truth/1"
"""Name and version of the file format."""
CLUTTER = -1
"""Value in `Truth.identity`, `Truth.passage` and `Truth.zone` of an event that belongs to no
object.
"""


class TrueZone(Struct, frozen=True, omit_defaults=True):
    """Entry/exit zone; centre and covariance in fractions of the image, None without positions."""

    id: str
    camera: str
    x: float | None = None
    y: float | None = None
    cov: list[list[float]] | None = None


class TrueLink(Struct, frozen=True, omit_defaults=True, rename={"from_": "from"}):
    """Directed link.

    probability: that a walker takes it, whether or not the next passage is recorded.
    transitions: number of walks in these events with both ends recorded.
    closed_at, opened_at: seconds since the epoch after, or before, which nobody takes it.
    """

    from_: str
    to: str
    relation: Relation
    probability: float
    transitions: int
    transit: Transit
    closed_at: float | None = None
    opened_at: float | None = None


class Truth(Struct, frozen=True, omit_defaults=True):
    """Network and, for each event line, who caused it.

    identity[i]: walker of event ``i``.
    passage[i]: number of the passage within the walk; it rises along the walk, and unrecorded
        passages count, too.
    zone[i]: index into ``zones``.

    All three are `CLUTTER` for clutter.
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
    """Return the statistics of a sample of transit times, (n,) with n > 0."""
    q10, q50, q90 = np.quantile(seconds, (0.1, 0.5, 0.9))
    figures = (mode_of(seconds), np.mean(seconds), np.std(seconds), q10, q50, q90)
    return Transit(*(round(float(figure), 6) for figure in figures))


def mode_of(values: Floats) -> float:
    """Return the maximum of a Gaussian kernel density (Silverman's bandwidth), on a grid of 201
    points.
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
    """Return the related pairs of cameras: overlapped if any of their links is, else unseen
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
