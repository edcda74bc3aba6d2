"""The site of a program that only reads: without --site the only one on the bus; or several."""

from __future__ import annotations

import argparse
import logging
from pathlib import Path

from msgspec.structs import replace

from camtopod.cli.common import districts_of, with_options
from camtopod.config import Config, SiteSettings, owners_of
from camtopod.serve.bus import Bus, dial, in_words, sites_instead, take_only_site
from camtopod.serve.city_bus import CityBus

log = logging.getLogger(__name__)


def add_districts(parser: argparse.ArgumentParser) -> None:
    """Add the option that says who owns the cameras of several sites."""
    parser.add_argument(
        "--districts",
        metavar="FILE",
        type=Path,
        help="with several --site: the districts that own the cameras, as camtopod districts "
        "writes them (default: a camera is of the first --site that has it)",
    )


def dial_sites(args: argparse.Namespace, config: Config) -> tuple[Bus | CityBus, Config]:
    """Open the session of a program that shows one site, or several as one; as `dial_as_reader`.

    Of several sites none has to be there; the others are shown meanwhile. Raises `CommandError`.
    """
    if len(args.sites) < 2:
        return dial_as_reader(args, config)
    owners = owners_of(districts_of(args.districts)) if args.districts is not None else {}
    configs = {
        site: with_options(argparse.Namespace(site=site, connect=args.connect), config)
        for site in args.sites
    }
    return CityBus(configs, owners), config


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
