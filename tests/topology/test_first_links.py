"""What a site without links between views waits for: a share of the evidence, a time in words."""

from __future__ import annotations

import pytest
from model_rows import with_rows
from msgspec.structs import replace
from synthetic_topology import made_link, synthetic_topology

from camtopod.records import Lacks, Topology
from camtopod.topology import (
    evidence_for_links,
    likely_links,
    links_between_views,
    waiting_for_links,
    weak_links,
)

SITE = synthetic_topology(12)
A, B = SITE.zones[0], SITE.zones[-1]


def without_links(weak: list[tuple[float, float, float]], cameras: int = 12) -> Topology:
    """Return the site without links; ``weak``: (transitions, passages and seconds that lack)."""
    return replace(
        with_rows(
            SITE,
            weak=[
                replace(made_link(A.id, B.id, 20.0, n), lacks=Lacks(passages, seconds))
                for n, passages, seconds in weak
            ],
        ),
        cameras=SITE.cameras[:cameras],
        links=[link for link in SITE.links if link.relation == "visible"],
        pairs=[],
    )


def test_links_are_those_between_views() -> None:
    assert 0 < len(links_between_views(SITE)) < len(SITE.links)
    assert waiting_for_links(SITE) == ""


@pytest.mark.parametrize(
    ("weak", "said"),
    [
        ([], "0% of the evidence is there"),
        ([(1.0, 2.0, 60.0)], "0% of the evidence is there"),
        (
            [(3.0, 40.0, 9000.0), (4.0, 6.0, 2400.0)],
            "40% of the evidence is there, the rest takes about half an hour at this traffic",
        ),
        (
            [(6.0, 4.0, 4000.0)],
            "60% of the evidence is there, the rest takes about an hour at this traffic; "
            f"nearest are {A.camera} and {B.camera}",
        ),
    ],
)
def test_one_share_says_how_near_the_first_link_is(
    weak: list[tuple[float, float, float]], said: str
) -> None:
    words = waiting_for_links(without_links(weak))
    assert words == f"No two cameras are linked yet: {said}."


@pytest.mark.parametrize("kind", ["entries", "exits"])
def test_a_link_needs_entries_and_exits(kind: str) -> None:
    site = without_links([(6.0, 4.0, 4000.0)])
    half = replace(site, zones=[replace(zone, **{kind: 0}) for zone in site.zones])
    assert waiting_for_links(half) == f"A link needs exits and entries: there are no {kind}."


def test_a_pair_is_named_only_if_it_leads_clearly() -> None:
    """Another pair that has more than half as much keeps both unnamed."""
    topology = without_links([(9.0, 3.0, 300.0)])
    c, d = SITE.zones[1], SITE.zones[-2]
    for n, named in ((2.0, True), (6.0, False)):
        other = replace(made_link(c.id, d.id, 20.0, n), lacks=Lacks(6.0, 900.0))
        both = with_rows(topology, weak=[*weak_links(topology), other])
        assert ("nearest are" in waiting_for_links(both)) == named


def test_the_share_never_falls_and_ends_with_the_first_link() -> None:
    before = None
    shares = []
    for n, lacks in ((3.0, 114.0), (9.0, 2.0), (12.0, 22.0), (25.0, 5.0)):
        version = without_links([(n, lacks, 300.0)])
        before = replace(version, evidence=evidence_for_links(version, before))
        assert before.evidence is not None
        shares.append(before.evidence)
        assert f"{before.evidence:.0%} of the evidence" in waiting_for_links(before)
    assert shares == [0.03, 0.82, 0.82, 0.83]
    assert evidence_for_links(SITE, before) is None


def test_a_link_within_one_view_is_not_likely() -> None:
    inside = replace(made_link(A.id, A.id, 20.0, 9.0), lacks=Lacks(1.0, 60.0))
    topology = with_rows(without_links([]), weak=[inside])
    assert likely_links(topology) == []
    assert "0% of the evidence is there." in waiting_for_links(topology)


def test_likely_is_what_has_at_least_half_of_what_it_needs() -> None:
    topology = without_links([(5.0, 5.1, 60.0), (5.0, 5.0, 300.0), (9.0, 2.0, 120.0)])
    assert [link.transitions for link in likely_links(topology)] == [9.0, 5.0]
