"""Layout of a simulated network: zones, the paths that join them, and how often each is walked."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import minimum_spanning_tree

from camtopod.arrays import Floats, Longs

ZONES_MIN, ZONES_MAX = 2, 5
"""Least and largest number of zones of a camera."""
ZONE_SEPARATION = 0.25
"""Least distance of two zones of one camera, fraction of the image."""
ZONE_SD_MIN, ZONE_SD_MAX = 0.015, 0.04
"""Range of a zone's standard deviations, fraction of the image."""
WALKING_SPEED = 1.3
"""Speed of the median walker, metres per second."""
PATH_SECONDS = (3.0, 60.0)
"""Range of an unseen path's length, seconds at the median speed."""
OVERLAP_SECONDS = (1.0, 5.0)
"""Range of an overlap's length, seconds at the median speed."""
VIEW_METRES = (10.0, 25.0)
"""Range of a view's width."""
PATHS_PER_ZONE_MAX = 3
"""Most paths of a zone."""


Paths = set[tuple[int, int]]
"""Directed paths (from zone, to zone)."""


@dataclass(frozen=True)
class Choices:
    """Next zones of each zone: ``target``, ``probability`` and ``metres``, each (zones, options).

    Unused options have probability 0. Metres are negative for an overlap: how far before leaving
    one view an object appears in the other.
    """

    target: Longs
    probability: Floats
    metres: Floats

    def without(self, closed_paths: Paths) -> Choices:
        """Return the choices without the directed paths ``closed_paths``.

        Their probability goes to the zone's other paths; where there are none, walkers leave the
        site.
        """
        probability = self.probability.copy()
        for u, v in closed_paths:
            probability[u, self.target[u] == v] = 0.0
        total = self.probability.sum(1, keepdims=True)
        open_share = probability.sum(1, keepdims=True)
        scale = np.divide(total, open_share, out=np.zeros_like(total), where=open_share > 0)
        return Choices(self.target, probability * scale, self.metres)


@dataclass(frozen=True)
class Layout:
    """Zones, paths through and between views, and where walkers come from.

    camera (zones,): index of each zone's camera.
    centre (zones, 2), cov (zones, 2, 2): position of each zone in the image.
    through, onward: choices inside a view, and from one view to the next.
    arrivals (zones,): probability that a walker enters the network there.
    closing, opening: directed paths that close, and that open, half-way.
    """

    cameras: list[str]
    camera: Longs
    centre: Floats
    cov: Floats
    through: Choices
    onward: Choices
    arrivals: Floats
    closing: Paths = field(default_factory=set)
    opening: Paths = field(default_factory=set)


def make_layout(cameras: int, rng: np.random.Generator, overlap_share: float) -> Layout:
    """Return a connected network of ``cameras`` (> 0) views.

    overlap_share: overlapping pairs of cameras, per camera.
    """

    # Zones.
    counts = rng.integers(ZONES_MIN, ZONES_MAX + 1, cameras)
    camera = np.repeat(np.arange(cameras), counts)
    centre, cov = _zones(counts, rng)
    street = _streets(camera, cameras, rng)

    # Paths between the zones.
    paths = _Paths(camera, street, rng.random((cameras, 2)), rng)
    paths.overlaps(round(overlap_share * cameras), max(1, math.ceil(2 * overlap_share)))
    paths.connect()
    paths.branch()

    # Probabilities of leaving and of entering the site.
    leave = np.where(
        street, rng.uniform(0.4, 0.8, len(camera)), rng.uniform(0.02, 0.1, len(camera))
    )
    arrivals = np.where(street, rng.uniform(0.5, 1.5, len(camera)), 0.05)
    width = max(2, len(str(cameras)))
    return Layout(
        cameras=[f"cam{number + 1:0{width}d}" for number in range(cameras)],
        camera=camera,
        centre=centre,
        cov=cov,
        through=_through(camera, centre, rng),
        onward=_onward(paths.options, leave, rng),
        arrivals=arrivals / arrivals.sum(),
    )


def with_doors(layout: Layout, closing: int, opening: int, rng: np.random.Generator) -> Layout:
    """Return the layout with doors in some unseen paths, which close or open both directions."""
    onward = layout.onward
    rows, options = np.nonzero((onward.probability > 0) & (onward.metres > 0))
    ends = zip(rows.tolist(), onward.target[rows, options].tolist(), strict=True)
    paths = sorted({(min(path), max(path)) for path in ends})
    doors = [paths[k] for k in rng.permutation(len(paths))[: closing + opening]]
    return replace(
        layout,
        closing={way for u, v in doors[:closing] for way in ((u, v), (v, u))},
        opening={way for u, v in doors[closing:] for way in ((u, v), (v, u))},
    )


def without_paths(layout: Layout) -> Layout:
    """Return the layout without paths: an object that leaves a view has left the site."""
    onward = replace(layout.onward, probability=np.zeros_like(layout.onward.probability))
    return replace(
        layout, onward=onward, arrivals=np.full(len(layout.camera), 1 / len(layout.camera))
    )


def _zones(counts: Longs, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return centres (zones, 2) and covariances (zones, 2, 2); zones of one camera are well
    apart.
    """
    zones: list[tuple[Floats, Floats]] = []
    for count in counts:
        camera_zones: list[tuple[Floats, Floats]] = []
        tries = 0
        while len(camera_zones) < count:
            tries += 1
            if tries > 1000:  # those placed first leave no room
                camera_zones = []
                tries = 0
            centre, angle = _place(rng)
            if all(
                math.dist(centre, centre_before) >= ZONE_SEPARATION
                for centre_before, _ in camera_zones
            ):
                zone = centre, _ellipse(angle, rng)
                if all(_apart(zone, zone_before) for zone_before in camera_zones):
                    camera_zones.append(zone)
        zones += camera_zones
    return np.array([centre for centre, _ in zones]), np.array([cov for _, cov in zones])


def _apart(first: tuple[Floats, Floats], second: tuple[Floats, Floats]) -> bool:
    """Return True if two zones (centre, covariance) can be distinguished.

    They are five mean standard deviations apart along their line.
    """
    between = second[0] - first[0]
    distance = float(np.linalg.norm(between))
    sds = [math.sqrt(between @ cov @ between) / distance for _, cov in (first, second)]
    return distance >= 5.0 * sum(sds) / 2


def _place(rng: np.random.Generator) -> tuple[Floats, float]:
    """Return a zone's centre and direction: along the border, or any direction for a door in
    mid-view, as one in five is.
    """
    if rng.random() < 0.2:
        return rng.uniform((0.25, 0.3), (0.75, 0.65)), rng.uniform(0, math.pi)
    along = rng.uniform(0.12, 0.88)
    inset = rng.uniform(0.05, 0.08)
    side = rng.choice(4, p=(0.3, 0.3, 0.25, 0.15))
    at = ((inset, along), (1 - inset, along), (along, 1 - inset), (along, inset))[side]
    return np.array(at), (math.pi / 2, math.pi / 2, 0.0, 0.0)[side]


def _ellipse(angle: float, rng: np.random.Generator) -> Floats:
    """Return a random covariance, (2, 2), with its long axis at ``angle`` (radians)."""
    minor = rng.uniform(ZONE_SD_MIN, 0.5 * (ZONE_SD_MIN + ZONE_SD_MAX))
    major = rng.uniform(minor, ZONE_SD_MAX)
    turn = np.array(((math.cos(angle), -math.sin(angle)), (math.sin(angle), math.cos(angle))))
    result: Floats = turn @ np.diag((major**2, minor**2)) @ turn.T
    return result


def _streets(camera: Longs, cameras: int, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return which zones lead outside, about one in five.

    At least two zones of the network do, and never all of a camera's unless it is the only one.
    """
    street = rng.random(len(camera)) < 0.2
    if cameras == 1:
        return np.ones(len(camera), dtype=bool)
    for c in range(cameras):
        camera_zones = np.flatnonzero(camera == c)
        if street[camera_zones].all():
            street[rng.choice(camera_zones)] = False
    for c in rng.permutation(cameras):
        if street.sum() >= 2:
            break
        inner_zones = np.flatnonzero((camera == c) & ~street)
        if len(inner_zones) > 1:
            street[rng.choice(inner_zones)] = True
    return street


class _Paths:
    """Joins zones of different cameras, near ones first; ``options[u]`` lists (v, metres) of zone
    u.
    """

    def __init__(
        self, camera: Longs, street: NDArray[np.bool_], position: Floats, rng: np.random.Generator
    ) -> None:
        self.options: list[list[tuple[int, float]]] = [[] for _ in camera]
        self._camera = camera
        self._street = street
        self._rng = rng
        self._distance = np.hypot(*(position[:, None] - position[None]).transpose(2, 0, 1))
        self._exclusive: set[int] = set()

    def overlaps(self, count: int, per_camera: int) -> None:
        """Let the nearest ``count`` pairs of cameras with a free zone overlap, at most
        ``per_camera`` per camera.
        """
        a, b = np.triu_indices(len(self._distance), 1)
        for k in np.argsort(self._distance[a, b], kind="stable"):
            if not count:
                break
            zones = self._spare(int(a[k]), per_camera), self._spare(int(b[k]), per_camera)
            if all(zones):
                u, v = (int(self._rng.choice(z)) for z in zones)
                self._join(u, v, -self._log_uniform(OVERLAP_SECONDS))
                self._exclusive |= {u, v}
                count -= 1

    def _spare(self, camera: int, per_camera: int) -> list[int]:
        """Return inner zones without a path, of a camera with fewer than ``per_camera`` overlaps so
        far.
        """
        camera_zones = self._of(camera)
        overlaps = sum(u in self._exclusive for u in camera_zones)
        if overlaps >= per_camera or (overlaps and len(camera_zones) - overlaps < 2):
            return []  # a zone stays for other paths
        return [u for u in camera_zones if not self.options[u] and not self._street[u]]

    def connect(self) -> None:
        """Add unseen paths along a spanning tree of the cameras, so that the network is
        connected.
        """
        tree = minimum_spanning_tree(self._distance).tocoo()
        for a, b in zip(tree.row, tree.col, strict=True):
            if b not in {self._camera[v] for u in self._of(int(a)) for v, _ in self.options[u]}:
                self._join(
                    self._least(int(a)), self._least(int(b)), self._log_uniform(PATH_SECONDS)
                )

    def branch(self) -> None:
        """Give every inner zone a path, and two in five another one."""
        for u in self._rng.permutation(len(self._camera)).tolist():
            extra = int(self._rng.random() < 0.4)
            path_count = min(max(1, len(self.options[u]) + extra), PATHS_PER_ZONE_MAX)
            if self._street[u] or u in self._exclusive:
                continue
            while len(self.options[u]) < path_count and (v := self._nearby(u)) is not None:
                self._join(u, v, self._log_uniform(PATH_SECONDS))

    def _nearby(self, u: int) -> int | None:
        """Return a zone of a near camera that can have another path."""
        for c in np.argsort(self._distance[self._camera[u]], kind="stable")[1:6]:
            taken_zones = self._exclusive | {v for v, _ in self.options[u]}
            inner = [v for v in self._of(int(c)) if v not in taken_zones and not self._street[v]]
            free = [v for v in inner if len(self.options[v]) < PATHS_PER_ZONE_MAX]
            if free and self._rng.random() < 0.7:
                return min(free, key=lambda v: len(self.options[v]))
        return None

    def _of(self, camera: int) -> list[int]:
        """Return the zones of a camera."""
        return [int(u) for u in np.flatnonzero(self._camera == camera)]

    def _least(self, camera: int) -> int:
        """Return the zone with the fewest paths, inner ones first."""
        return min(
            (u for u in self._of(camera) if u not in self._exclusive),
            key=lambda u: (len(self.options[u]) >= 2, bool(self._street[u]), len(self.options[u])),
        )

    def _join(self, u: int, v: int, metres: float) -> None:
        """Join two zones by a path."""
        self.options[u].append((v, metres))
        self.options[v].append((u, metres))

    def _log_uniform(self, seconds: tuple[float, float]) -> float:
        """Return a random length in metres, log-uniform in the time of the median walker."""
        return WALKING_SPEED * math.exp(
            self._rng.uniform(math.log(seconds[0]), math.log(seconds[1]))
        )


def _onward(
    options: list[list[tuple[int, float]]], leave: Floats, rng: np.random.Generator
) -> Choices:
    """Return where walkers go after leaving at a zone; the rest to 1 leaves the site."""
    rows = []
    for zone, ways in enumerate(options):
        shares = 0.15 + rng.dirichlet(np.full(max(1, len(ways)), 3.0))
        shares *= (1 - leave[zone]) / shares.sum()
        rows.append([(v, p, metres) for (v, metres), p in zip(ways, shares, strict=False)])
    return _table(rows)


def _through(camera: Longs, centre: Floats, rng: np.random.Generator) -> Choices:
    """Return where walkers who enter at a zone leave the view; each row sums to 1."""
    u_turn = 0.03  # they leave where they entered, four metres later
    rows = []
    for zone, c in enumerate(camera):
        other_zones = [int(v) for v in np.flatnonzero(camera == c) if v != zone]
        metres = rng.uniform(*VIEW_METRES)
        shares = (
            (0.2 + rng.dirichlet(np.full(len(other_zones), 2.0)))
            / (1 + 0.2 * len(other_zones))
            * (1 - u_turn)
        )
        row = [
            (v, p, 2 + metres * math.dist(centre[zone], centre[v]))
            for v, p in zip(other_zones, shares, strict=True)
        ]
        rows.append([*row, (zone, u_turn, 4.0)])
    return _table(rows)


def _table(rows: list[list[tuple[int, float, float]]]) -> Choices:
    """Return the rows of (target, probability, metres) as arrays padded with probability 0."""
    options = max(1, max(len(row) for row in rows))
    table = np.array([row + [(0, 0.0, 0.0)] * (options - len(row)) for row in rows])
    return Choices(table[..., 0].astype(np.int64), table[..., 1], table[..., 2])
