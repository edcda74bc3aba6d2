"""Several views end to end, on events without pictures."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest

from bench import views
from bench.scenes.stops import with_stops
from camtopod.cli.commands.demo import WALKERS_PER_SECOND
from camtopod.records import Event
from camtopod.sim.floor import FPS, demo_plan, simulate_walks


def passage(camera: str, begin: float, end: float, person: str) -> list[Event]:
    entry = Event(camera, "entry", begin, 0.0, 0.5, person)
    return [entry, Event(camera, "exit", end, 1.0, 0.5, person)]


@pytest.fixture
def people() -> dict[str, list[Event]]:
    """Return two people who go through views a and b, which overlap, then through c."""
    return {
        person: [
            *passage("a", 1.0, 9.0 * pace, person),
            *passage("b", 6.0 * pace, 14.0 * pace, person),
            *passage("c", 40.0 * pace, 48.0 * pace, person),
        ]
        for person, pace in (("P", 1.0), ("Q", 1.2))
    }


def test_true_events_make_true_links(people: dict[str, list[Event]]) -> None:
    told = {**people, "": [Event("b", "entry", 20.0, 0.4, 0.4)]}

    one = views.visits(people, [told], np.random.default_rng(1))

    for events in (one.true, one.seen):
        network = views.judged(views.learned(events), one.passages)
        assert (network.pairs, network.pairs_related, network.pairs_false) == (2, 2, 0)
        assert (network.links_true, network.links_timed, network.clocks) == (2, 2, 0)
        assert network.links_learned == network.links_true + network.links_false
    assert len(one.true) < len(one.seen) < 1.1 * len(one.true)


def test_a_link_that_nobody_walks_is_false(people: dict[str, list[Event]]) -> None:
    one = views.visits(people, [{**people, "": []}], np.random.default_rng(1))
    topology = views.learned(one.true)
    turned = [
        msgspec.structs.replace(link, from_=link.to, to=link.from_)
        for link in topology.links
        if link.relation != "visible"
    ]

    network = views.judged(msgspec.structs.replace(topology, links=turned), one.passages)

    assert (network.links_true, network.links_false) == (0, 2)


def test_people_stop_and_go_in_company() -> None:
    rng = np.random.default_rng(1)
    walks = simulate_walks(demo_plan(), 300.0, WALKERS_PER_SECOND, rng)

    more = with_stops(walks, rng)

    assert len(more) > len(walks)
    assert max(len(walk.t) for walk in more) > max(len(walk.t) for walk in walks)
    for walk in more:
        assert len(walk.t) == len(walk.floor) == len(walk.way)
        assert np.allclose(np.diff(walk.t), 1.0 / FPS)
