"""A camera that delivers to the daemons of several sites, each of which may be away or begin anew."""

from __future__ import annotations

import contextlib
import shutil
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from fake_bus_daemon import NOW, running
from serving import T0, WAIT_SECONDS, closing_event, free_endpoint, small_config, wait_for, walkers

from camtopod import codec
from camtopod.client import Publisher
from camtopod.config import BusSettings, Config, Limits, OtherSite, SiteSettings
from camtopod.config.settings import StateSettings
from camtopod.learn.learner import Learner
from camtopod.records import Event
from camtopod.serve.bus import dial
from camtopod.serve.daemon import Daemon
from camtopod.serve.outbox import SiteLink, SpoolPublisher, open_spool
from camtopod.serve.storage import Journal

EVENTS = [event for event in walkers(30) if event.camera == "a"]
NORTH, SOUTH = "north", "south"


class City:
    """Two sites, each with a daemon that comes and goes, and the configuration of their cameras."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.endpoints = {site: free_endpoint() for site in (NORTH, SOUTH)}
        self.config = Config(
            site=SiteSettings(NORTH),
            bus=BusSettings(connect=(self.endpoints[NORTH],), connect_seconds=0.2),
            sites={SOUTH: OtherSite(connect=(self.endpoints[SOUTH],))},
            state=StateSettings(str(folder / "box")),
        )

    @contextlib.contextmanager
    def daemon(self, site: str) -> Iterator[Daemon]:
        with running(self.folder / site, self.endpoints[site], site=site) as daemon:
            yield daemon

    def publisher(self, **limits: int) -> Publisher:
        config = msgspec.structs.replace(self.config, limits=Limits(**limits))
        return Publisher("a", config=config, sites=(NORTH, SOUTH))

    def stored(self, site: str) -> Counter[float]:
        """Return how often the journal of a site has the event of each time."""
        return Counter(event.t for event in self.journal(site))

    def journal(self, site: str) -> list[Event]:
        with contextlib.closing(Journal(self.folder / site / "state")) as journal:
            entries = [entry for _, entry in journal.entries() if entry is not None]
        return [codec.event_from_bytes(one.raw) for one in entries if one.kind == "event"]


@pytest.fixture
def city(tmp_path: Path) -> City:
    return City(tmp_path)


def once(events: list[Event]) -> Counter[float]:
    return Counter(event.t for event in events)


def has(daemon: Daemon, count: int) -> None:
    wait_for(lambda: daemon.status().events.stored >= count, f"{count} events")


def test_each_site_stores_each_event_once_and_replays_to_its_own_digest(city: City) -> None:
    """Of three cameras, a and c are of both sites, b is of its owner alone, as `ingest` has it."""
    events = [*walkers(60), closing_event()]
    sites = {"b": (NORTH,)}
    with contextlib.ExitStack() as stack:
        daemons = {site: stack.enter_context(city.daemon(site)) for site in (NORTH, SOUTH)}
        spool = open_spool(
            city.folder / "box",
            NORTH,
            "ingest",
            city.config.limits,
            lambda camera: sites.get(camera, (NORTH, SOUTH)),
        )
        stack.callback(spool.close)
        publisher = SpoolPublisher(spool)
        stack.callback(publisher.close)
        for site in ("", SOUTH):
            stack.callback(SiteLink(city.config, publisher, (), site).close)
        for batch in (events[:50], events[50:-1], events[-1:]):
            publisher.publish(*batch)
            assert publisher.wait_stored(WAIT_SECONDS)
        heard = {NORTH: events, SOUTH: [event for event in events if event.camera != "b"]}
        digests = {}
        for site, daemon in daemons.items():
            learner = Learner(small_config(Path()).learn, site, "any")
            for event in heard[site]:
                learner.receive(event)
            assert learner.topology is not None
            digests[site] = learner.topology.digest

            def is_learned(daemon: Daemon = daemon, digest: str = digests[site]) -> bool:
                return daemon.topology is not None and daemon.topology.digest == digest

            wait_for(is_learned, f"the version of {site}")
        assert digests[NORTH] != digests[SOUTH]
        assert not spool.queue(SOUTH).cameras().count("b")

    for site in (NORTH, SOUTH):
        assert city.stored(site) == once(heard[site])
        learner = Learner(small_config(Path()).learn, site, "any")
        for event in city.journal(site):
            learner.receive(event)
        assert learner.topology is not None
        assert learner.topology.digest == digests[site], "the journal replays to it"


def test_a_site_that_is_away_keeps_no_other_waiting_and_gets_all_when_it_is_back(
    city: City,
) -> None:
    third = len(EVENTS) // 3
    with city.daemon(NORTH) as north:
        with city.publisher() as publisher:
            publisher.publish(*EVENTS[:third])
            has(north, third)
            assert (publisher.waiting, publisher.wait_stored(0.0)) == (third, False)
        with city.publisher() as publisher:  # another boot; the first one still waits
            publisher.publish(*EVENTS[third : 2 * third])
            has(north, 2 * third)
            assert publisher.waiting == 2 * third
            with city.daemon(SOUTH) as south:
                has(south, 2 * third)
                publisher.publish(*EVENTS[2 * third :])
                assert publisher.wait_stored(WAIT_SECONDS)
            assert publisher.dropped == 0
    assert city.stored(NORTH) == city.stored(SOUTH) == once(EVENTS)


@pytest.mark.parametrize("loses_state", [False, True])
def test_a_site_that_begins_anew_repeats_nothing_in_another(loses_state: bool, city: City) -> None:
    before = EVENTS[:20]
    after = [Event("a", "entry", NOW + n) for n in range(1, 20)]  # or the reset refuses them
    with city.daemon(NORTH), city.publisher() as publisher:
        with city.daemon(SOUTH) as south:
            publisher.publish(*before)
            assert publisher.wait_stored(WAIT_SECONDS)
            if not loses_state:
                epoch = south.epoch
                with dial(city.config.at(SOUTH)) as bus:
                    assert bus.query("admin/reset", one=True)
                wait_for(lambda: south.epoch > epoch, "the reset")
        if loses_state:
            shutil.rmtree(city.folder / SOUTH)
        with city.daemon(SOUTH) as south:
            if loses_state:
                has(south, len(before))
            publisher.publish(*after)
            assert publisher.wait_stored(WAIT_SECONDS)
            has(south, len(after))
    assert city.stored(NORTH) == city.stored(SOUTH) == once([*before, *after])


def test_what_is_dropped_is_counted_for_the_site_that_was_away(city: City) -> None:
    number = 400
    events = [Event("a", "entry", T0 + n) for n in range(number)]
    with city.daemon(NORTH) as north, city.publisher(spool_events_max=100) as publisher:
        for start in range(0, number, 40):
            publisher.publish(*events[start : start + 40])
            has(north, start + 40)
        dropped = publisher.dropped
        assert 0 < dropped == number - publisher.waiting
        with city.daemon(SOUTH):
            assert publisher.wait_stored(WAIT_SECONDS)
    assert city.stored(NORTH) == once(events)
    assert city.stored(SOUTH) == once(events[dropped:])


def test_sites_whose_place_is_not_known_are_refused(city: City) -> None:
    for sites in ((SOUTH, NORTH), (NORTH, "west")):
        with pytest.raises(ValueError, match="the first one has to be site north"):
            Publisher("a", config=city.config, sites=sites)
