"""Weak links of a version are, from columns, what they were as links."""

from __future__ import annotations

from msgspec.structs import replace
from synthetic_topology import made_link, synthetic_topology

from camtopod.codec import read, to_json
from camtopod.records import Lacks, Link, Topology
from camtopod.topology import last_events, weak_columns, weak_links

SITE = synthetic_topology(6)


def shortened(link: Link) -> Link:
    """Return a link with figures of six digits, as learned ones have, and without a histogram."""
    transit = replace(link.transit, mean=1.23457e-05, q50_sd=None)
    return replace(link, transit=transit, histogram=None, probability=0.333333)


def test_weak_links_are_what_they_were() -> None:
    a, b, c = (zone.id for zone in SITE.zones[:3])
    links = [
        replace(shortened(made_link(a, b, 20.0, 3.0)), lacks=Lacks(7.0, 3600.0)),
        shortened(made_link(b, c, -1.5, 3.0, overlapped=True)),
        replace(shortened(made_link(c, a, 20.0, 3.0)), provisional="the recording is a loop"),
    ]
    assert SITE.model is not None
    for some in (links, links[:2], []):
        model = replace(SITE.model, weak_links=weak_columns(some, SITE.zones))
        version = read(Topology, to_json(replace(SITE, model=model)))
        told = [replace(link, transit=rounded(link)) for link in some]
        assert weak_links(version) == told
    assert weak_links(replace(SITE, model=None)) == []


def rounded(link: Link) -> object:
    names = ("mode", "mean", "sd", "q10", "q50", "q90", "mean_sd")
    figures = {name: float(f"{getattr(link.transit, name):.6g}") for name in names}
    return replace(link.transit, **figures)


def test_last_events_are_those_of_cameras_that_had_one() -> None:
    assert set(last_events(SITE).values()) == {SITE.as_of}
    assert last_events(SITE).keys() == {camera.id for camera in SITE.cameras}
    assert last_events(replace(SITE, model=None)) == {}
