"""A second daemon of a site, as the first one says it."""

from __future__ import annotations

from typing import cast

from fake_bus import OneBus

from camtopod.serve.bus import Bus, OtherDaemons


class Leaving(set[str]):
    """Names of daemons that end when somebody looks whether there are any."""

    def __bool__(self) -> bool:
        there = len(self) > 0
        self.clear()
        return there


def test_a_daemon_that_ends_while_it_is_looked_for_is_no_other_daemon() -> None:
    daemons = OtherDaemons(cast(Bus, OneBus()), "this")
    daemons._rivals = Leaving(["that"])
    assert daemons.reason in ("", "another daemon (that) serves the same site: stop one of them")
