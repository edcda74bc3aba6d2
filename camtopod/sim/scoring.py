"""Score of a learned topology against the ground truth."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from msgspec import Struct
from scipy.optimize import linear_sum_assignment

from camtopod.records import Link, Topology, Zone
from camtopod.sim.truth import TrueLink, TrueZone, Truth

ZONE_TOLERANCE = 0.1
"""Largest distance between the centres of matching zones, fraction of the image."""
TRANSIT_FLOOR_SECONDS = 1.0
"""Errors of transit times shorter than this are relative to it; near 0 a ratio means nothing."""


class Score(Struct, frozen=True):
    """Counts of a topology; links through a view do not count. Shares of nothing are 1.0."""

    cameras: int
    cameras_right: int
    """Cameras with exactly the true number of zones, all of them matched."""
    zones_true: int
    zones_learned: int
    zones_matched: int
    links_true: int
    """True links (unseen and overlapped) that were walked at all."""
    links_learned: int
    links_found: int
    right: list[tuple[Link, TrueLink]]
    """Learned links that are true ones, each with the true one."""
    pairs_true: int
    pairs_learned: int
    pairs_right: int
    """Learned pairs of cameras that are related in truth."""
    pair_relations_right: int
    """Right pairs of cameras with the true relation."""

    @property
    def links_right(self) -> int:
        """Number of learned links that are true ones."""
        return len(self.right)

    @property
    def relations_right(self) -> int:
        """Number of right links with the true relation (unseen or overlapped)."""
        return sum(link.relation == true.relation for link, true in self.right)

    @property
    def link_precision(self) -> float:
        """Share of the learned links that are true ones."""
        return _share(self.links_right, self.links_learned)

    @property
    def link_recall(self) -> float:
        """Share of the true links that were found."""
        return _share(self.links_found, self.links_true)

    @property
    def pair_precision(self) -> float:
        """Share of the learned pairs of cameras that are related in truth."""
        return _share(self.pairs_right, self.pairs_learned)

    @property
    def pair_recall(self) -> float:
        """Share of the pairs of cameras related in truth that were learned."""
        return _share(self.pairs_right, self.pairs_true)

    def transit_error(
        self, figure: str, together: Callable[[list[float]], np.floating[Any]] = np.median
    ) -> float:
        """Return the median (or ``together``) over the right links of the error of a figure.

        figure: name of a figure of the transit times.

        An error is |learned - true| / max(|true|, 1 s). Without right links it is nan.
        """
        errors = []
        for link, true in self.right:
            value = getattr(true.transit, figure)
            error = abs(getattr(link.transit, figure) - value)
            errors.append(error / max(abs(value), TRANSIT_FLOOR_SECONDS))
        return float(together(errors)) if errors else math.nan

    def text(self) -> str:
        """Return a few lines for people."""
        lines = [
            f"zones    {self.zones_matched} of {self.zones_true} found, {self.zones_learned} "
            f"learned; {self.cameras_right} of {self.cameras} cameras with all zones right",
            f"links    {self.links_found} of {self.links_true} found (recall "
            f"{self.link_recall:.2f}), {self.links_right} of {self.links_learned} learned true "
            f"(precision {self.link_precision:.2f}); relation right in {self.relations_right}",
            f"pairs    {self.pairs_right} of {self.pairs_true} found (recall "
            f"{self.pair_recall:.2f}), {self.pairs_learned} learned (precision "
            f"{self.pair_precision:.2f}); relation right in {self.pair_relations_right}",
        ]
        if self.right:
            mode, mean = (100 * self.transit_error(figure) for figure in ("mode", "mean"))
            lines.append(f"transit  median error {mode:.0f} % (mode), {mean:.0f} % (mean)")
        return "\n".join(lines)


def score(topology: Topology, truth: Truth) -> Score:
    """Compare a topology with the ground truth, at the level of zones."""
    # Zones.
    match = match_zones(topology.zones, truth.zones)
    true_zones = Counter(zone.camera for zone in truth.zones)
    learned_zones = Counter(zone.camera for zone in topology.zones)
    matched_zones = Counter(zone.camera for zone in truth.zones if zone.id in match)

    # The true links between learned zones; where several coincide, the one walked most.
    between = [link for link in truth.links if link.relation != "visible"]
    true_links = {
        (match[link.from_], match[link.to]): link
        for link in sorted(between, key=lambda link: link.transitions)
        if link.from_ in match and link.to in match
    }
    walked_links = [link for link in between if link.transitions > 0]
    learned_links = {
        (link.from_, link.to): link for link in topology.links if link.relation != "visible"
    }

    # Pairs of cameras.
    learned_pairs = {pair.cameras: pair.relation for pair in topology.pairs}
    true_pairs = {pair.cameras: pair.relation for pair in truth.pairs}
    common_pairs = learned_pairs.keys() & true_pairs.keys()
    return Score(
        cameras=len(truth.cameras),
        cameras_right=sum(
            true_zones[camera] == learned_zones[camera] == matched_zones[camera]
            for camera in truth.cameras
        ),
        zones_true=len(truth.zones),
        zones_learned=len(topology.zones),
        zones_matched=len(match),
        links_true=len(walked_links),
        links_learned=len(learned_links),
        links_found=sum(
            (match.get(link.from_), match.get(link.to)) in learned_links for link in walked_links
        ),
        right=[
            (link, true_links[ends]) for ends, link in learned_links.items() if ends in true_links
        ],
        pairs_true=len(true_pairs),
        pairs_learned=len(learned_pairs),
        pairs_right=len(common_pairs),
        pair_relations_right=sum(learned_pairs[pair] == true_pairs[pair] for pair in common_pairs),
    )


def match_zones(learned_zones: Sequence[Zone], true: Sequence[TrueZone]) -> dict[str, str]:
    """Return true zone -> learned zone, one to one within a camera, least total distance
    (Hungarian), at most `ZONE_TOLERANCE` apart.

    A learned zone without positions stands for the whole camera, so for all its true zones.
    """
    result: dict[str, str] = {}
    for camera in sorted({zone.camera for zone in true}):
        camera_zones = [zone for zone in learned_zones if zone.camera == camera]
        true_zones = [zone for zone in true if zone.camera == camera]
        whole = [zone for zone in camera_zones if zone.x is None]
        placed_zones = [zone for zone in camera_zones if zone.x is not None]
        if whole:
            result |= {zone.id: whole[0].id for zone in true_zones}
        elif placed_zones and true_zones[0].x is not None:
            a = np.array([(zone.x, zone.y) for zone in true_zones], dtype=float)
            b = np.array([(zone.x, zone.y) for zone in placed_zones], dtype=float)
            distance = np.linalg.norm(a[:, None] - b[None], axis=2)
            cost = np.where(distance <= ZONE_TOLERANCE, distance, 1e3)
            rows, columns = linear_sum_assignment(cost)
            near = distance[rows, columns] <= ZONE_TOLERANCE
            result |= {
                true_zones[i].id: placed_zones[j].id
                for i, j in zip(rows[near], columns[near], strict=True)
            }
    return result


def _share(part: int, whole: int) -> float:
    """Return part / whole, 1.0 of nothing."""
    return part / whole if whole else 1.0
