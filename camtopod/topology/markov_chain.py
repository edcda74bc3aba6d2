"""The Markov chain over cameras (thesis 4.6): where those who leave a camera's view are seen
next.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

from camtopod.records import ChainEdge, Link, Zone


def markov_chain(zones: Iterable[Zone], links: Iterable[Link], digits: int) -> list[ChainEdge]:
    """Transition probabilities between cameras from the links that leave a view, sorted by camera.

    What is missing from 1 leaves the network or is not seen again. A camera may follow itself: an
    object comes back.
    """
    zone_of = {zone.id: zone for zone in zones}
    leaving: dict[str, int] = defaultdict(int)
    for zone in zone_of.values():
        leaving[zone.camera] += zone.exits
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
