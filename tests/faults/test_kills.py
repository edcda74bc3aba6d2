"""kill -9 of the real daemon, its learner, publishers and the router, and links that fail."""

from __future__ import annotations

import time

import pytest
import traffic
from site_of import LEARNER, MakeSite, Site, check, kill_and_restart
from sizes import size

from bench.support.rtsp_streams import FaultProxy

EVENTS_PER_SECOND = 200
EVERYBODY = (("router",), ("daemon",), (LEARNER,), traffic.CAMERAS)


def behind_proxies(site: Site) -> tuple[FaultProxy, FaultProxy]:
    """Connect publishers and daemon to the router through a proxy each."""
    port = int(site.router_endpoint.rsplit(":", 1)[1])
    proxies = FaultProxy(port), FaultProxy(port)
    site.at_publishers, site.at_daemon = (f"tcp/127.0.0.1:{proxy.port}" for proxy in proxies)
    return proxies


def silent(proxy: FaultProxy, seconds: float, cut: bool = False) -> None:
    """Stop all traffic unnoticed; then resume, or close all connections."""
    proxy.stall()
    time.sleep(seconds)
    if cut:
        proxy.cut()
    proxy.resume()


def test_silent_links_and_kills(make_site: MakeSite) -> None:
    site = make_site(200, 2 * 3600.0, 1200.0)
    for_publishers, for_daemon = behind_proxies(site)
    site.start_all()
    site.await_flow()
    silent(for_publishers, 0.7, cut=True)
    silent(for_daemon, 0.7, cut=True)
    for program in ("router", "daemon", LEARNER):
        kill_and_restart(site, 1, 1, ((program,),), print)
    check(site)
    for_publishers.close()
    for_daemon.close()


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_many_kills(make_site: MakeSite) -> None:
    kills = size("KILLS", 30)
    speed = 1000.0
    site = make_site(40 * 8 * kills, 8 * kills * speed, speed)
    began = time.monotonic()
    site.start_all()
    killed = kill_and_restart(site, kills, size("SEED", 1), EVERYBODY, print)
    check(site)
    print(f"{killed}, {len(site.events)} events, {time.monotonic() - began:.0f} s")


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_links_router_and_daemon_fail_in_turn(make_site: MakeSite) -> None:
    seconds, speed = size("SILENT_SECONDS", 15), 2000.0
    lasts = 3.5 * seconds + 110.0
    site = make_site(int(EVENTS_PER_SECOND * lasts / 4), lasts * speed, speed)
    for_publishers, for_daemon = behind_proxies(site)
    began = time.monotonic()
    site.start_all()
    steps = (
        ("links of the publishers silent", lambda: silent(for_publishers, seconds)),
        ("link of the daemon silent", lambda: silent(for_daemon, seconds)),
        ("router restarted", lambda: site.restart("router", 3.0)),
        ("daemon restarted", lambda: site.restart("daemon", 3.0)),
        ("all connections cut", lambda: (for_publishers.cut(), for_daemon.cut())),
    )
    for what, fault in steps:
        time.sleep(3.0)
        site.await_flow()
        fault()
        print(f"{time.monotonic() - began:.0f} s: {what}; {site.status()['events']}")
    assert all(map(site.running, "abc")), "events flowed all the time"
    check(site)
    print(f"{len(site.events)} events, {EVENTS_PER_SECOND}/s, {time.monotonic() - began:.0f} s")
    for_publishers.close()
    for_daemon.close()


@pytest.mark.campaign
def test_the_harness_sees_a_loss(make_site: MakeSite) -> None:
    """The canary: publishers without spools lose messages in flight when the daemon dies."""
    site = make_site(400, 1800.0, 600.0, spools=False)
    site.start_all()
    kill_and_restart(site, 1, 1, (("daemon",),), print)
    site.finish()
    lost, doubled = site.lost_and_doubled()
    assert lost > 0
    assert doubled == 0
