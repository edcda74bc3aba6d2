"""Forgotten and renamed cameras, and how their events are treated.

An event of a forgotten name, or one from before a reset, becomes an entry "refused": it is
acknowledged, so that its spool empties, and not learned. An event under the old name of a renamed
camera counts for the new name, and is acknowledged under the old one. Once the camera sends under
the new name itself, the old name is forgotten, as two programs must not publish one camera; what
the old name has of the time before still counts.

The state follows from the commands in the journal. It is stored with each command that changes it,
in the same transaction, and made again from them if that is damaged.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Set

from msgspec import Struct
from msgspec.structs import replace

from camtopod import codec
from camtopod.admin import Command, Forget, Rename, Reset, Rewind, TakeBack
from camtopod.learn.settings import TopologySettings
from camtopod.records import Event, NamesStatus
from camtopod.serve.ingest.received import Received, command_received
from camtopod.serve.storage import NAMES_KEY, Journal, read_command

log = logging.getLogger(__name__)

LISTED_MAX = 20
"""Most names that a sentence lists."""


class CommandRefused(ValueError):
    """A command is refused; ``str()`` gives the reason and the remedy."""


class NamesState(Struct, frozen=True):
    """The stored effect of all commands so far.

    forgotten: refused names, each with the time (Unix seconds) since which it is.
    aliases: old names of renamed cameras -> their present names.
    ended: of forgotten names that were aliases, the camera, and the time (Unix seconds) before
        which an event still counts for it.
    shared: names that were taken back after they had ended, so that earlier events under them are
        another camera's.
    since (Unix seconds): when the site was reset; None if it never was.
    erased: names that were ever forgotten, but for those with events of a renamed camera, each with
        the number of the entry up to which nothing is kept of it: that of the command.
    """

    forgotten: dict[str, float] = {}
    aliases: dict[str, str] = {}
    ended: dict[str, tuple[str, float]] = {}
    since: float | None = None
    shared: tuple[str, ...] = ()
    erased: dict[str, int] = {}


def read_names(journal: Journal) -> NamesState:
    """Return the state as it is stored in the journal, or made again from its commands."""
    if (content := journal.meta(NAMES_KEY)) is not None:
        return codec.read(NamesState, content.encode())
    state = NamesState()
    for number, t, entry in journal.commands():
        try:
            command = read_command(entry.raw)
            camera = getattr(command, "camera", getattr(command, "old", ""))
            state, _ = carried_out(state, command, {camera}, t, number)
        except (codec.Rejected, CommandRefused) as error:
            log.error("a command in the journal is left out: %s", error)
    return state


def present_names(state: NamesState) -> dict[str, str]:
    """Return the names that are no camera's any more -> the camera's present one, "" for none."""
    ended = {old: name for old, (name, _) in state.ended.items()}
    return dict.fromkeys(state.forgotten, "") | ended | state.aliases


def missing_names(
    declarations: TopologySettings, state: NamesState, cameras: Iterable[str]
) -> list[str]:
    """Return a warning of declared names that no camera has, a sentence; else none.

    cameras: those that are there, by any of their names. Forgotten names are not warned of.
    """
    names = present_names(state)
    camera_names = {names.get(name, name) for name in cameras} | {""}
    pairs = (*declarations.neighbours, *declarations.not_neighbours)
    orphans = {name for pair in pairs for name in pair if names.get(name, name) not in camera_names}
    if not orphans:
        return []
    return [f"[topology] names cameras that are not there: {listed(orphans)}"]


def carried_out(
    state: NamesState, command: Command, cameras: Set[str], now: float, number: int
) -> tuple[NamesState, str]:
    """Return the state after a command, and its effect, as a sentence for the operator.

    cameras: those that have ever sent anything.
    now: Unix seconds.
    number: that of the command's entry in the journal.

    Raises `CommandRefused`.
    """
    # The names that are in force may be newer.
    camera_names = {state.aliases.get(name, name) for name in {*cameras, *state.aliases}}
    camera_names -= state.forgotten.keys()
    match command:
        case Forget(camera):
            return _forget(state, command, camera_names, now, number)
        case TakeBack(camera):
            return _take_back(state, camera)
        case Rename(old, new):
            return _rename(state, old, new, camera_names)
        case Reset(t):
            return (
                NamesState(since=t, erased=state.erased),
                f"the site begins anew, in epoch {command.epoch}: no camera is known, no name is"
                " forgotten, and events from before this moment are not learned",
            )
        case Rewind():
            return state, "what was learned of later events is dropped"


def _forget(
    state: NamesState, command: Forget, camera_names: Set[str], now: float, number: int
) -> tuple[NamesState, str]:
    camera, until = command.camera, command.until
    _require(camera, camera_names | state.aliases.keys())

    # Forget its old names, too: events under them would count for it.
    names = [camera, *(old for old, new in state.aliases.items() if new == camera)]
    names += [old for old, (name, _) in state.ended.items() if name == camera]
    forgotten = dict.fromkeys(names, now) | state.forgotten
    aliases = {old: new for old, new in state.aliases.items() if old not in names}
    ended = {old: end for old, end in state.ended.items() if old not in names}
    erased = state.erased
    if until is not None and camera in state.aliases:
        ended[camera] = (state.aliases[camera], until)
    else:
        own = [name for name in names if state.aliases.get(name, camera) == camera]
        erased = erased | {name: number for name in own if name not in state.shared}
    return (
        replace(state, forgotten=forgotten, aliases=aliases, ended=ended, erased=erased),
        f"{camera} is forgotten: the next version is without it, and its events, also under an"
        f" older name, are refused until `camtopod forget --take-back {camera}`",
    )


def _take_back(state: NamesState, camera: str) -> tuple[NamesState, str]:
    if camera not in state.forgotten:
        raise CommandRefused(
            f"{camera} is not forgotten; forgotten names: {listed(state.forgotten)}"
        )
    forgotten = {name: since for name, since in state.forgotten.items() if name != camera}
    ended = {name: end for name, end in state.ended.items() if name != camera}
    shared = (*state.shared, camera) if camera in state.ended else state.shared
    return (
        replace(state, forgotten=forgotten, ended=ended, shared=shared),
        f"events of {camera} are accepted again, as of a new camera",
    )


def _rename(
    state: NamesState, old: str, new: str, camera_names: Set[str]
) -> tuple[NamesState, str]:
    if old == new:
        raise CommandRefused(f"{old} has this name already")
    _require(old, camera_names)

    # The new name must be free; a camera may get back a name that it had.
    if new in camera_names or state.aliases.get(new, old) != old:
        raise CommandRefused(
            f"there is a camera {new} already; if what was learned of it may go, `camtopod forget"
            f" {new}` first, and then rename"
        )

    aliases = {name: new if now == old else now for name, now in state.aliases.items()} | {old: new}
    aliases.pop(new, None)
    forgotten = {name: since for name, since in state.forgotten.items() if name != new}
    ended = {
        name: (new if now == old else now, until)
        for name, (now, until) in state.ended.items()
        if name != new
    }
    return (
        replace(state, forgotten=forgotten, aliases=aliases, ended=ended),
        f"{old} goes on as {new}: events that still come as {old} count for {new} until {new} sends"
        f" its own; what {old} sends of a later time is refused",
    )


def _require(camera: str, camera_names: Set[str]) -> None:
    """Raise `CommandRefused` if there is no such camera."""
    if camera not in camera_names:
        raise CommandRefused(f"there is no camera {camera}; there are: {listed(camera_names)}")


def listed(names: Iterable[str]) -> str:
    """Return the first names, in words."""
    order = sorted(names)
    remainder = f" and {len(order) - LISTED_MAX} more" * (len(order) > LISTED_MAX)
    return ", ".join(order[:LISTED_MAX]) + remainder or "none"


class Names:
    """The names in force. One thread at a time calls `prepare` and `apply`.

    state: as it was stored.
    clock: returns Unix seconds.
    """

    def __init__(self, state: NamesState, clock: Callable[[], float]) -> None:
        self.state = state
        self._clock = clock
        self.refusals: Counter[str] = Counter()
        """Events refused since the start, by forgotten name; "" for those before the reset."""

    def prepare(
        self, command: Command, cameras: Set[str], number: int
    ) -> tuple[NamesState, Received, str]:
        """Return the state after a command, its entry, and its effect in words.

        Raises `CommandRefused`.

        cameras, number: see `carried_out`.
        """
        state, effect = carried_out(self.state, command, cameras, self._clock(), number)
        return state, command_received(command, {NAMES_KEY: codec.to_json(state).decode()}), effect

    def apply(self, item: Received) -> list[Received]:
        """Return the entries to store for one: renamed or refused, if its camera is.

        There is none for a refused event without a number. Before the first event under a new name
        comes the entry by which the old name is forgotten.
        """
        event = item.event
        if event is None:  # from the future, or invalid
            is_forgotten = item.entry.camera in self.state.forgotten
            return [item.only_number() if is_forgotten else item]
        present_event = self.renamed(event)
        if present_event is None:
            return self._refuse(item, event)
        if present_event is not event:
            entry = replace(item.entry, raw=codec.to_msgpack(present_event))
            return [replace(item, entry=entry, event=present_event)]
        if event.camera in self.state.aliases.values():
            return [*self._end_aliases(event), item]
        return [item]

    def renamed(self, event: Event) -> Event | None:
        """Return an event under its camera's present name; None if it is refused."""
        state = self.state
        if self._is_before_reset(event):
            return None
        name = state.aliases.get(event.camera)
        if event.camera in state.forgotten:
            name, until = state.ended.get(event.camera, (None, 0.0))
            if name is None or event.t >= until:
                return None
        return event if name is None else replace(event, camera=name)

    def present(self, names: Iterable[str]) -> set[str]:
        """Return the present names of cameras, without forgotten ones. Any thread."""
        state = self.state
        return {state.aliases.get(name, name) for name in names} - state.forgotten.keys()

    def status(self) -> NamesStatus:
        """Return the part of the daemon's status about names. Any thread."""
        refusals = self.refusals.copy()
        return NamesStatus(
            forgotten={name: refusals[name] for name in sorted(self.state.forgotten)},
            renamed=dict(sorted(self.state.aliases.items())),
            reset=self.state.since,
            before_reset=refusals[""],
        )

    def _is_before_reset(self, event: Event) -> bool:
        """Return True if an event is from before the reset."""
        return self.state.since is not None and event.t < self.state.since

    def _refuse(self, item: Received, event: Event) -> list[Received]:
        """Count a refused event, and return its entry."""
        name = "" if self._is_before_reset(event) else event.camera
        self.refusals[name] += 1
        if self.refusals[name] == 1:
            remark = "from before the reset are refused"
            if name:
                remark = f"of {name} are refused, as this name is forgotten"
            log.warning("events %s", remark)
        return [] if item.entry.seq is None else [item.only_number()]

    def _end_aliases(self, first: Event) -> list[Received]:
        """Forget the old names of a camera that sends its ``first`` event under its new name."""
        items = []
        for old in [alias for alias, name in self.state.aliases.items() if name == first.camera]:
            log.info("%s sends under its new name: %s has ended", first.camera, old)
            self.state, item, _ = self.prepare(Forget(old, first.t), {old}, 0)  # erases nothing
            items.append(item)
        return items
