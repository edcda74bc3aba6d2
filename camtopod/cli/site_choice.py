"""The site of a program without --site: readers take the only site on the bus."""

from __future__ import annotations

import argparse
import logging

from msgspec.structs import replace

from camtopod.config import Config, SiteSettings
from camtopod.serve.bus import Bus, dial, in_words, sites_instead, take_only_site

log = logging.getLogger(__name__)


def dial_as_reader(args: argparse.Namespace, config: Config) -> tuple[Bus, Config]:
    """Open the session of a program that only reads; return it with the configuration to use.

    If no site was given, and the bus has the daemon of one other site only, that site is taken, and
    the log says so. Raises `BusError`.
    """
    bus = dial(config)
    other_sites = sites_instead(bus, config)
    if args.site is None and take_only_site(bus, config, other_sites):
        log.info("site %s, the only one on this bus; no --site is given", bus.site)
        return bus, replace(config, site=SiteSettings(bus.site))
    if other_sites:
        log.warning("no daemon of site %s is there%s", bus.site, _named(other_sites))
    return bus, config


def right_site(bus: Bus, config: Config) -> str:
    """Return the end of the message that a site has no daemon: the sites that have one, or ""."""
    return _named(sites_instead(bus, config))


def _named(sites: list[str]) -> str:
    return in_words(sites) + (f": add --site {sites[0]}" if sites else "")
