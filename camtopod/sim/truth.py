"""Ground truth of a simulated camera network, against which a learned topology is scored."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec
import numpy as np
from msgspec import Struct

from camtopod.arrays import Floats
from camtopod.records import Pair, PairRelation, Relation, Transit

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


def relation_of(lag: float) -> Relation:
    """Return the relation of a link between views with a usual lag, seconds."""
    return "overlapped" if lag < 0 else "unseen"


def pairs_of(links: list[TrueLink], camera_of: dict[str, str]) -> list[Pair]:
    """Return the related pairs of cameras: overlapped if any of their links is, else unseen
    path.
    """
    pairs: dict[tuple[str, str], PairRelation] = {}
    for link in links:
        a, b = sorted((camera_of[link.from_], camera_of[link.to]))
        if link.relation == "overlapped":
            pairs[a, b] = "overlapped"
        elif a != b:
            pairs.setdefault((a, b), "unseen_path")
    return [Pair(cameras, relation) for cameras, relation in sorted(pairs.items())]


def zone_at(name: str, camera: str, at: Floats) -> TrueZone:
    """Return a zone with the mean and covariance of its positions (n, 2)."""
    x, y = np.round(at.mean(0), 4).tolist()
    deviation = at - at.mean(0)
    cov = deviation.T @ deviation / max(len(at) - 1, 1)
    return TrueZone(name, camera, x, y, np.round(cov, 7).tolist())


def walked_links(
    lags: Mapping[tuple[str, str], Sequence[float]],
    exits: Mapping[str, int],
    transitions: Mapping[tuple[str, str], int],
) -> list[TrueLink]:
    """Return the links that were walked, sorted by zones.

    lags (seconds): of the walks from one zone to another.
    exits: number of walks that leave at a zone.
    transitions: number of walks with both ends recorded.
    """
    return [
        TrueLink(
            from_=ends[0],
            to=ends[1],
            relation=relation_of(float(np.median(seconds))),
            probability=round(len(seconds) / exits[ends[0]], 6),
            transitions=transitions.get(ends, 0),
            transit=transit_of(np.array(seconds)),
        )
        for ends, seconds in sorted(lags.items())
    ]
