"""What a site without links between views waits for, in passages and minutes."""

from __future__ import annotations

import pytest
from msgspec.structs import replace
from synthetic_topology import made_link, synthetic_topology

from camtopod.records import Lacks, Topology
from camtopod.topology import likely_links, links_between_views, waiting_for_links

SITE = synthetic_topology(12)
A, B = SITE.zones[0], SITE.zones[-1]


def without_links(weak: list[tuple[float, float, float]], cameras: int = 12) -> Topology:
    """Return the site without links; ``weak``: (transitions, passages and seconds that lack)."""
    return replace(
        SITE,
        cameras=SITE.cameras[:cameras],
        links=[link for link in SITE.links if link.relation == "visible"],
        pairs=[],
        weak_links=[
            replace(made_link(A.id, B.id, 20.0, n), lacks=Lacks(passages, seconds))
            for n, passages, seconds in weak
        ],
    )


def test_links_are_those_between_views() -> None:
    assert 0 < len(links_between_views(SITE)) < len(SITE.links)
    assert waiting_for_links(SITE) == ""


def test_the_nearest_one_is_named_with_what_it_has_and_lacks() -> None:
    topology = without_links([(3.0, 40.0, 9000.0), (4.0, 6.0, 2400.0)])
    passages = sum(zone.exits for zone in topology.zones)

    assert waiting_for_links(topology) == (
        f"No two cameras are linked yet: {passages:,} passages so far. The nearest one, "
        f"{A.camera} to {B.camera}, has 4 of about 10; about 40 minutes at this traffic."
    )


@pytest.mark.parametrize("weak", [[], [(1.0, 2.0, 60.0)]])
def test_without_a_near_one_it_says_how_many_passages_a_link_takes(
    weak: list[tuple[float, float, float]],
) -> None:
    assert "A link takes about ten passages" in waiting_for_links(without_links(weak))


def test_a_link_within_one_view_is_not_likely() -> None:
    inside = replace(made_link(A.id, A.id, 20.0, 9.0), lacks=Lacks(1.0, 60.0))
    topology = replace(without_links([]), weak_links=[inside])
    assert likely_links(topology) == []
    assert "nearest one" not in waiting_for_links(topology)


def test_likely_is_what_has_at_least_half_of_what_it_needs() -> None:
    topology = without_links([(5.0, 5.1, 60.0), (5.0, 5.0, 300.0), (9.0, 2.0, 120.0)])
    assert [link.transitions for link in likely_links(topology)] == [9.0, 5.0]
