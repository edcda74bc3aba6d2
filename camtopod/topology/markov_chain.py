"""The Markov chain over cameras (thesis 4.6): the next camera of objects that leave a view."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

from camtopod.records import ChainEdge, Link, Zone


def estimate_markov_chain(
    zones: Iterable[Zone], links: Iterable[Link], digits: int
) -> list[ChainEdge]:
    """Return the transition probabilities between cameras, sorted by camera.

    The remainder to 1 is the probability that an object leaves the site or is not seen again. A
    camera may follow itself, as objects come back.

    digits: decimals of the probabilities.
    """
    # Exits of each camera.
    zone_of = {zone.id: zone for zone in zones}
    leaving: dict[str, int] = defaultdict(int)
    for zone in zone_of.values():
        leaving[zone.camera] += zone.exits

    # Expected transitions between cameras, over all links that leave a view.
    moved: dict[tuple[str, str], float] = defaultdict(float)
    for link in links:
        if link.relation != "visible":
            source = zone_of[link.from_]
            moved[source.camera, zone_of[link.to].camera] += link.probability * source.exits

    return [
        ChainEdge(here, there, round(min(number / leaving[here], 1.0), digits))
        for (here, there), number in sorted(moved.items())
        if leaving[here] > 0
    ]
