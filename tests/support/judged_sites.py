"""Links of a topology beside the true ways of a simulated recording."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from camtopod.records import Event, Link, Topology
from camtopod.sim.scoring import match_zones
from camtopod.sim.truth import CLUTTER, Truth


class Way(NamedTuple):
    """A true way between two learned zones: lags of its recorded transitions, seconds, and their
    share of the exits from the first zone.
    """

    lags: list[float]
    share: float


class JudgedSite(NamedTuple):
    """Links between cameras and true ways, each by zones of departure and arrival."""

    links: dict[tuple[str, str], Link]
    ways: dict[tuple[str, str], Way]

    @property
    def false(self) -> list[tuple[str, str]]:
        """Links that nobody walks."""
        return [ends for ends in self.links if ends not in self.ways]

    def found(self, least: int) -> float:
        """Return the share of the ways with at least so many transitions that are links."""
        walked = [ends for ends, way in self.ways.items() if len(way.lags) >= least]
        return float(np.mean([ends in self.links for ends in walked]))

    def share_error(self) -> float:
        """Return the mean error of the right links' probabilities."""
        right = self.links.keys() & self.ways.keys()
        return float(
            np.mean([abs(self.links[ends].probability - self.ways[ends].share) for ends in right])
        )

    def transit_error(self, figure: str, quantile: float) -> float:
        """Return the median error of a figure of the right links' transit times, seconds.

        figure: its name; ``quantile`` is the quantile of the true lags that it stands for.
        """
        right = sorted(self.links.keys() & self.ways.keys())
        true = [float(np.quantile(self.ways[ends].lags, quantile)) for ends in right]
        learned = [getattr(self.links[ends].transit, figure) for ends in right]
        return float(np.median(np.abs(np.subtract(learned, true))))


def judged(topology: Topology, events: Sequence[Event], truth: Truth) -> JudgedSite:
    """Return the links of a topology and the ways between its zones."""
    match = match_zones(topology.zones, truth.zones)
    zone = [None if z == CLUTTER else match.get(truth.zones[z].id) for z in truth.zone]

    # Passages of each walker, in order, and the exits from each learned zone.
    walks: dict[int, dict[int, dict[str, tuple[float, str | None]]]] = defaultdict(dict)
    exits: dict[str, int] = defaultdict(int)
    for event, walker, number, place in zip(
        events, truth.identity, truth.passage, zone, strict=True
    ):
        if walker != CLUTTER:
            walks[walker].setdefault(number, {})[event.kind] = event.t, place
        if event.kind == "exit" and place is not None:
            exits[place] += 1

    # Transitions between passages of which none is missed in between.
    lags: dict[tuple[str, str], list[float]] = defaultdict(list)
    for walk in walks.values():
        for number, passage in walk.items():
            left, source = passage.get("exit", (0.0, None))
            came, target = walk.get(number + 1, {}).get("entry", (0.0, None))
            if source is not None and target is not None:
                lags[source, target].append(came - left)
    return JudgedSite(
        {(link.from_, link.to): link for link in topology.links if link.relation != "visible"},
        {ends: Way(each, len(each) / exits[ends[0]]) for ends, each in lags.items()},
    )
