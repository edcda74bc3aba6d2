"""A reader of versions has the map and the model of one version, whatever comes between them."""

from __future__ import annotations

from typing import Any, cast

from fake_bus import OneBus
from synthetic_topology import synthetic_topology

from camtopod.serve.bus import Bus, TopologySubscriber


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
