"""`camtopod score`: links, predictions and matches beside known identities."""

from __future__ import annotations

import json
import random
import re
from pathlib import Path

import pytest

from camtopod import Event, learn_topology, load_topology, scoring
from camtopod.cli import exits
from camtopod.cli.main import main
from camtopod.codec import to_json

GO_ON = 0.7
"""Share of the walkers who go on from the lobby to the hall; the others leave."""


def walkers(count: int, seed: int) -> tuple[list[Event], list[tuple[str, str, str]]]:
    """Return the events of walkers, and camera, track and identity of each passage."""
    chance, t = random.Random(seed), 1_700_000_000.0 + 1e5 * seed
    events, passages = [], []
    for number in range(count):
        t += chance.expovariate(1 / 40)
        views = ["lobby", "hall"] if chance.random() < GO_ON else ["lobby"]
        came = t
        for camera in views:
            left = came + chance.uniform(3, 5)
            for kind, at in (("entry", came), ("exit", left)):
                events.append(Event(camera, kind, at, 0.5, 0.5, str(number)))  # type: ignore[arg-type]
            passages.append((camera, str(number), f"walker {number}"))
            came = left + chance.gauss(8, 1)
    return sorted(events, key=lambda event: event.t), passages


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a topology, and with a later recording and its identities."""
    path = tmp_path_factory.mktemp("score")
    (path / "topology.json").write_bytes(to_json(learn_topology(walkers(300, 1)[0])))
    events, passages = walkers(200, 2)
    (path / "events.jsonl").write_bytes(b"".join(to_json(event) + b"\n" for event in events))
    rows = "".join(f"{','.join(row)}\n" for row in passages)
    (path / "identities.csv").write_text(f"camera,track,identity\n{rows}")
    return path


def score(folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[str, str]:
    names = ("topology.json", "events.jsonl", "identities.csv")
    assert main(["score", *(str(folder / name) for name in names)]) == 0
    captured = capsys.readouterr()
    return captured.out, captured.err


def test_what_was_not_learned_is_scored_beside_the_oracle(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, err = score(folder, capsys)

    assert err == ""
    assert "links between cameras: 1 of 1 true ones found, 0 false; precision 1.00" in out
    scores = {
        name: (float(top1), float(loss))
        for name, top1, loss in re.findall(r"(\w+): top-1 (\S+), log loss (\S+) nats", out)
    }
    assert scores["camtopod"][0] == pytest.approx(scores["oracle"][0], abs=0.02)
    assert 0.3 < scores["oracle"][1] <= scores["camtopod"][1] < scores["oracle"][1] + 0.1
    found = re.search(r"matches: (\d+) of (\d+) entries .*; (\d+) are said .*, (\d+) of", out)
    assert found is not None
    go_on, entries, said, right = map(int, found.groups())
    assert go_on == entries - 200 == pytest.approx(200 * GO_ON, abs=20)
    assert 0.9 * go_on < said < 1.1 * go_on
    assert right > 0.85 * said


def test_a_simulated_site_is_scored_by_the_identities_of_the_simulation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    recording = ["--events", "events.jsonl", "--identities", "identities.csv"]
    assert main(["simulate", "--cameras", "4", "--hours", "0.5", "--seed", "1", *recording]) == 0
    assert main(["learn", "events.jsonl", "--topology", "topology.json"]) == 0
    capsys.readouterr()

    out, err = score(tmp_path, capsys)

    assert "0 false; precision 1.00" in out
    top1 = [float(text) for text in re.findall(r"top-1 (\S+),", out)]
    assert top1[0] > 0.9 * top1[1] > 0.5
    assert "these events were learned" in err


def test_a_wrong_topology_is_seen_to_be_wrong(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("events.jsonl", "topology.json"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    alone = (folder / "identities.csv").read_text().splitlines()
    others = [f"{row} in the {row.partition(',')[0]}" for row in alone[1:]]
    (tmp_path / "identities.csv").write_text("\n".join([alone[0], *others]))

    out, _ = score(tmp_path, capsys)

    assert "0 of 0 true ones found, 1 false; precision 0.00, recall -" in out
    assert "  false: lobby -> hall, 0 times" in out
    assert "0 of them rightly (0.00)" in out


def test_what_was_learned_is_said_to_be_scored_too_well(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    events, passages = walkers(300, 1)
    (tmp_path / "topology.json").write_bytes((folder / "topology.json").read_bytes())
    (tmp_path / "events.jsonl").write_bytes(b"".join(to_json(one) + b"\n" for one in events))
    (tmp_path / "identities.csv").write_text(
        "track,identity\n" + "".join(f"{track},{who}\n" for _, track, who in passages)
    )
    out, err = score(tmp_path, capsys)
    assert "these events were learned" in err
    assert "1 of 1 true ones found" in out


@pytest.mark.parametrize(
    ("text", "mistake"),
    [
        ("track,who\n", "no column identity: its columns are track, who"),
        ("track,identity\nx,y\n", "no track of"),
    ],
)
def test_identities_of_nobody_are_no_score(
    text: str, mistake: str, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "identities.csv"
    path.write_text(text)
    command = ["score", str(folder / "topology.json"), str(folder / "events.jsonl"), str(path)]
    assert main(command) == 66
    assert mistake in capsys.readouterr().err


def test_few_identities_are_said_to_be_few(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "few.csv"
    rows = (folder / "identities.csv").read_text().splitlines(keepends=True)
    path.write_text("".join(rows[: len(rows) // 20]))
    command = ["score", str(folder / "topology.json"), str(folder / "events.jsonl")]
    assert main([*command, str(path)]) == exits.FAILED
    assert re.search(r"only \d+ of \d+ tracks have an identity", capsys.readouterr().err)
    assert main([*command, str(folder / "identities.csv")]) == exits.DONE
    assert "have an identity" not in capsys.readouterr().err


def test_a_topology_of_another_site_is_not_scored(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "other.json"
    path.write_bytes(to_json(learn_topology([Event("elsewhere", "exit", 1.0)])))
    assert (
        main(["score", str(path), str(folder / "events.jsonl"), str(folder / "identities.csv")])
        == 66
    )
    assert "the topology has no camera of the events" in capsys.readouterr().err


def test_what_is_not_there_is_not_scored(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, topology = tmp_path / "some.jsonl", str(folder / "topology.json")
    command = ["score", topology, str(path), str(folder / "identities.csv")]
    path.write_text("")
    assert main(command) == 66
    assert f"no event lines in {path}: nothing to score" in capsys.readouterr().err

    lines = (folder / "events.jsonl").read_text().splitlines(keepends=True)
    path.write_text("".join(line for line in lines if '"exit"' in line))
    assert main(command) == 0
    assert "matches: no entries with an identity to score\n" in capsys.readouterr().out
    path.write_text("".join(line for line in lines if '"entry"' in line))
    assert main(command) == 0
    assert "next camera: no exits with an identity to score\n" in capsys.readouterr().out


def test_identities_that_contradict_each_other_are_refused(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """As of tracks that come in several cameras, without a column for these."""
    path = tmp_path / "identities.jsonl"
    rows = [{"track": -1, "identity": 7}, {"track": "-1", "identity": "7"}]
    for more, said in (
        ({"track": -1, "identity": 8}, "another identity above"),
        ({}, "no track of"),
    ):
        path.write_text("".join(json.dumps(row) + "\n" for row in [*rows, more]))
        names = ("topology.json", "events.jsonl")
        assert main(["score", *(str(folder / name) for name in names), str(path)]) == exits.INPUT
        assert said in capsys.readouterr().err


def test_identities_are_by_camera_and_track(folder: Path) -> None:
    topology = load_topology(folder / "topology.json")
    with pytest.raises(ValueError, match=r"'17' is no key of identities: give \(camera, track\)"):
        scoring.score(topology, [], {"17": "x"})
    with pytest.raises(ValueError, match="there are no events"):
        scoring.score(topology, [], {})
