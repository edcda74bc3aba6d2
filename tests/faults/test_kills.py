"""kill -9 of the real daemon, of publishers and of the router while events flow."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import traffic
from site_of import Site, kill_and_restart
from sizes import size

EVERYBODY = ("router", "daemon", *traffic.CAMERAS)
MakeSite = Callable[..., Site]


@pytest.fixture
def make_site(tmp_path: Path) -> Iterator[MakeSite]:
    made: list[Site] = []

    def make(*given: float, **more: bool) -> Site:
        made.append(Site(tmp_path, *given, **more))  # type: ignore[arg-type]
        return made[-1]

    yield make
    for site in made:
        site.close()


def check(site: Site) -> None:
    """Everything is there once, and the versions are those of a learner that was never killed."""
    status = site.finish()
    assert status["learner"]["late"] == 0, "else the order of arrival would matter"
    assert site.lost_and_doubled() == (0, 0)
    expected = site.expected()
    assert status["version"] == max(expected)
    epochs = {epoch for epoch, _ in site.versions}
    assert len(epochs) == 1
    assert site.newest == sorted(site.newest), "versions only go up"
    for (_, version), digest in site.versions.items():
        assert expected[version] == digest
    assert (*epochs, max(expected)) in site.versions


def test_kills(make_site: MakeSite) -> None:
    site = make_site(400, 2 * 3600.0, 1800.0)
    site.start_all()
    killed = kill_and_restart(site, 2, size("SEED", 3), ("daemon", "router"), print)
    assert killed.total() == 2
    check(site)


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_many_kills(make_site: MakeSite) -> None:
    kills = size("KILLS", 60)
    speed = 160.0
    site = make_site(int(40 * 6 * kills), 6 * kills * speed, speed)
    began = time.monotonic()
    site.start_all()
    killed = kill_and_restart(site, kills, size("SEED", 1), EVERYBODY, print)
    check(site)
    print(f"{killed}, {len(site.events)} events, {len(site.versions)} versions, {time.monotonic() - began:.0f} s")


def test_the_harness_sees_a_loss(make_site: MakeSite) -> None:
    """The canary: publishers that just put lose what is under way when the daemon is killed."""
    site = make_site(400, 1800.0, 600.0, spools=False)
    site.start_all()
    kill_and_restart(site, 1, 1, ("daemon",), print)
    site.finish()
    lost, doubled = site.lost_and_doubled()
    assert lost > 0
    assert doubled == 0
