"""The versions of the topology: stored, then published, and given to programs that ask for one."""

from __future__ import annotations

import logging
import re
import sqlite3
from collections.abc import Callable, Mapping

from msgspec.structs import replace

from camtopod import codec
from camtopod.records import Topology, VersionModel
from camtopod.serve.bus import Bus, QueryError
from camtopod.serve.learner_process import LearnProgress, NewVersion, newest_topology
from camtopod.serve.live_predictions import Live, Reader
from camtopod.serve.storage import Journal, Learned, Snapshot, StateError
from camtopod.topology import (
    links_between_views,
    map_of,
    range_in_words,
    version_model,
    waiting_for_links,
)
from camtopod.words import counted

log = logging.getLogger(__name__)

PARTS: dict[str, Callable[[Topology], Topology | VersionModel | None]] = {
    "topology/model": version_model,
    "topology": map_of,
}
"""Part of a version, by the key of the bus, in the order in which they are published."""

SINCE_KEY = "versions since"
"""Key in the journal's ``meta`` of the first versions after cameras were forgotten."""


def schema_of(key: str) -> str:
    """Return the name of the type of the messages on a key."""
    return key.replace("/", "-")


class Versions:
    """The newest version, which predictions are made from, and those in the journal.

    walks: whether matches are told.
    """

    def __init__(self, bus: Bus, journal: Journal, live: Live, walks: bool) -> None:
        self._bus = bus
        self._journal = journal
        self._live = live
        self._walks = walks
        self.newest: Topology | None = None
        """Its map."""
        self.erased: Mapping[str, int] = {}
        """Cameras, by the entry of the journal up to which nothing is kept of them."""
        # Camera -> that entry, and epoch and number of the first version that was made after it.
        since = (journal.meta(SINCE_KEY) or "{}").encode()
        self._since = codec.read(dict[str, tuple[int, str, int]], since)
        if (version := newest_topology(journal)) is not None:
            live.use(Reader(version, walks))
            self.newest = map_of(version)

    def answer(self, key: str, parameters: dict[str, str]) -> Topology | VersionModel | None:
        """Return a part of the newest version, or of an older one of the epoch (``version``).

        key: one of `PARTS`.

        Raises `QueryError` if the version is not kept.
        """
        if (newest := self.newest) is None:
            raise QueryError("nothing has been learned yet")
        number = parameters.get("version", str(newest.version))
        epoch = parameters.get("epoch", newest.epoch)
        try:
            if re.fullmatch("[0-9]{1,18}", number):
                content = self._journal.version(epoch, int(number))
                version = None if content is None else codec.read_topology(content)
                if version is not None and self._is_kept(version):
                    return PARTS[key](version)
        except (sqlite3.Error, StateError, codec.Rejected) as error:
            raise QueryError(f"version {number} of epoch {epoch} cannot be read: {error}") from None
        raise QueryError(f"version {number} of epoch {epoch} is not kept")

    def _is_kept(self, version: Topology) -> bool:
        """Return True unless a camera of a version has been forgotten after it was made."""
        key = version.epoch, version.version
        names = {camera.id for camera in version.cameras} & self.erased.keys()
        return all(self._is_past(name) and self._since[name][1:] <= key for name in names)

    def _is_past(self, name: str) -> bool:
        """Return True if a version was made after the entry up to which a camera is erased."""
        return name in self._since and self._since[name][0] == self.erased[name]

    def publish_newest(self) -> None:
        """Publish the newest version again, unless it may not be given."""
        try:
            parts = {key: self.answer(key, {}) for key in PARTS}
        except QueryError as error:
            log.warning("not published again: %s", error)
            return
        for key, part in parts.items():
            self._bus.publish(key, part, schema_of(key))

    def learned(self, progress: LearnProgress, state: bytes) -> Learned:
        """Return what to store of the learner's progress, and to do once it is stored."""
        # Prepare predictions here, as this takes long; others go on meanwhile.
        versions = [(version, _decoded(version)) for version in progress.versions]
        newest = versions[-1] if versions else None
        meta = self._note_first(progress)
        reader = newest and Reader(newest[1], self._walks, newest[0].outside)

        def publish() -> None:
            if reader is not None:
                self._live.use(reader)
            for version, topology in versions:
                self._publish(version, topology)

        return Learned(
            [version.stored for version in progress.versions],
            Snapshot(progress.position, progress.epoch, state),
            publish,
            meta,
        )

    def _note_first(self, progress: LearnProgress) -> dict[str, str]:
        """Note the first versions since cameras were erased; return the rows of `meta` for it."""
        if not (self.erased and progress.versions):
            return {}
        first = progress.versions[0].stored
        self._since = {
            name: self._since[name] if self._is_past(name) else (number, first.epoch, first.version)
            for name, number in self.erased.items()
            if number <= progress.position
        }
        return {SINCE_KEY: codec.to_json(self._since).decode()}

    def _publish(self, version: NewVersion, topology: Topology) -> None:
        """Publish a version that is stored, with its delta, and log its alarms."""
        self.newest = map_of(topology)
        parts = {"topology/model": version.model, "topology": version.map}
        for key, message in {**parts, "topology/delta": version.delta}.items():
            if message is not None:
                self._bus.publish_raw(key, message, schema_of(key))

        # Log the new alarms and the version.
        for alarm in topology.alarms or []:
            if alarm.version == topology.version:
                log.warning("%s", alarm)
        links = len(links_between_views(topology))
        log.info(
            "version %d: %s, %s, %s between views; looked for %s",
            topology.version,
            counted(len(topology.cameras), "camera"),
            counted(len(topology.zones), "zone"),
            counted(links, "link"),
            range_in_words(topology),
        )
        if not links:
            log.info("%s", waiting_for_links(topology))


def _decoded(version: NewVersion) -> Topology:
    """Return a version of its two parts."""
    model = codec.read(VersionModel, version.model, pack=True).model
    return replace(codec.read(Topology, version.map, pack=True), model=model)
