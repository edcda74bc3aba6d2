"""An operator's commands in the learner: forget, rename, and a new beginning."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from functools import lru_cache

import pytest
from msgspec.structs import replace
from test_snapshot import SETTINGS, events_of, restored

from camtopod import codec
from camtopod.learn.learner import Learner
from camtopod.learn.renaming import rename
from camtopod.learn.snapshot import pack
from camtopod.predict import Predictor
from camtopod.records import Event, Topology
from camtopod.topology import UnknownPlace
from camtopod.topology.versions import alarms_follow

Change = Callable[[Learner], Learner]
"""Carry out a command; return the learner that goes on."""
HALF = len(events_of("hard")) // 2


def forget(camera: str) -> Change:
    def change(learner: Learner) -> Learner:
        if learner.erase({camera}):
            learner.make_version()
        return learner

    return change


def name(old: str, new: str) -> Change:
    def change(learner: Learner) -> Learner:
        renamed = Learner(learner.settings, learner.site, learner.epoch)
        renamed.load(rename(learner.save(), old, new))
        renamed.make_version()
        return renamed

    return change


def told(
    events: Iterable[Event], change: Change | None = None, learner: Learner | None = None
) -> tuple[Learner, list[Topology]]:
    """Return the learner after events and a command, and the versions made."""
    learner = learner or Learner(SETTINGS, "s", "e")
    made = []
    for event in events:
        learner.receive(event)
        made += learner.updates()
    if change is not None:
        learner = change(learner)
        made += learner.updates()
    return learner, made


@lru_cache
def half() -> bytes:
    return pack(told(events_of("hard")[:HALF])[0].save())


def newest(learner: Learner) -> Topology:
    assert learner.topology is not None
    return learner.topology


def known(learner: Learner, camera: str) -> bool:
    """Return True if a camera's name is anywhere in the learner's state or newest version."""
    state = learner.save()
    texts = [
        codec.to_json(newest(learner)),
        json.dumps([state.intake.newest, state.window.cameras]),
        codec.to_json([state.intake.held, state.intake.numbers, state.intake.time.waited]),
        codec.to_json([state.alarms, [*state.publishers], [*state.retired]]),
        codec.to_json([state.intake.time.leader or ""]),
    ]
    return any(
        f'"{camera}"' in text or f'"{camera}/' in text or f">{camera}/" in text
        for text in (one.decode() if isinstance(one, bytes) else one for one in texts)
    )


def test_nothing_of_a_forgotten_camera_is_left() -> None:
    camera = "cam02"
    learner = restored(half())
    before = newest(learner)
    assert known(learner, camera)
    learner, [after] = told([], forget(camera), learner)
    assert after.version == before.version + 1, "the version is made at once"
    # The leader of event time is only forgotten with its next event.
    state = learner.save()
    state.intake.time.leader = None
    clean = Learner(SETTINGS, "s", "e")
    clean.load(state)
    assert not known(clean, camera)
    assert {one.id for one in after.cameras} == {one.id for one in before.cameras} - {camera}
    with pytest.raises(UnknownPlace):
        Predictor(after).predict(Event(camera, "exit", after.as_of, 0.5, 0.5))
    told([event for event in events_of("hard")[HALF:] if event.camera != camera], None, learner)
    assert not known(learner, camera)


def test_a_site_whose_cameras_are_all_forgotten_is_empty_and_learns_again() -> None:
    learner = restored(half())
    names = [camera.id for camera in newest(learner).cameras]
    for camera in names:
        learner, made = told([], forget(camera), learner)
    last = newest(learner)
    assert (last.cameras, last.links, last.zones) == ([], [], [])
    assert codec.decode_topology(codec.to_json(last)) == last
    learner = restored(pack(learner.save()))
    learner, made = told(events_of("hard")[HALF:], None, learner)
    assert {camera.id for camera in made[-1].cameras} == set(names)


def other_name(event: Event, old: str, new: str) -> Event:
    return replace(event, camera=new) if event.camera == old else event


@pytest.mark.parametrize("new", ["entry"])
def test_a_renamed_camera_is_as_one_that_always_had_the_name(new: str) -> None:
    """Exactly so at once: the fit sees the same events in the same order."""
    events = events_of("hard")[:HALF]
    renamed, _ = told(events, name("cam01", new))
    always, _ = told([other_name(event, "cam01", new) for event in events], name("none", "nobody"))
    assert newest(renamed).version == newest(always).version
    assert newest(renamed).digest == newest(always).digest
    assert not known(renamed, "cam01")
    clocks = {camera.id: camera.clock_offset for camera in newest(renamed).cameras}
    assert clocks[new] == next(
        camera.clock_offset for camera in newest(restored(half())).cameras if camera.id == "cam01"
    )


@pytest.mark.parametrize("change", [forget("cam02"), name("cam02", "yard")])
def test_a_restored_learner_carries_out_the_same(change: Change) -> None:
    """With the same versions to the end, whether it is saved before or after the command."""
    rest = events_of("hard")[HALF:]
    learner, made = told([], change, restored(half()))
    unbroken = [*made, *told(rest, None, learner)[1]]

    learner, made = told([], change, restored(half()))
    learner, more = told(rest[:50], None, learner)
    _, rest_of_it = told(rest[50:], None, restored(pack(learner.save())))

    again = [*made, *more, *rest_of_it]
    assert [(one.version, one.digest) for one in again] == [
        (one.version, one.digest) for one in unbroken
    ]


def test_alarms_are_forgotten_and_renamed_with_their_camera() -> None:
    learner, made = told(events_of("hard"))
    assert "cam02" in {alarm.subject for alarm in made[-1].alarms or []}, "it was turned"
    before = newest(learner)
    learner, [renamed] = told([], name("cam02", "yard"), learner)
    assert "yard" in {alarm.subject for alarm in renamed.alarms or []}
    assert not alarms_follow(before, renamed)
    learner, [after] = told([], forget("yard"), learner)
    assert not alarms_follow(renamed, after)
    assert not [one for one in after.alarms or [] if "yard" in one.subject]


def test_a_new_beginning_is_an_empty_version_and_learns_like_a_new_learner() -> None:
    events = events_of("usual")[:HALF]
    t = events[0].t - 1.0
    learner = Learner(SETTINGS, "s", "e2")
    learner.begin_empty(t, None)
    [empty] = learner.updates()
    assert (empty.version, empty.cameras, empty.events) == (1, [], 0)
    assert codec.decode_topology(codec.to_json(empty)) == empty
    learner = restored(pack(learner.save()))
    _, made = told(events, None, learner)
    _, plain = told(events)
    assert [one.links for one in made] == [one.links for one in plain]
