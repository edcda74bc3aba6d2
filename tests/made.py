"""Made things for tests: a topology that is exactly the truth."""

from camtopod.records import TOPOLOGY_SCHEMA, Camera, Link, Topology, Zone
from camtopod.sim.truth import Truth


def topology_of(truth: Truth) -> Topology:
    """What a learner that knew everything would publish."""
    zones = [Zone(id=z.id, camera=z.camera, entries=100, exits=100, x=z.x, y=z.y, cov=z.cov) for z in truth.zones]
    links = [
        Link(
            from_=link.from_,
            to=link.to,
            relation=link.relation,
            probability=link.probability,
            transitions=100 * link.probability,
            transit=link.transit,
            q_value=0.0,
            mahalanobis_variance=0.5,
        )
        for link in truth.links
        if link.transitions > 0
    ]
    cameras = [Camera(id=c, zones=[z.id for z in zones if z.camera == c]) for c in truth.cameras]
    return Topology(
        schema=TOPOLOGY_SCHEMA,
        site="made",
        epoch="01J",
        version=3,
        as_of=1_700_003_600.0,
        events=4000,
        digest="sha256:0",
        cameras=cameras,
        zones=zones,
        links=links,
        pairs=truth.pairs,
    )
