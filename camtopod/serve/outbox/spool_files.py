"""Where the spools of a site are: one for each camera, and one for each process of `ingest`."""

from __future__ import annotations

import logging
import sqlite3
from pathlib import Path

from camtopod.config import Limits
from camtopod.serve.outbox.spool import SitesOf, Spool, owner_alone
from camtopod.serve.runtime import clock
from camtopod.serve.storage import InUse, StateError

log = logging.getLogger(__name__)

_INGEST_SPOOLS_MAX = 100
"""Most spools of `camtopod ingest` of one site, that is of its processes at the same time."""


def spool_path(directory: Path, site: str, name: str) -> Path:
    """Return the path of the spool ``name`` of a site, below the state directory ``directory``."""
    return directory / f"spools-of-{site}" / f"{name}.db"


def open_spool(
    directory: Path, site: str, name: str, limits: Limits, sites_of: SitesOf = owner_alone
) -> Spool:
    """Open the spool of a publishing process, below the state directory. Raises `StateError`.

    sites_of: as for `Spool`.
    """
    return Spool(
        spool_path(directory, site, name),
        clock.ulid(clock.wall()),
        limits.spool_events_max,
        limits.spool_bytes_max,
        sites_of=sites_of,
    )


def open_ingest_spool(
    directory: Path, site: str, limits: Limits, sites_of: SitesOf = owner_alone
) -> Spool:
    """Open a spool for `camtopod ingest`, and move into it those of its processes that have ended.

    Arguments are those of `open_spool`. Raises `StateError`.
    """
    # Take the first one that no other process has.
    names = ("ingest", *(f"ingest@{number}" for number in range(2, _INGEST_SPOOLS_MAX + 1)))
    paths = {name: spool_path(directory, site, name) for name in names}
    for name in names:
        try:
            spool = open_spool(directory, site, name, limits, sites_of)
            break
        except InUse:  # perhaps for a moment, by a process that looks for ended ones
            if name == names[-1]:
                raise

    # Move the others.
    for path in paths.values():
        if path != spool.path and path.exists():
            try:
                spool.adopt(path)
            except InUse:
                continue
            except (StateError, sqlite3.Error) as error:
                log.warning("the events in %s are not published: %s", path, error)
    return spool
