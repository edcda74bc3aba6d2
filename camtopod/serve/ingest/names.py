"""Forgotten and renamed cameras, and how their events are treated.

An event of a forgotten name, or one from before a reset, becomes an entry "refused": it is
acknowledged, so that its spool empties, and not learned. An event under the old name of a renamed
camera counts for the new name, and is acknowledged under the old one. Once the camera sends under
the new name itself, the old name is forgotten, as two programs must not publish one camera.

The state is stored with each command that changes it, in the same transaction.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterable
from typing import NamedTuple

import msgspec
from msgspec import Struct
from msgspec.structs import replace

from camtopod import codec
from camtopod.admin import Command, Forget, Rename, Reset, TakeBack
from camtopod.records import NamesStatus, Topology
from camtopod.serve.ingest.received import Received
from camtopod.serve.storage import Entry, command_entry, reset_entry

log = logging.getLogger(__name__)

NAMES_MAX = 1_000
"""Most forgotten and old names of a site."""
LISTED_MAX = 20
"""Most names that a sentence lists."""


class CommandRefused(ValueError):
    """A command is refused; ``str()`` gives the reason and the remedy."""


class NamesState(Struct, frozen=True):
    """The stored effect of all commands so far.

    forgotten: refused names, each with the time (Unix seconds) since which it is.
    aliases: old names of renamed cameras -> their present names.
    since (Unix seconds): when the site was reset; None if it never was.
    """

    forgotten: dict[str, float] = {}
    aliases: dict[str, str] = {}
    since: float | None = None


class KnownSite(NamedTuple):
    """Cameras of a site when a command arrives.

    cameras: of which something was learned or received.
    heard: that have ever sent anything.
    """

    cameras: set[str]
    heard: set[str]


def known_site(
    topology: Topology | None,
    received: Iterable[str],
    heard: Iterable[str],
    since: float | None,
) -> KnownSite:
    """Return the known site from the newest topology and the cameras of received events.

    since (Unix seconds): when the site was reset; an earlier topology does not count.
    """
    if topology is None or (since is not None and topology.as_of < since):
        return KnownSite(set(received), set(heard))
    return KnownSite({*received, *(camera.id for camera in topology.cameras)}, set(heard))


def read_names(stored: str | None) -> NamesState:
    """Return the state as it was stored in the journal. Raises `codec.Rejected`."""
    return NamesState() if stored is None else codec.read(NamesState, stored.encode())


def carried_out(
    state: NamesState, command: Command, site: KnownSite, now: float
) -> tuple[NamesState, str]:
    """Return the state after a command, and its effect, as a sentence for the operator.

    now: Unix seconds.

    Raises `CommandRefused`.
    """
    site = _present(site, state)
    match command:
        case Forget(camera):
            return _forget(state, camera, site, now)
        case TakeBack(camera):
            return _take_back(state, camera)
        case Rename(old, new):
            return _rename(state, old, new, site)
        case Reset():
            return (
                NamesState(since=command.t),
                f"the site begins anew, in epoch {command.epoch}: no camera is known, no name is"
                " forgotten, and events from before this moment are not learned",
            )


def _present(site: KnownSite, state: NamesState) -> KnownSite:
    """Return the known site with the names in force, which may be newer."""
    cameras = {state.aliases.get(camera, camera) for camera in {*site.cameras, *state.aliases}}
    return site._replace(cameras=cameras - state.forgotten.keys())


def _forget(state: NamesState, camera: str, site: KnownSite, now: float) -> tuple[NamesState, str]:
    if camera not in site.cameras | site.heard | state.aliases.keys():
        raise CommandRefused(f"there is no camera {camera}; {_there(site)}")
    forgotten, aliases = dict(state.forgotten), dict(state.aliases)

    # Forget its old names, too: events under them would count for it.
    names = [camera, *(old for old, new in state.aliases.items() if new == camera)]
    for name in names:
        forgotten.setdefault(name, now)
        aliases.pop(name, None)
    _check_room(forgotten, aliases)
    return (
        replace(state, forgotten=forgotten, aliases=aliases),
        f"{' and '.join(names)} {'is' if len(names) == 1 else 'are'} forgotten: the next version is"
        " without it, and events under this name are refused until"
        f" `camtopod forget --take-back {camera}`",
    )


def _take_back(state: NamesState, camera: str) -> tuple[NamesState, str]:
    if camera not in state.forgotten:
        names = _listed(state.forgotten) if state.forgotten else "none"
        raise CommandRefused(f"{camera} is not forgotten; forgotten names: {names}")
    forgotten = {name: since for name, since in state.forgotten.items() if name != camera}
    return (
        replace(state, forgotten=forgotten),
        f"events of {camera} are accepted again, as of a new camera",
    )


def _rename(state: NamesState, old: str, new: str, site: KnownSite) -> tuple[NamesState, str]:
    # The old name must be of a camera.
    if old == new:
        raise CommandRefused(f"{old} has this name already")
    if old in state.aliases:
        raise CommandRefused(f"{old} was renamed to {state.aliases[old]}: rename that one")
    if old in state.forgotten:
        raise CommandRefused(f"{old} is forgotten: nothing that was learned of it is left")
    if old not in site.cameras | site.heard:
        raise CommandRefused(f"there is no camera {old}; {_there(site)}")

    # The new name must be free; a camera may get back a name that it had.
    if state.aliases.get(new, old) != old:
        raise CommandRefused(f"{new} is the old name of {state.aliases[new]}: forget {new} first")
    if new in site.cameras:
        raise CommandRefused(
            f"there is a camera {new} already; if what was learned of it may go, `camtopod forget"
            f" {new}` first, and then rename"
        )

    aliases = {
        alias: new if name == old else name for alias, name in state.aliases.items() if alias != new
    }
    aliases[old] = new
    forgotten = {name: since for name, since in state.forgotten.items() if name != new}
    _check_room(forgotten, aliases)
    return (
        replace(state, forgotten=forgotten, aliases=aliases),
        f"{old} goes on as {new}: events that still come as {old} count for {new} until {new} sends"
        f" its own; from then on {old} is refused",
    )


def _check_room(forgotten: dict[str, float], aliases: dict[str, str]) -> None:
    if len(forgotten) + len(aliases) > NAMES_MAX:
        raise CommandRefused(
            f"{NAMES_MAX} names are forgotten or renamed, which is the most: take some back with"
            " `camtopod forget --take-back`"
        )


def _there(site: KnownSite) -> str:
    """Return the cameras that there are, in words."""
    return f"there are {_listed(site.cameras)}" if site.cameras else "none is known yet"


def _listed(names: Iterable[str]) -> str:
    ordered = sorted(names)
    more = f" and {len(ordered) - LISTED_MAX} more" if len(ordered) > LISTED_MAX else ""
    return ", ".join(ordered[:LISTED_MAX]) + more


def entry_of(command: Command) -> Entry:
    """Return the journal's entry for a command."""
    return reset_entry(command) if isinstance(command, Reset) else command_entry(command)


class Names:
    """The names in force. One thread at a time calls `carry_out` and `apply`.

    state: as it was stored.
    clock: returns Unix seconds.
    """

    def __init__(self, state: NamesState, clock: Callable[[], float]) -> None:
        self.state, self._clock = state, clock
        self.refused: Counter[str] = Counter()
        """Events refused since the start, by forgotten name; "" for those before the reset."""

    def carry_out(self, command: Command, site: KnownSite) -> tuple[Received, str]:
        """Execute a command; return its entry and its effect, in words. Raises `CommandRefused`."""
        self.state, said = carried_out(self.state, command, site, self._clock())
        stored = codec.to_json(self.state).decode()
        return Received(entry_of(command), command=command, names=stored), said

    def apply(self, received: Received) -> list[Received]:
        """Return the entries to store for one: renamed or refused, if its camera is.

        There is none for a refused event without a number. Before the first event under a new name
        comes the entry by which the old name is forgotten.
        """
        event, state = received.event, self.state
        if event is None:
            return [received]
        if event.camera in state.forgotten:
            return self._refuse(received, event.camera)
        if state.since is not None and event.t < state.since:
            return self._refuse(received, "")
        if (name := state.aliases.get(event.camera)) is not None:
            event = replace(event, camera=name)
            entry = msgspec.structs.replace(received.entry, raw=codec.to_msgpack(event))
            return [replace(received, entry=entry, event=event)]
        if event.camera in state.aliases.values():
            return [*self._end_aliases(event.camera), received]
        return [received]

    def status(self) -> NamesStatus:
        """Return the part of the daemon's status about names. Any thread."""
        refused = self.refused.copy()
        return NamesStatus(
            forgotten={name: refused[name] for name in sorted(self.state.forgotten)},
            renamed=dict(sorted(self.state.aliases.items())),
            reset=self.state.since,
            before_reset=refused[""],
        )

    def _refuse(self, received: Received, name: str) -> list[Received]:
        """Count a refused event, and return its entry, which has only its number."""
        self.refused[name] += 1
        if self.refused[name] == 1:
            log.warning(
                "%s",
                f"events of {name} are refused, as this name is forgotten: `camtopod forget"
                f" --take-back {name}` accepts them again"
                if name
                else "events from before the reset are refused",
            )
        entry = received.entry
        if entry.seq is None:
            return []
        return [Received(Entry("refused", entry.camera, entry.boot, entry.seq, b""))]

    def _end_aliases(self, camera: str) -> list[Received]:
        """Forget the old names of a camera that sends under its new name now."""
        made = []
        for old in [alias for alias, name in self.state.aliases.items() if name == camera]:
            log.info("%s sends under its new name: %s is refused from now on", camera, old)
            made.append(self.carry_out(Forget(old), KnownSite({old}, set()))[0])
        return made
