"""Operators' commands are replayed like events: killed at any moment, the versions are the same."""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest
from msgspec.structs import replace
from test_recovery import EVENTS, SETTINGS, Installation, Start, start

from camtopod.admin import Command, Forget, Rename, Reset, TakeBack
from camtopod.codec import read, to_msgpack
from camtopod.learn.settings import TopologySettings
from camtopod.records import Declared, Topology
from camtopod.serve.ingest import Names, Received, present_names, read_names
from camtopod.serve.ingest.names import NamesState, carried_out
from camtopod.serve.storage import Entry

__all__ = ["start"]

AT = 120
"""Number of events before the command."""
RESET = Reset(EVENTS[AT].t)
COMMANDS = [Forget("b"), Rename("b", "yard"), TakeBack("x"), RESET]


def give(one: Installation, command: Command, learn: bool = True) -> None:
    """Store a command as the daemon does, and learn it."""
    site = set("abcx")
    if isinstance(command, Reset):
        command = Reset(command.t, one.epoch, one.new_epoch())
    names = Names(read_names(one.journal), lambda: 1.0)
    if isinstance(command, TakeBack):
        received = names.prepare(Forget("x"), site, len(one.journal) + 1)[1]
        one.journal.commit([received.entry], meta=received.meta)
    names.state = read_names(one.journal)
    received = names.prepare(command, site, len(one.journal) + 1)[1]
    one.journal.commit([received.entry], meta=received.meta)
    if learn:
        one.run()


def rest(one: Installation) -> None:
    """Learn the other events, as far as the daemon would pass them on."""
    names = Names(read_names(one.journal), lambda: 1.0)
    passed = [
        entry
        for event in EVENTS[AT:]
        for entry in names.apply(
            Received(Entry("event", event.camera, event.boot, event.seq, to_msgpack(event)), event)
        )
    ]
    one.journal.commit([received.entry for received in passed])
    one.run()


def unbroken(directory: Path, command: Command) -> list[tuple[str, int, str]]:
    with contextlib.closing(Installation(directory)) as one:
        one.learn(EVENTS[:AT])
        give(one, command)
        rest(one)
        return one.published


@pytest.mark.parametrize("command", COMMANDS)
def test_killed_after_a_command_the_versions_are_the_same(
    command: Command, start: Start, tmp_path: Path
) -> None:
    expected = unbroken(tmp_path / "unbroken", command)
    one = start()
    one.learn(EVENTS[:AT])
    published = one.published
    give(one, command, learn=False)  # stored, and killed before it was learned
    one = start()
    one.run()
    published += one.published
    one = start()  # killed after it was learned
    rest(one)
    published += one.published
    assert published == expected


def newest(one: Installation) -> Topology:
    content = one.journal.newest_version()
    assert content is not None
    return read(Topology, content)


def test_a_reset_of_an_epoch_that_was_not_reproduced_counts_on(start: Start) -> None:
    """A version has never two contents."""
    one = start()
    one.learn(EVENTS[:AT])
    give(one, RESET)
    one.journal._db.execute("DELETE FROM snapshot")
    one.journal._db.execute("UPDATE entry SET raw = x'00' WHERE id BETWEEN 20 AND 60")
    again = start()
    again.run()
    assert {epoch for epoch, _, _ in again.published} == {"G"}
    numbers = [version for _, version, _ in again.published]
    assert numbers == list(range(1, len(numbers) + 1))
    assert newest(again).cameras == []


KNOWN = replace(SETTINGS, topology=TopologySettings((("a", "b"),), (("a", "c"),)))
"""The file of settings has the names that it was written with."""


def declared_in(one: Installation) -> Declared | None:
    """Return what the newest version says was declared."""
    content = one.journal.newest_version()
    assert content is not None
    model = read(Topology, content).model
    assert model is not None
    return model.declared


@pytest.mark.parametrize("learn", [True, False])
def test_declarations_go_on_under_new_names(start: Start, learn: bool) -> None:
    """No epoch begins by a new name, whether it was learned before the daemon was killed or not."""
    one = start(settings=KNOWN)
    one.learn(EVENTS[:AT])
    assert declared_in(one) == Declared([("a", "b")], [("a", "c")])
    give(one, Rename("b", "yard"), learn=learn)

    again = start(settings=KNOWN)
    again.run()
    assert again.epoch == "E"
    assert declared_in(again) == Declared([("a", "yard")], [("a", "c")])
    give(again, Forget("c"))
    assert declared_in(again) == Declared([("a", "yard")])


def test_other_declarations_begin_an_epoch(start: Start) -> None:
    start(settings=KNOWN).learn(EVENTS[:AT])
    again = start()
    assert again.epoch == "F"
    again.learn(EVENTS[AT:])
    assert declared_in(again) is None


def test_events_that_count_for_a_renamed_camera_are_not_erased() -> None:
    """Not even where its old name was taken back, and is forgotten as that of another camera."""
    state = NamesState()
    for number, (command, erased) in enumerate(
        [
            (Forget("a"), {"a": 0}),
            (Rename("b", "yard"), {"a": 0}),
            (Forget("b", until=1.0), {"a": 0}),
            (TakeBack("b"), {"a": 0}),
            (Forget("b"), {"a": 0}),
            (TakeBack("a"), {"a": 0}),
            (Forget("a"), {"a": 6}),
            (Rename("yard", "a"), {"a": 6}),
            (Reset(3.0), {"a": 6}),
            (Rename("a", "gate"), {"a": 6}),
            (Forget("gate"), {"a": 10, "gate": 10}),
        ]
    ):
        cameras = {"a", "b", "yard"} if number > 1 else {"a", "b"}
        state = carried_out(state, command, cameras, 2.0, number)[0]
        assert state.erased == erased, command


def test_what_is_erased_follows_from_the_commands(start: Start) -> None:
    one = start()
    give(one, Forget("b"), learn=False)
    give(one, TakeBack("x"), learn=False)
    state = read_names(one.journal)
    assert state.erased == {"b": 1, "x": 2}
    one.journal._db.execute("DELETE FROM meta WHERE key = 'names'")
    assert read_names(one.journal).erased == state.erased


def test_what_the_old_name_sends_late_takes_no_declaration_away() -> None:
    """The daemon forgets the old name by itself once the camera sends under the new one."""
    state = NamesState()
    state, _ = carried_out(state, Rename("b", "yard"), {"a", "b"}, 1.0, 1)
    state, _ = carried_out(state, Forget("b", until=1.0), {"b"}, 1.0, 1)
    state, _ = carried_out(state, Rename("yard", "gate"), {"a", "yard"}, 1.0, 1)
    assert present_names(state) == {"b": "gate", "yard": "gate"}
    state, _ = carried_out(state, Forget("gate"), {"a", "gate"}, 2.0, 1)
    assert set(present_names(state).values()) == {""}
