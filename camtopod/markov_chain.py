"""The Markov chain over cameras (thesis 4.6): which camera sees an object next after another.

It is computed from the links of a version, and says nothing about times or zones.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # which have the chain as a matrix
    from camtopod.records import Link, Zone


def estimate_markov_chain(
    zones: Iterable[Zone], links: Iterable[Link]
) -> dict[str, dict[str, float]]:
    """Return the probabilities of the next cameras, by camera and next camera.

    zones: all zones, with their exits.
    links: the links to use; visible links do not count, as they lead through one view.

    The probabilities of a camera add up to at most 1; the rest is the probability that an object
    leaves the site. A camera may follow itself, as objects come back.
    """
    # Exits of each camera.
    zone_of = {zone.id: zone for zone in zones}
    exits_of: dict[str, int] = defaultdict(int)
    for zone in zone_of.values():
        exits_of[zone.camera] += zone.exits

    # Expected transitions between cameras, summed over links.
    transitions: dict[tuple[str, str], float] = defaultdict(float)
    for link in links:
        if link.relation != "visible":
            source = zone_of[link.from_]
            transitions[source.camera, zone_of[link.to].camera] += link.probability * source.exits

    chain: dict[str, dict[str, float]] = {}
    for (camera, next_camera), number in sorted(transitions.items()):
        if exits_of[camera] > 0:
            chain.setdefault(camera, {})[next_camera] = min(number / exits_of[camera], 1.0)
    return chain
