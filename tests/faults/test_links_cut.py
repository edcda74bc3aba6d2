"""Links without traffic, and restarts of router and daemon, while events flow."""

from __future__ import annotations

import time

import pytest
from site_of import LEARNER, MakeSite, Site, check, kill_and_restart
from sizes import size

from bench.support.rtsp_streams import FaultProxy

EVENTS_PER_SECOND = 400


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
    site = make_site(400, 2 * 3600.0, 1200.0)
    for_publishers, for_daemon = behind_proxies(site)
    site.start_all()
    site.await_flow()
    silent(for_publishers, 0.7, cut=True)
    silent(for_daemon, 0.7, cut=True)
    kill_and_restart(site, 1, 1, (("router",),), print)
    kill_and_restart(site, 1, 1, (("daemon",),), print)
    kill_and_restart(site, 1, 1, ((LEARNER,),), print)
    check(site)
    for_publishers.close()
    for_daemon.close()


@pytest.mark.campaign
@pytest.mark.timeout(3600)
def test_links_router_and_daemon_fail_in_turn(make_site: MakeSite) -> None:
    seconds, speed = size("SILENT_SECONDS", 30), 2000.0
    lasts = 3.5 * seconds + 90.0
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
    """Check of the harness: without spools, messages in flight are lost with a link."""
    site = make_site(400, 1800.0, 600.0, spools=False)
    for_publishers, for_daemon = behind_proxies(site)
    site.start_all()
    site.await_flow()
    silent(for_publishers, 1.0, cut=True)
    site.finish()
    lost, doubled = site.lost_and_doubled()
    assert lost > 0
    assert doubled == 0
    for_publishers.close()
    for_daemon.close()
