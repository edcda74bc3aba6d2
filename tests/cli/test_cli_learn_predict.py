"""`camtopod learn` and `camtopod predict` over files and pipes."""

from __future__ import annotations

import io
import random
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from delta_receiver import apply_delta
from msgspec.structs import replace

from camtopod.cli import exits, main
from camtopod.cli.commands.learn import EPOCH
from camtopod.cli.events.event_lines import LineReader
from camtopod.codec import EVENT_BYTES_MAX, read, to_json
from camtopod.records import Event, Match, Prediction, Topology
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.topology import likely_links
from camtopod.topology.versions import digest_of, make_delta, map_of

EVENTS, TRUTH = simulate(SimSettings(cameras=3, hours=0.25, seed=1))
Run = Callable[..., tuple[int, bytes, str]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capfdbinary: pytest.CaptureFixture[bytes]) -> Run:
    """Run a command; return exit status, standard output, standard error."""

    def go(*args: object, stdin: bytes = b"") -> tuple[int, bytes, str]:
        monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(stdin)))
        status = main.main([str(arg) for arg in args])
        sys.stdout.flush()
        out, err = capfdbinary.readouterr()
        return status, out, err.decode()

    return go


def lines(events: list[Event]) -> bytes:
    return b"".join(to_json(event) + b"\n" for event in events)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "events.jsonl"
    path.write_bytes(lines(EVENTS))
    return path


@pytest.fixture(scope="module")
def topology(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Learn the recording and return the topology's file."""
    folder = tmp_path_factory.mktemp("learned")
    (folder / "events.jsonl").write_bytes(lines(EVENTS))
    out = folder / "topology.json"
    assert main.main(["learn", str(folder / "events.jsonl"), "--topology", str(out)]) == 0
    return out


# --- learn ---


def test_learn_writes_the_topology_and_every_version(
    run: Run, recording: Path, tmp_path: Path
) -> None:
    out, updates = tmp_path / "t.json", tmp_path / "u.jsonl"
    status, printed, said = run("learn", recording, "--topology", out, "--updates", updates)
    assert (status, printed) == (0, b"")
    versions = [read(Topology, line) for line in updates.read_bytes().splitlines()]
    last = read(Topology, out.read_bytes())
    assert versions[-1] == last
    assert [v.version for v in versions] == list(range(1, len(versions) + 1))
    assert len(versions) > 2
    assert (last.epoch, last.events, last.digest) == (EPOCH, len(EVENTS), digest_of(last))
    assert apply_delta(versions[-2], make_delta(versions[-2], last)) == map_of(last)
    assert f"version {last.version}, {len(EVENTS)} events, 3 cameras" in said


def test_learn_from_a_pipe_and_from_several_files(run: Run, topology: Path, tmp_path: Path) -> None:
    names = sorted({event.camera for event in EVENTS})
    for name in names:
        (tmp_path / name).write_bytes(lines([event for event in EVENTS if event.camera == name]))
    assert run("learn", *(tmp_path / name for name in names))[1] == topology.read_bytes()


def test_learn_takes_its_settings_from_the_configuration(
    run: Run, recording: Path, tmp_path: Path
) -> None:
    config = tmp_path / "camtopod.toml"
    config.write_text('[site]\nname = "museum"\n[learn]\nwindow_hours = 0.1\n')
    _, printed, _ = run("learn", recording, "--config", config)
    learned = read(Topology, printed)
    assert learned.site == "museum"
    assert sum(zone.entries + zone.exits for zone in learned.zones) < len(EVENTS) / 2


def test_lines_that_do_not_fit_are_counted_and_quoted_once(run: Run, topology: Path) -> None:
    noise = b'{"camera":"a b","kind":"exit","t":1}\n\n   \nnonsense\n{"camera":"c d","kind":"exit","t":1}\n'
    raw = lines(EVENTS[:50]) + noise + lines(EVENTS[50:])
    status, printed, said = run("learn", "-", stdin=raw)
    assert (status, printed) == (0, topology.read_bytes())
    assert f"3 of {len(EVENTS) + 3} lines were rejected: bad-value camera 2, malformed 1" in said
    assert said.count("a b") == 1
    assert "c d" not in said
    assert "-:51: " in said
    assert "-:54: " in said


def test_a_late_line_is_learned(run: Run, topology: Path) -> None:
    middle = len(EVENTS) // 2
    mixed = EVENTS[:10] + EVENTS[middle:] + EVENTS[10:middle]
    _, printed, said = run("learn", "-", stdin=lines(mixed))
    assert read(Topology, printed).events == len(EVENTS)
    assert "were rejected" not in said


def test_a_file_in_any_order_is_learned_by_time(run: Run, topology: Path, tmp_path: Path) -> None:
    shuffled = EVENTS[:]
    random.Random(1).shuffle(shuffled)
    (tmp_path / "shuffled.jsonl").write_bytes(lines(shuffled))
    status, printed, said = run("learn", str(tmp_path / "shuffled.jsonl"), "--topology", "-")
    assert status == 0
    assert read(Topology, printed).digest == read(Topology, topology.read_bytes()).digest
    assert "were rejected" not in said


def test_duplicates_and_disorder_within_the_lateness_change_nothing(
    run: Run, topology: Path
) -> None:
    numbered = [replace(event, boot="b", seq=k) for k, event in enumerate(EVENTS)]
    twice = [copy for event in numbered for copy in (event, event)]
    status, printed, said = run("learn", "-", stdin=lines(twice))
    assert (status, printed) == (0, topology.read_bytes())
    assert f"{len(EVENTS)} of {2 * len(EVENTS)} lines are repeats, counted once" in said

    chance = random.Random(1)
    mixed = sorted(EVENTS, key=lambda event: event.t + chance.uniform(0, 5))
    _, printed, said = run("learn", "-", stdin=lines(mixed))
    assert read(Topology, printed).digest == read(Topology, topology.read_bytes()).digest
    assert "were rejected" not in said


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["learn", "missing.jsonl"], "missing.jsonl"),
        (["learn", "-"], "nothing to learn"),
        (["predict", "TOPOLOGY", "missing.jsonl"], "missing.jsonl"),
        (["predict", "none.json", "-"], "none.json"),
        (["predict", "other.json", "-"], "other.json"),
    ],
)
def test_an_input_that_cannot_be_read(
    arguments: list[str],
    named: str,
    run: Run,
    topology: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("other.json").write_bytes(b'{"schema":"x"}')
    given = [str(topology) if word == "TOPOLOGY" else word for word in arguments]

    status, printed, said = run(*given, stdin=b"\nnonsense\n")

    assert (status, printed) == (exits.INPUT, b"")
    assert named in said


def test_the_links_are_a_table_with_the_weak_ones_last(run: Run, topology: Path) -> None:
    learned = read(Topology, topology.read_bytes())
    links = [one for one in learned.links if one.relation != "visible"]

    status, printed, _ = run("learn", "-", "--table", stdin=lines(EVENTS))

    first, *rows = printed.decode().splitlines()
    assert (status, first.split()[:4]) == (0, ["FROM", "TO", "RELATION", "PROBABILITY"])
    told = {tuple(row.split()[:3]): row for row in rows}
    for link in links:
        assert f"{link.transit.q90:.1f}  q = " in told[link.from_, link.to, link.relation]
    lacking = [" lacks " in row for row in rows]
    assert lacking == sorted(lacking)
    assert len(rows) == len(links) + len(likely_links(learned)) > len(links)


# --- predict ---


def predictions(out: bytes) -> list[Prediction]:
    return [read(Prediction, line) for line in out.splitlines()]


def test_one_prediction_for_each_exit_in_input_order(run: Run, topology: Path) -> None:
    chance = random.Random(3)
    shuffled = EVENTS[:]
    chance.shuffle(shuffled)
    found = {}
    for events in (EVENTS, shuffled):
        status, printed, said = run("predict", topology, "-", stdin=lines(events))
        assert (status, said) == (0, "")
        wanted = [(event.camera, event.t, event.track) for event in events if event.kind == "exit"]
        assert [(p.camera, p.t, p.track) for p in predictions(printed)] == wanted
        for line in printed.splitlines():
            found.setdefault(line, []).append(events is EVENTS)
    assert all(
        sorted(orders) == [False, True] for orders in found.values()
    )  # whatever the order, the same answers


def test_of_a_camera_that_the_topology_has_not_nothing_is_known(
    run: Run, topology: Path, tmp_path: Path
) -> None:
    """The camera may be new; a recording of such cameras alone is of another site."""
    stranger = replace(EVENTS[-1], camera="new")
    for count, expected in ((1, exits.DONE), (50, exits.FAILED)):
        path = tmp_path / "new.jsonl"
        events = [replace(stranger, kind="exit", t=stranger.t + number) for number in range(count)]
        events += [replace(stranger, t=stranger.t + count, kind="entry")]
        path.write_bytes(lines(events))
        for more, answer in ([], b'"zone":null'), (["--walks"], b'"from":[],"new":1.0'):
            status, printed, said = run("predict", topology, str(path), *more)
            assert status == expected
            assert answer in printed
            words = (
                f"{count + 1} of {count + 1} events are of cameras that {topology} does not have"
            )
            assert f"{words} (new)" in said

    few = replace(EVENTS[-1], camera="new", t=EVENTS[-1].t + 1)
    status, _, said = run("predict", topology, "-", stdin=lines([*EVENTS, few]))
    assert status == exits.DONE
    assert f"1 of {len(EVENTS) + 1} events are of cameras that" in said


@pytest.mark.parametrize(("more", "kind"), [([], "exit"), (["--walks"], "entry")])
def test_a_file_without_what_is_asked_for_is_nothing_to_predict(
    more: list[str], kind: str, run: Run, topology: Path, tmp_path: Path
) -> None:
    path = tmp_path / "half.jsonl"
    path.write_bytes(lines([event for event in EVENTS if event.kind != kind]))
    status, printed, said = run("predict", topology, str(path), *more)
    assert (status, printed) == (exits.INPUT, b"")
    assert f"no {kind} lines in {path}: nothing to predict" in said


def test_later_lines_change_no_answer(run: Run, topology: Path) -> None:
    """Answers to the first part of a file do not depend on later lines, also at the same moment."""
    _, whole, _ = run("predict", topology, "-", stdin=lines(EVENTS))
    cut = 333
    first = [event for event in EVENTS if event.t <= EVENTS[cut].t]
    _, part, _ = run("predict", topology, "-", stdin=lines(first))
    assert whole.startswith(part)

    moment = [
        replace(first[-1], kind=kind, camera=camera)
        for kind in ("entry", "exit")
        for camera in ("cam01", "cam02")
    ]
    _, more, _ = run("predict", topology, "-", stdin=lines(moment + first + EVENTS[cut + 50 :]))
    assert set(part.splitlines()) <= set(more.splitlines())


def test_the_likeliest_and_the_sum_of_the_others(run: Run, topology: Path, recording: Path) -> None:
    _, printed, _ = run("predict", topology, recording)
    _, short, _ = run("predict", topology, recording, "--top", "2")

    for all_, few in zip(predictions(printed), predictions(short), strict=True):
        assert few.next == all_.next[:2]
        assert all_.others is None
        assert (few.others is None) == (len(all_.next) <= 2)
        shown = [few.leave, *(one.probability for one in few.next), few.others or 0.0]
        assert sum(shown) == pytest.approx(1.0, abs=1e-9)
    assert any(prediction.others for prediction in predictions(short))


# --- lines ---


def test_one_match_for_each_entry_in_input_order(run: Run, topology: Path) -> None:
    """The order of the lines, of one moment as well, changes no match."""
    order = list(EVENTS)
    random.Random(2).shuffle(order)
    for events in (EVENTS, order):
        status, out, _ = run("predict", topology, "-", "--walks", stdin=lines(events))
        assert status == 0
        matches = [read(Match, line) for line in out.splitlines()]
        entries = [event for event in events if event.kind == "entry"]
        assert [(one.camera, one.t) for one in matches] == [(one.camera, one.t) for one in entries]
        for match in matches:
            assert match.new + sum(one.probability for one in match.from_) == pytest.approx(1.0)
        assert len({match.walk for match in matches}) < len(matches)

    _, out, _ = run("predict", topology, "-", "--walks", "--top", "1", stdin=lines(EVENTS))
    assert max(len(read(Match, line).from_) for line in out.splitlines()) == 1


def test_long_lines_are_skipped_whole(capsys: pytest.CaptureFixture[str]) -> None:
    good = b'{"camera":"a","kind":"exit","t":1}'
    padded = good[:-1] + b',"more":"' + b"m" * (EVENT_BYTES_MAX - len(good) - 10) + b'"}'
    assert len(padded) == EVENT_BYTES_MAX
    too_long = [padded[:-2] + b'm"}', b"x" * 4098, b"y" * 5000, b"z" * 200_000]
    raw = b"\n".join([good, padded, padded + b" ", *too_long, good])
    reader = LineReader()
    found = list(reader.lines("f", io.BytesIO(raw)))
    assert [line.number for line in found] == [1, 2, 3, 8]
    assert reader.rejections == {"too-long": 4}
    assert capsys.readouterr().err.count("f:4:") == 1
    end = LineReader()
    assert list(end.lines("f", io.BytesIO(b"z" * 200_000))) == []
    assert end.rejections == {"too-long": 1}
