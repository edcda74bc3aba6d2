"""A reader of versions has the map and the model of one version, whatever comes between them."""

from __future__ import annotations

from typing import Any, cast

import pytest
from fake_bus import OneBus
from synthetic_topology import synthetic_topology

from camtopod.serve.bus import Bus, TopologySubscriber, topology_subscriber


class Busy(OneBus):
    """The daemon publishes a version between the answers to any two queries."""

    def query(
        self, key: str, parameters: dict[str, Any] | None = None, one: bool = False
    ) -> list[tuple[str, bytes]]:
        answers = super().query(key, parameters, one)
        version = max(self.kept) + 1
        self.kept[version] = synthetic_topology(3, version=version)
        return answers


def test_a_version_that_comes_between_two_queries_is_no_others_map() -> None:
    bus = Busy()
    bus.kept = {1: synthetic_topology(3)}
    subscriber = TopologySubscriber(cast(Bus, bus))
    topology = subscriber.update()
    assert topology is not None
    assert (topology.version, topology.model is not None) == (1, True)


class Joining(OneBus):
    """For its first queries the bus does not know yet who answers."""

    def query(
        self, key: str, parameters: dict[str, Any] | None = None, one: bool = False
    ) -> list[tuple[str, bytes]]:
        answers = super().query(key, parameters, one)
        return [] if len(self.asked) in (2, 3, 4) else answers


def test_who_has_just_joined_asks_until_the_daemon_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(topology_subscriber, "QUERY_INTERVAL_SECONDS", 0.0)
    bus = Joining()
    bus.kept = {1: synthetic_topology(3)}
    topology = TopologySubscriber(cast(Bus, bus)).first(60.0)
    assert topology is not None
    assert topology.version == 1
    assert len(bus.asked) == 6


def test_a_daemon_that_has_learned_nothing_is_asked_once() -> None:
    bus = OneBus()
    assert TopologySubscriber(cast(Bus, bus)).first(60.0) is None
    assert len(bus.asked) == 1


class Losing(OneBus):
    """The answer to the query number ``lost`` does not come in time."""

    lost = 0

    def query(
        self, key: str, parameters: dict[str, Any] | None = None, one: bool = False
    ) -> list[tuple[str, bytes]]:
        answers = super().query(key, parameters, one)
        return [] if len(self.asked) == self.lost else answers


@pytest.mark.parametrize("lost", [3, 4])
@pytest.mark.parametrize("is_kept", [True, False])
def test_a_newer_version_is_asked_for_until_it_is_there(
    is_kept: bool, lost: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(topology_subscriber, "QUERY_INTERVAL_SECONDS", 0.0)
    bus = Losing()
    bus.lost = lost
    bus.kept = {1: synthetic_topology(3)}
    subscriber = TopologySubscriber(cast(Bus, bus))
    assert subscriber.update() is not None

    bus.kept[2] = synthetic_topology(3, version=2)
    if not is_kept:
        del bus.kept[1]
    subscriber._on_daemon("daemon", True)

    versions = [subscriber.update() for _ in range(2)]
    assert [version and version.version for version in versions] == [None, 2]
