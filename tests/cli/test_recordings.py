"""Recordings: in any order, with repeats, wrong stamps and spoilt times; what was used is said."""

from __future__ import annotations

import io
import random
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from msgspec.structs import replace

from camtopod import load_events
from camtopod.cli import exits
from camtopod.cli.events import event_lines
from camtopod.cli.events.event_lines import LineReader
from camtopod.cli.events.recording import Times, fault_of, once_by_number, recorded
from camtopod.cli.main import main
from camtopod.codec import read, to_json
from camtopod.records import Event, Topology
from camtopod.sim.simulation import SimSettings, simulate

EVENTS = simulate(SimSettings(cameras=3, hours=0.25, seed=1))[0]
DAY = 86_400.0


class Piped(io.BytesIO):
    """Content of a pipe."""

    def seekable(self) -> bool:
        return False


def written(path: Path, events: Sequence[Event]) -> Path:
    path.write_bytes(b"".join(to_json(event) + b"\n" for event in events))
    return path


def learned(path: Path, *more: str) -> tuple[int, Topology]:
    """Return the exit status of `camtopod learn`, and the topology."""
    out = path.with_name("topology.json")
    status = main(["--config", "none", "learn", str(path), *more, "--topology", str(out)])
    return status, read(Topology, out.read_bytes())


def used(tmp_path: Path, events: Sequence[Event]) -> tuple[LineReader, list[Event], Times]:
    """Return the events of a recording, and what is known of its lines and times."""
    reader, times = LineReader(), Times()
    path = written(tmp_path / "events.jsonl", events)
    lines = once_by_number(reader, recorded(reader, [str(path)], times))
    return reader, [line.event for line in lines], times


# --- for programs ---


def test_a_program_loads_a_recording(tmp_path: Path) -> None:
    first = written(tmp_path / "a.jsonl", EVENTS[::2])
    second = written(tmp_path / "b.jsonl", EVENTS[1::2] + EVENTS[:1])

    with pytest.warns(UserWarning, match=f"1 of {len(EVENTS) + 1} lines are repeats"):
        events = load_events(first, second)

    assert [event.t for event in events] == sorted(event.t for event in EVENTS)
    assert set(events) == set(EVENTS)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "there are no events"),
        ("camera,kind,t\na,enter,1.0\na,exit,2.0\n", "1 of 2 lines were rejected"),
        (
            "camera,kind,t\n" + "".join(f"a,entry,4524{k % 7}.{k}\n" for k in range(1000)),
            "a spreadsheet",
        ),
    ],
)
def test_a_program_is_told_what_is_wrong_with_a_recording(
    tmp_path: Path, text: str, sentence: str
) -> None:
    path = tmp_path / "events.csv"
    path.write_text(text)
    with pytest.raises(ValueError, match=sentence):
        load_events(path)
    with pytest.raises(ValueError, match=r"nowhere\.csv"):
        load_events(tmp_path / "nowhere.csv")


# --- order and repeats ---


@pytest.mark.parametrize(
    "order",
    [
        lambda events: sorted(events, key=lambda event: (event.camera, event.t)),
        lambda events: events[::-1],
        lambda events: random.Random(1).sample(events, len(events)),
        lambda events: events + events,
        lambda events: events[::-1] + random.Random(1).sample(events, len(events)),
    ],
    ids=["by camera", "newest first", "shuffled", "twice", "newest first and shuffled"],
)
def test_a_recording_is_learned_whatever_its_order(
    order: Callable[[list[Event]], list[Event]],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    _, right = learned(written(tmp_path / "right.jsonl", EVENTS))
    lines = order(EVENTS)
    capsys.readouterr()

    status, topology = learned(written(tmp_path / "events.jsonl", lines))

    assert (status, topology.digest) == (0, right.digest)
    said = capsys.readouterr().err
    repeats = len(lines) - len(EVENTS)
    assert (f"{repeats} of {len(lines)} lines are repeats, counted once" in said) == (repeats > 0)
    assert "lateness" not in said


def test_a_pipe_is_sorted_as_a_file_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Pipe(io.BytesIO):
        def seekable(self) -> bool:
            return False

    pipe = Pipe(b"".join(to_json(event) + b"\n" for event in EVENTS[::-1]))
    monkeypatch.setattr(event_lines.sys, "stdin", io.TextIOWrapper(io.BufferedReader(pipe)))  # type: ignore[type-var]
    lines = list(recorded(LineReader(), ["-"], Times()))

    assert [line.event for line in lines] == EVENTS
    assert [line.number for line in lines] == [*range(len(EVENTS), 0, -1)]


@pytest.mark.parametrize(
    ("other", "is_repeat"),
    [
        ({}, True),
        ({"x": 0.2}, True),  # the track tells
        ({"track": "8"}, False),
        ({"kind": "exit"}, False),
        ({"t": 5.0004}, True),  # a program that writes milliseconds has rounded it
        ({"t": 5.1}, False),
        ({"camera": "b"}, False),
        ({"track": None}, False),
    ],
)
def test_the_same_track_at_the_same_time_is_a_repeat(
    other: dict[str, object], is_repeat: bool, tmp_path: Path
) -> None:
    event = Event("a", "entry", 5.0, 0.5, 0.5, "7")
    reader, events, _ = used(tmp_path, [event, Event("c", "exit", 5.0), replace(event, **other)])
    assert (len(events), reader.repeats) == ((2, 1) if is_repeat else (3, 0))
    assert reader.status == exits.DONE


def test_a_repeat_is_one_whatever_comes_just_before_it(tmp_path: Path) -> None:
    event = Event("a", "entry", 5.0009, 0.5, 0.5, "7")
    events = [Event("c", "exit", 5.0), event, replace(event, t=5.001), replace(event, t=5.1)]
    reader, distinct_events, _ = used(tmp_path, events)
    assert ([e.t for e in distinct_events], reader.repeats) == ([5.0, 5.0009, 5.1], 1)


def test_without_tracks_the_position_tells_and_without_both_nothing(tmp_path: Path) -> None:
    place, none = Event("a", "entry", 5.0, 0.5, 0.5), Event("a", "entry", 5.0)
    assert used(tmp_path, [place, place, replace(place, x=0.6)])[0].repeats == 1
    assert used(tmp_path, [none, none])[0].repeats == 0


def test_the_same_number_is_a_repeat_whatever_else_differs(tmp_path: Path) -> None:
    events = [Event("a", "entry", 5.0 + n, boot="b", seq=n // 2) for n in range(6)]
    assert used(tmp_path, events)[0].repeats == 3
    assert (
        used(tmp_path, [replace(event, camera=f"c{event.t:.0f}") for event in events])[0].repeats
        == 0
    )


# --- wrong stamps ---


@pytest.mark.parametrize("order", [1, -1], ids=["oldest first", "newest first"])
@pytest.mark.parametrize("place", [0, 1, 300, -1])
@pytest.mark.parametrize("seconds", [26 * 365 * DAY, 1.5 * DAY, -1.5 * DAY, None])
def test_a_wrong_stamp_costs_its_line_and_is_named(
    seconds: float | None,
    place: int,
    order: int,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """At any place of a file; None for a clock that counts from 1970."""
    events = EVENTS[::order]
    right = [*events[:place], *events[place:][1:]]
    wrong = replace(events[place], t=0.0 if seconds is None else events[place].t + seconds)
    number = place % len(events) + 1

    reader, found, _ = used(tmp_path, [*events[: number - 1], wrong, *events[number:]])

    assert found == sorted(right, key=lambda event: event.t)
    assert reader.rejections == {"contradicted": 1}
    said = capsys.readouterr().err
    assert f"events.jsonl:{number}: t is " in said
    assert "is set aside" in said


def test_a_few_wrong_stamps_in_a_row_are_no_part_of_the_recording(tmp_path: Path) -> None:
    wrong = [replace(event, t=event.t + 1e8) for event in EVENTS[100:102]]
    wrong = [replace(event, camera=EVENTS[99].camera) for event in wrong]
    reader, found, _ = used(tmp_path, [*EVENTS[:100], *wrong, *EVENTS[102:]])
    assert len(found) == len(EVENTS) - 2
    assert reader.rejections == {"contradicted": 2}


@pytest.mark.parametrize("place", [0, -3])
@pytest.mark.parametrize("years", [-30, 25])
def test_wrong_stamps_of_several_cameras_at_either_end_are_set_aside(
    years: int, place: int, tmp_path: Path
) -> None:
    """As before clocks are set; together they agree, but not with their cameras."""
    events = list(EVENTS)
    for number in (place, place + 1, place + 2):
        events[number] = replace(events[number], t=events[number].t + years * 365 * DAY)
    reader, found, _ = used(tmp_path, events)
    assert found == (EVENTS[3:] if place == 0 else EVENTS[:-3])
    assert reader.rejections == {"contradicted": 3}


def test_a_rare_camera_is_not_contradicted_by_busy_ones(tmp_path: Path) -> None:
    middle = EVENTS[len(EVENTS) // 2].t
    rare = [Event("rare", "entry", middle + 3 * DAY * k) for k in range(-5, 6)]
    reader, found, _ = used(tmp_path, [*EVENTS, *rare])
    assert len(found) == len(EVENTS) + len(rare)
    assert not reader.rejections


@pytest.mark.parametrize("walks", [[], ["--walks"]])
def test_predict_sets_wrong_stamps_aside_as_learn_does(
    walks: list[str], tmp_path: Path, capsysbinary: pytest.CaptureFixture[bytes]
) -> None:
    learned(written(tmp_path / "right.jsonl", EVENTS))
    wrong = [replace(EVENTS[k], t=EVENTS[k].t + 1e8) for k in (200, -1)]
    right = [*EVENTS[:200], *EVENTS[201:-1]]
    capsysbinary.readouterr()
    answers = []
    for events in (right, [*EVENTS[:200], wrong[0], *EVENTS[201:-1], wrong[1]]):
        path = written(tmp_path / "events.jsonl", events)
        main(["--config", "none", "predict", *walks, str(tmp_path / "topology.json"), str(path)])
        printed = capsysbinary.readouterr()
        answers.append(printed.out)
    assert answers[0] == answers[1] != b""
    assert b"events.jsonl:201: t is " in printed.err
    assert b"rejected: contradicted 2" in printed.err


@pytest.mark.parametrize("days", [1.2, 2.5, 10, 300])
def test_lines_in_no_order_contradict_nothing(days: float, tmp_path: Path) -> None:
    chance = random.Random(days)
    events = [Event("a", "entry", chance.uniform(0, days * DAY)) for _ in range(500)]
    assert len(used(tmp_path, events)[1]) == 500


def test_gaps_and_several_recordings_are_no_mistake(tmp_path: Path) -> None:
    """Weekends, a rare event, logs in order of their names: 1, 10, 11, 2."""
    week = [Event("a", "entry", 7 * DAY * k + n) for k in range(5) for n in range(20)]
    assert len(used(tmp_path, week)[1]) == 100
    rare = [Event("a", "entry", 3 * DAY * k) for k in range(9)]
    assert len(used(tmp_path, rare)[1]) == 9
    logs = [Event("a", "entry", DAY * k + 60 * n) for k in (1, 10, 11, 2, 3, 4) for n in range(50)]
    assert len(used(tmp_path, logs)[1]) == 300
    one = [*week, Event("b", "entry", 900 * DAY)]
    assert len(used(tmp_path, one)[1]) == 101, "no line of its camera contradicts it"


# --- times that cannot be true ---


@pytest.mark.parametrize(
    ("spoilt", "word"),
    [
        (lambda t: float(f"{t:.2E}"), "1.70E+09"),
        (lambda t: float(f"{t:.6E}") // 1000 * 1000, "1.70E+09"),
        (lambda t: t // 60 * 60, "no seconds"),
        (lambda t: t / DAY + 25_569, "counts days"),
        (lambda t: round(t / DAY, 5), "counts days"),
        (lambda t: 1_234_567_890.5, "counts days"),
    ],
)
def test_times_that_a_spreadsheet_has_spoilt_are_named(
    spoilt: Callable[[float], float],
    word: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = written(tmp_path / "e.jsonl", [replace(event, t=spoilt(event.t)) for event in EVENTS])
    status, _ = learned(path)
    said = capsys.readouterr().err
    assert status == exits.FAILED
    assert word in said
    assert "at this traffic" not in said, "no forecast of a traffic that does not exist"

    topology = str(tmp_path / "topology.json")
    ingest = ["ingest", "--out", "-", "jsonl"]
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BufferedReader(Piped(path.read_bytes()))))
    for command in ([*ingest, str(path)], [*ingest, "-"], ["predict", topology, str(path)]):
        assert main(["--config", "none", *command]) == exits.FAILED
        assert capsys.readouterr().err.count(word) == 1


def test_times_from_zero_and_whole_seconds_are_legal(tmp_path: Path) -> None:
    for begin in (0.0, 45_244.0, 1.7e9):
        start = EVENTS[0].t
        events = [replace(event, t=round(event.t - start + begin)) for event in EVENTS]
        assert fault_of(used(tmp_path, events)[2]) is None


@pytest.mark.parametrize("shift", [-EVENTS[0].t, 365 * DAY])
def test_a_camera_of_another_year_is_said_to_be_left_out_of_the_window(
    shift: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = EVENTS[0].camera
    events = [replace(event, t=event.t + shift * (event.camera == camera)) for event in EVENTS]
    _, topology = learned(written(tmp_path / "e.jsonl", events))
    absent = {event.camera for event in EVENTS} - {camera.id for camera in topology.cameras}
    assert absent
    words = f"has no events of {', '.join(sorted(absent))}: is a clock wrong?"
    assert words in capsys.readouterr().err


def test_standard_input_is_read_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--config", "none", "learn", "-", "-"]) == exits.INPUT
    assert "standard input ('-') can be read once only" in capsys.readouterr().err


def test_several_events_of_one_line_are_judged_one_by_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As pandas writes them: here newest first, with a repeat, a wrong stamp and no event."""
    events = [Event("hall", "entry", 1.7e9 - 60.0 * n, track=str(n)) for n in range(40)]
    events[20] = replace(events[20], t=1.6e9)
    path = tmp_path / "e.json"
    path.write_bytes(to_json([*events, events[3], {"camera": "hall"}]))

    assert main(["--config", "none", "ingest", "jsonl", str(path), "--out", "-"]) == exits.DONE

    said = capsys.readouterr()
    assert said.out.count("\n") == 39
    assert "40 of 42 lines were accepted" in said.err
    assert "contradicted 1" in said.err
    assert "1 of 42 lines are repeats" in said.err


# --- what was used ---


def test_a_command_says_what_it_used_and_fails_if_that_is_too_little(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = written(tmp_path / "events.jsonl", EVENTS)
    status, topology = learned(path)
    count = len(EVENTS)
    assert status == exits.DONE
    assert "accepted" not in capsys.readouterr().err
    with path.open("ab") as file:
        file.write(b"rubbish\n" * (count // 5))

    read_count = count + count // 5
    for command in (["learn", str(path)], ["ingest", "jsonl", str(path), "--out", "-"]):
        assert main(["--config", "none", *command]) == exits.FAILED
        printed = capsys.readouterr()
        assert f"{count} of {read_count} lines were accepted" in printed.err
        assert printed.err.count("rubbish (further ones") == 1
        assert printed.out, "the output is written all the same"
    for walks in ([], ["--walks"]):
        arguments = ["predict", *walks, str(tmp_path / "topology.json"), str(path)]
        assert main(["--config", "none", *arguments]) == exits.FAILED
        assert f"{count} of {read_count} lines were accepted" in capsys.readouterr().err
    assert topology.events == count


def test_repeats_do_not_count_against_a_recording(tmp_path: Path) -> None:
    reader, _, _ = used(tmp_path, EVENTS * 3)
    reader.lines_read += 1
    reader.reject("malformed", "here")
    assert reader.status == exits.DONE
    assert (reader.accepted, reader.repeats) == (3 * len(EVENTS), 2 * len(EVENTS))


def test_messages_of_other_topics_do_not_count_against_an_input() -> None:
    """As of what else a camera publishes."""
    reader = LineReader()
    reader.lines_read = 100
    for _ in range(90):
        reader.reject("other-topic", "here")
    assert reader.status == exits.DONE
    for _ in range(2):
        reader.reject("malformed", "here")
    assert reader.status == exits.FAILED
