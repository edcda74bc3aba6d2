"""`camtopod learn --state`: a daemon continues from a recording."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import pytest
from msgspec.structs import replace
from serving import SPAN_SECONDS, T0, closing_event, numbered, small_config, wait_for, walkers

from camtopod.cli import exits, main
from camtopod.cli.commands import learn as command
from camtopod.codec import read, to_json
from camtopod.learn.learner import Learner
from camtopod.learn.settings import Settings
from camtopod.records import Event, Topology
from camtopod.serve.bus import session as buses
from camtopod.serve.daemon import Daemon
from camtopod.serve.storage.journal import Journal

LEARN = Settings(refit_share=0.2)
RECORDED = sorted(numbered(walkers(60), "recorded"), key=lambda event: event.t)
LATER = [
    replace(event, t=event.t + SPAN_SECONDS, boot="later", track=f"later {event.track}")
    for event in sorted(numbered(walkers(60, seed=2)), key=lambda event: event.t)
]


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "events.jsonl"
    path.write_bytes(b"".join(to_json(event) + b"\n" for event in RECORDED))
    return path


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """Return a configuration with the settings of the learner only."""
    path = tmp_path / "site.toml"
    path.write_text(f'[site]\nname = "site"\n[learn]\nrefit_share = {LEARN.refit_share}\n')
    return path


def learn(recording: Path, site: Path, state: Path, *more: str) -> int:
    return main.main(["learn", "--config", str(site), str(recording), "--state", str(state), *more])


def daemon_on(state: Path, events: list[Event]) -> Daemon:
    """Return a daemon that has received the events on the bus and published all
    versions of them.
    """
    daemon = Daemon(replace(small_config(state), learn=LEARN), clock=lambda: T0 + 20 * SPAN_SECONDS)
    daemon.start()
    bus = buses.dial(small_config(state, daemon.endpoint))
    try:
        for event in events:
            bus.publish(f"event/{event.camera}", event, "event")
        wait_for(
            lambda: daemon.status().events.stored + daemon.status().events.duplicate == len(events),
            "all",
        )
        wait_for(lambda: not daemon.status().events.waiting, "learning")
        learned = daemon.status().learner.version
        wait_for(
            lambda: daemon.topology is not None and daemon.topology.version == learned,
            "the newest version",
        )
    finally:
        bus.close()
    return daemon


def test_a_daemon_goes_on_from_a_recording(recording: Path, site: Path, tmp_path: Path) -> None:
    state, topology = tmp_path / "state", tmp_path / "topology.json"
    assert learn(recording, site, state, "--topology", str(topology)) == exits.DONE
    first = read(Topology, topology.read_bytes())
    assert first.version == 1
    assert {pair.cameras for pair in first.pairs} == {("a", "b"), ("a", "c")}

    # The learner that made this version, with the settings of a daemon, and given what comes later.
    known = Learner(LEARN, "site", first.epoch, only_last=True)
    for event in RECORDED:
        known.receive(event)
    known.refresh()
    going_on = Learner(LEARN, "site", first.epoch)
    going_on.load(known.save())
    for event in [*LATER, closing_event()]:
        going_on.receive(event)
    expected = going_on.updates()
    assert len(expected) >= 2

    daemon = daemon_on(state, [])
    assert daemon.topology is not None
    assert (daemon.topology.version, daemon.topology.digest) == (1, first.digest)
    daemon.stop()
    daemon = daemon_on(state, [*LATER, closing_event()])
    daemon.stop()
    with closing(Journal(state)) as journal:
        assert journal.versions(first.epoch) == {1: first.digest} | {
            one.version: one.digest for one in expected
        }


def test_events_of_the_recording_count_once(recording: Path, site: Path, tmp_path: Path) -> None:
    """They may come again, from a spool or a file."""
    assert learn(recording, site, tmp_path / "state") == exits.DONE
    daemon = daemon_on(tmp_path / "state", RECORDED)
    assert daemon.status().events.duplicate == len(RECORDED)
    daemon.stop()
    with closing(Journal(tmp_path / "state")) as journal:
        assert len(journal) == len(RECORDED)


def test_a_directory_with_a_state_is_left_alone(
    recording: Path, site: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    state = tmp_path / "state"
    assert learn(recording, site, state) == exits.DONE
    before = (state / "journal.db").read_bytes()
    assert learn(recording, site, state) == exits.STATE
    assert f"{state} has a state already: name a new directory" in capsys.readouterr().err
    assert (state / "journal.db").read_bytes() == before


def test_ended_half_way_the_daemon_learns_what_is_there(
    recording: Path, site: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Ended(Exception):
        pass

    def end(state: command.RecordedState, learner: Learner) -> None:
        state._commit()
        raise Ended

    monkeypatch.setattr(command.RecordedState, "finish", end)
    with pytest.raises(Ended):
        learn(recording, site, tmp_path / "state")
    daemon = daemon_on(tmp_path / "state", [closing_event()])
    daemon.stop()
    plain = Learner(LEARN, "site", daemon.epoch)
    for event in [*RECORDED, closing_event()]:
        plain.receive(event)
    with closing(Journal(tmp_path / "state")) as journal:
        assert journal.versions(daemon.epoch) == {
            one.version: one.digest for one in plain.updates()
        }
