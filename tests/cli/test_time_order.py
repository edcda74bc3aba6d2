"""Events in order of time, and their answers in the order of the input, in bounded memory."""

from __future__ import annotations

import io
import sqlite3
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

import pytest
from hypothesis import given, strategies as st
from serving import closing_event, walkers

from camtopod.cli import exits, main
from camtopod.cli.events import time_order
from camtopod.cli.events.recording import Survey
from camtopod.cli.events.time_order import LATE_LINES_MAX, OrderedAnswers, by_key
from camtopod.codec import to_json
from camtopod.records import Event

EVENTS = [*walkers(30), closing_event()]
events_of = st.lists(
    st.builds(
        Event,
        st.sampled_from(["a", "b"]),
        st.sampled_from(["entry", "exit"]),
        st.integers(0, 12).map(float),
    ),
    max_size=40,
)


class Ledger:
    """Answers each exit with its time, and the numbers of events before it and at its moment."""

    def __init__(self) -> None:
        self.earlier = 0

    def __call__(self, moment: list[Event]) -> list[bytes]:
        texts = [
            b"%s %g %d %d" % (e.camera.encode(), e.t, self.earlier, len(moment)) for e in moment
        ]
        self.earlier += len(moment)
        return texts


def right(events: Iterable[Event]) -> list[bytes]:
    """Return the answers to the exits, from the definition."""
    events = list(events)
    at = Counter(event.t for event in events)
    return [
        b"%s %g %d %d" % (e.camera.encode(), e.t, sum(n for t, n in at.items() if t < e.t), at[e.t])
        for e in events
        if e.kind == "exit"
    ]


def answers(lateness: float = 0.0) -> OrderedAnswers:
    return OrderedAnswers(Ledger(), "exit", lateness)


def lines(events: Iterable[Event]) -> bytes:
    return b"".join(to_json(event) + b"\n" for event in events)


@given(events_of)
def test_any_order_gives_the_answers_of_the_order_of_time(events: list[Event]) -> None:
    assert list(answers().of_unordered(events)) == right(events)


@given(events_of, st.data())
def test_disorder_within_the_lateness_changes_no_answer(
    events: list[Event], data: st.DataObject
) -> None:
    delays = [data.draw(st.floats(0.0, 4.9)) for _ in events]
    order = sorted(range(len(events)), key=lambda k: events[k].t + delays[k])
    mixed = [events[k] for k in order]

    assert list(answers(5.0).of(mixed)) == right(mixed)


def test_an_exit_is_answered_when_a_line_as_late_as_the_lateness_has_come() -> None:
    waiting = answers(5.0)

    assert waiting.add(Event("a", "exit", 10.0)) == []
    assert waiting.add(Event("b", "entry", 14.9)) == []
    assert waiting.add(Event("b", "entry", 15.0)) == [b"a 10 0 1"]
    assert waiting.add(Event("c", "exit", 9.0)) == [b"c 9 1 1"], "late: at once"
    assert waiting.add(Event("c", "exit", 15.0)) == []
    assert waiting.rest() == [b"c 15 3 2"], "and it counts from then on"


def test_answers_wait_for_those_before_them_in_the_input() -> None:
    waiting = answers(5.0)

    assert waiting.add(Event("a", "exit", 14.0)) == []
    assert waiting.add(Event("b", "exit", 10.0)) == []
    assert waiting.add(Event("b", "entry", 15.0)) == []
    assert waiting.add(Event("b", "entry", 19.0)) == [b"a 14 1 1", b"b 10 0 1"]


def test_a_wrong_time_delays_only_a_few_answers() -> None:
    waiting = answers(5.0)
    waiting.add(Event("a", "exit", 9e9))
    given = [waiting.add(Event("b", "exit", float(t))) for t in range(100)]

    first = next(k for k, some in enumerate(given) if some)
    assert first < LATE_LINES_MAX
    assert sum(map(len, given)) >= 95, "from then on each waits for the lateness alone"


@pytest.mark.parametrize("kind", ["entry", "exit"])
def test_no_more_lines_are_held_than_the_limit(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time_order, "LINES_HELD_MAX", 10)
    waiting = answers(5.0)

    returned = []
    for k in range(1000):
        returned += waiting.add(Event("a", kind, k * 1e-3))
        assert max(len(waiting._heap), len(waiting._open_numbers), len(waiting._answers)) < 10

    returned += waiting.rest()
    assert len(returned) == (1000 if kind == "exit" else 0)


def test_what_exceeds_the_memory_is_sorted_on_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(time_order, "SORTING_BYTES_MAX", 64 << 10)
    records = [(float(k * 7919 % 5003), b"%05d" % k * 20) for k in range(20_000)]

    order = [number for number, _ in by_key(records)]

    assert order == sorted(range(1, 20_001), key=lambda number: (records[number - 1][0], number))


@pytest.mark.parametrize(
    ("text", "is_ordered"),
    [
        (b"", True),
        (b'{"t":1}\n{"t":1}\nnonsense\n{"t":2.5}\n{"camera":3}\n', True),
        (b'{"t":2}\n{"t":1}\n', False),
        (b'[{"t":2},\n {"t":3}]\n{"t":2}', False),
        (b"camera,kind,t\na,exit,1970-01-01T00:00:02\na,exit,3\n", True),
        (b"camera,kind,t\na,exit,4\na,exit,3\n", False),
    ],
)
def test_a_file_is_checked_for_order(text: bytes, is_ordered: bool) -> None:
    file = io.BufferedReader(io.BytesIO(text))  # type: ignore[arg-type,type-var]
    assert Survey().look("f", file) == (is_ordered, set())


# --- The command ---


@pytest.fixture(scope="module")
def topology(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("learned")
    (folder / "events.jsonl").write_bytes(lines(EVENTS))
    out = folder / "topology.json"
    assert main.main(["learn", str(folder / "events.jsonl"), "--topology", str(out)]) == 0
    return out


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "camtopod", "predict", *map(str, arguments), "--config", "none"]


@pytest.mark.parametrize("walks", [[], ["--walks"]])
def test_a_pipe_gives_each_answer_before_it_ends(
    walks: list[str], topology: Path, tmp_path: Path
) -> None:
    """The last ones come as nothing else does, the others as later lines come."""
    (tmp_path / "events.jsonl").write_bytes(lines(EVENTS))
    file = subprocess.run(
        command(topology, tmp_path / "events.jsonl", *walks), stdout=subprocess.PIPE, check=True
    )
    with subprocess.Popen(
        command(topology, "-", *walks), stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as piped:
        assert piped.stdin is not None
        assert piped.stdout is not None
        half = next(k for k in range(50, len(EVENTS)) if EVENTS[k - 1].t < EVENTS[k].t)
        piped.stdin.write(lines(EVENTS[:half]))
        piped.stdin.flush()
        first = piped.stdout.readline()
        piped.stdin.write(lines(EVENTS[half:]))
        piped.stdin.flush()
        rest = [piped.stdout.readline() for _ in file.stdout.splitlines()[1:]]
        piped.stdin.close()
        assert piped.stdout.read() == b""

    assert piped.returncode == 0
    assert b"".join([first, *rest]) == file.stdout


def test_late_lines_of_a_pipe_are_answered_and_counted(topology: Path) -> None:
    late = [Event("a", "exit", EVENTS[0].t - 100.0 - k) for k in range(3)]

    done = subprocess.run(
        command(topology, "-"), input=lines([*EVENTS, *late]), capture_output=True, check=True
    )

    wanted = sum(event.kind == "exit" for event in EVENTS) + len(late)
    assert len(done.stdout.splitlines()) == wanted
    assert done.stderr.startswith(b"camtopod: 3 lines came too late")


def test_standard_input_that_is_a_file_is_one(topology: Path, tmp_path: Path) -> None:
    """Read from where it stands, unordered."""
    path = tmp_path / "events.jsonl"
    path.write_bytes(b"skipped\n" + lines(reversed(EVENTS)))
    with path.open("rb", buffering=0) as file:
        file.read(len(b"skipped\n"))
        done = subprocess.run(command(topology, "-"), stdin=file, capture_output=True, check=True)

    assert done.stderr == b""
    assert len(done.stdout.splitlines()) == sum(event.kind == "exit" for event in EVENTS)


def test_a_disk_without_room_for_sorting_says_what_to_do(
    topology: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    class Full(sqlite3.Connection):
        def executemany(self, *_: object) -> sqlite3.Cursor:
            raise sqlite3.OperationalError("database or disk is full")

    monkeypatch.setattr(time_order.sqlite3, "connect", Full)
    (tmp_path / "events.jsonl").write_bytes(lines(reversed(EVENTS)))

    assert main.main(["predict", str(topology), str(tmp_path / "events.jsonl")]) == exits.FAILED
    assert "disk is full): make room, set TMPDIR" in capsys.readouterr().err
