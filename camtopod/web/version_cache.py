"""Cache of older versions, queried from the daemon one at a time."""

from __future__ import annotations

import threading
from collections import OrderedDict

from camtopod import codec
from camtopod.records import Topology
from camtopod.serve.bus import Bus, QueryError
from camtopod.web.version_diff import Summary, summary

WHOLE_MAX = 4
"""Older topologies that are kept."""
SUMMARIES_MAX = 1_000
"""Summaries that are kept."""


class VersionCache:
    """Older versions of a site. Thread-safe; queries to the daemon are made one after the other."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._asking = threading.Lock()
        self._mutex = threading.Lock()
        self._whole: OrderedDict[tuple[str, int], Topology] = OrderedDict()
        self._summaries: OrderedDict[tuple[str, int], Summary] = OrderedDict()

    def summaries(self, newest: Topology) -> list[Summary]:
        """Return the known summaries of the newest version's epoch, oldest first."""
        self._note(newest)
        with self._mutex:
            return [
                self._summaries[key] for key in sorted(self._summaries) if key[0] == newest.epoch
            ]

    def summary(self, newest: Topology, version: int) -> Summary | None:
        """Return the summary of a version; None if the daemon does not keep it."""
        with self._mutex:
            known = self._summaries.get((newest.epoch, version))
        if known is not None:
            return known
        found = self.version(newest, version)
        return None if found is None else summary(found)

    def version(self, newest: Topology, version: int) -> Topology | None:
        """Return an older version of the epoch of ``newest``; None if it is not available."""
        if version == newest.version:
            return newest

        # From the cache, or from the daemon.
        key = (newest.epoch, version)
        with self._asking:
            with self._mutex:
                if (held := self._whole.get(key)) is not None:
                    self._whole.move_to_end(key)
                    return held
            found = self._ask(key)

        # Keep it.
        if found is not None:
            self._note(found)
            with self._mutex:
                self._whole[key] = found
                while len(self._whole) > WHOLE_MAX:
                    self._whole.popitem(last=False)
        return found

    def _ask(self, key: tuple[str, int]) -> Topology | None:
        """Query the daemon for a version; None if there is no valid answer."""
        try:
            answers = self._bus.query("topology", {"epoch": key[0], "version": key[1]}, one=True)
        except QueryError:
            return None
        try:
            found = codec.decode_topology(answers[0][1], pack=True) if answers else None
        except codec.Rejected:
            return None
        return found if found is not None and (found.epoch, found.version) == key else None

    def _note(self, topology: Topology) -> None:
        """Keep the summary of a version."""
        with self._mutex:
            self._summaries[topology.epoch, topology.version] = summary(topology)
            while len(self._summaries) > SUMMARIES_MAX:
                self._summaries.popitem(last=False)
