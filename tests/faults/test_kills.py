"""kill -9 of the real daemon, its learner, publishers and the router while events flow.

The quick form is in test_links_cut.py, where one site is used for all faults.
"""

from __future__ import annotations

import time

import pytest
import traffic
from site_of import LEARNER, MakeSite, check, kill_and_restart
from sizes import size

EVERYBODY = (("router",), ("daemon",), (LEARNER,), traffic.CAMERAS)


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_many_kills(make_site: MakeSite) -> None:
    kills = size("KILLS", 60)
    speed = 1000.0
    site = make_site(int(40 * 6 * kills), 6 * kills * speed, speed)
    began = time.monotonic()
    site.start_all()
    killed = kill_and_restart(site, kills, size("SEED", 1), EVERYBODY, print)
    check(site)
    print(
        f"{killed}, {len(site.events)} events, {len(site.versions)} versions, {time.monotonic() - began:.0f} s"
    )


@pytest.mark.campaign
def test_the_harness_sees_a_loss(make_site: MakeSite) -> None:
    """Check of the harness: publishers without spools lose messages in flight when
    the daemon dies.
    """
    site = make_site(400, 1800.0, 600.0, spools=False)
    site.start_all()
    kill_and_restart(site, 1, 1, (("daemon",),), print)
    site.finish()
    lost, doubled = site.lost_and_doubled()
    assert lost > 0
    assert doubled == 0
