"""The site of a program for which none was named: readers take the only one on the bus."""

from __future__ import annotations

import logging

from camtopod.config import Config, SiteSettings
from camtopod.serve.bus.session import Bus

log = logging.getLogger(__name__)


def sites_instead(bus: Bus, config: Config) -> list[str]:
    """Return the sites that have a daemon on the bus if that of ``bus`` has none."""
    if config.bus.tls.ca:  # a certificate is of one site and may not see others
        return []
    sites = bus.list_sites()
    return [] if bus.site in sites else sites


def in_words(sites: list[str]) -> str:
    """Return the sites that have a daemon, as the end of a message that one has none."""
    return f"; there is a daemon of site {' and of site '.join(sites)}" if sites else ""


def log_other_sites(bus: Bus, sites: list[str]) -> None:
    """Log that the site of ``bus`` has no daemon, if other sites have one."""
    if sites:
        log.warning("no daemon of site %s is there%s", bus.site, in_words(sites))


def take_only_site(bus: Bus, config: Config, sites: list[str]) -> bool:
    """Make ``bus`` one of the only site that has a daemon, if the configuration names no site.

    sites: result of `sites_instead`.

    Return True if the site of ``bus`` is another one now. Only programs that read may do so.
    """
    if len(sites) != 1 or config.site != SiteSettings():
        return False
    [bus.site] = sites
    return True
