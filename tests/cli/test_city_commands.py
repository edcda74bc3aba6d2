"""`camtopod districts` and `camtopod merge`, and what other commands make of a city."""

from __future__ import annotations

import io
import json
import sys
import tomllib
from pathlib import Path

import pytest
from city_parts import CITY, DISTRICTS, OWNERS, part_of

from camtopod import load_topology
from camtopod.cli.main import main
from camtopod.codec import to_json
from camtopod.config import districts_file, owners_of
from camtopod.records import Event


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working folder, with a topology, its districts and their topologies."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "whole.json").write_bytes(to_json(CITY))
    (tmp_path / "districts.toml").write_text(districts_file.to_toml(DISTRICTS))
    for site in DISTRICTS:
        (tmp_path / f"{site}.json").write_bytes(to_json(part_of(site)))
    return tmp_path


def typed(content: bytes) -> io.TextIOWrapper:
    """Return a standard input with a content."""
    return io.TextIOWrapper(io.BufferedReader(io.BytesIO(content)))  # type: ignore[arg-type]


@pytest.fixture
def city(folder: Path) -> Path:
    arguments = ["north.json", "south.json", "--districts", "districts.toml"]
    assert main(["merge", *arguments, "--out", "city.json", "--site", "town"]) == 0
    return folder


def test_a_topology_is_cut_into_districts(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["districts", "whole.json", "--cameras-max", "10", "--out", "cut.toml"]) == 0

    districts = districts_file.load(folder / "cut.toml")
    assert owners_of(districts).keys() == OWNERS.keys()
    assert max(len(district.cameras) for district in districts.values()) <= 10
    assert f"{len(districts)} districts of up to" in capsys.readouterr().err
    assert main(["check", "cut.toml"]) == 0
    out, err = capsys.readouterr()
    assert f"{len(districts)} districts, 24 cameras" in err
    cameras = tomllib.loads(out)["cameras"]
    assert cameras.keys() == {heard for one in districts.values() for heard in one.hears}


def test_events_are_cut_by_the_links_that_they_tell(folder: Path) -> None:
    simulation = ["--cameras", "16", "--hours", "0.25", "--seed", "3"]
    assert main(["simulate", *simulation, "--events", "e.jsonl", "--truth", "t.json"]) == 0

    assert main(["districts", "e.jsonl", "--cameras-max", "10", "--out", "cut.toml"]) == 0

    owners = owners_of(districts_file.load(folder / "cut.toml"))
    truth = json.loads((folder / "t.json").read_text())
    pairs = [pair["cameras"] for pair in truth["pairs"]]
    assert owners.keys() == {*truth["cameras"]}
    assert sum(owners[a] == owners[b] for a, b in pairs) > 0.6 * len(pairs)


def test_events_may_come_from_standard_input_and_enough_of_them_must_be_valid(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    simulation = ["--cameras", "12", "--hours", "0.1", "--seed", "3"]
    assert main(["simulate", *simulation, "--events", "e.jsonl", "--truth", "t.json"]) == 0
    assert main(["districts", "e.jsonl", "--out", "cut.toml"]) == 0
    with (folder / "e.jsonl").open("ab") as file:
        file.write(b"no event\n" * 1000)

    monkeypatch.setattr(sys, "stdin", typed((folder / "e.jsonl").read_bytes()))
    assert main(["districts", "-", "--out", "again.toml"]) == 1
    assert "1000 of " in capsys.readouterr().err

    assert (folder / "again.toml").read_text() == (folder / "cut.toml").read_text()


def test_a_table_says_where_to_cut(folder: Path) -> None:
    rows = "".join(f"{camera},{owner}\n" for camera, owner in OWNERS.items())
    (folder / "table.csv").write_text(f"camera,district\n{rows}")

    assert main(["districts", "whole.json", "--table", "table.csv", "--out", "cut.toml"]) == 0

    assert districts_file.load(folder / "cut.toml") == DISTRICTS


@pytest.mark.parametrize(
    ("table", "sentence"),
    [
        ("camera,district\ncam0000,a\n", "has no district for cam0001, cam0002"),
        ("camera,district\ncam0000,a\ncam0000,b\n", "table.csv:3: cam0000 has two districts"),
        ("camera,district\n,a\n", "table.csv:2: Object missing required field `camera`"),
        ("camera,district\n" + "".join(f"{c},a/b\n" for c in OWNERS), "a name is 1 to 64 of"),
        ("name,place\nx,y\n", "camera"),
    ],
)
def test_a_wrong_table_is_refused(
    folder: Path, capsys: pytest.CaptureFixture[str], table: str, sentence: str
) -> None:
    (folder / "table.csv").write_text(table)

    assert main(["districts", "whole.json", "--table", "table.csv"]) == 66

    captured = capsys.readouterr()
    assert captured.out == ""
    assert sentence in captured.err


def test_without_the_extra_a_sentence_says_what_is_missing(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delitem(sys.modules, "camtopod.city.partition", raising=False)
    monkeypatch.setitem(sys.modules, "pymetis", None)

    assert main(["districts", "whole.json"]) == 1

    assert "needs the package 'pymetis', which is not installed" in capsys.readouterr().err


def test_a_city_is_merged_and_exported_as_one_map(city: Path) -> None:
    town = load_topology(city / "city.json")
    assert (town.site, town.links, town.owners) == ("town", CITY.links, OWNERS)

    for path in ("city", "whole"):
        export = ["export", f"{path}.json", "--format", "dot", "--out", f"{path}.dot"]
        assert main(export) == 0
    texts = [(city / f"{path}.dot").read_text().partition("\n") for path in ("city", "whole")]
    assert [line for line in texts[0][2].split("\n") if 'label="town' not in line] == [
        line for line in texts[1][2].split("\n") if 'label="mall' not in line
    ]
    assert main(["report", "city.json", "--out", "city.html"]) == 0
    assert main(["districts", "city.json", "--cameras-max", "12", "--out", "again.toml"]) == 0


def test_predictions_and_matches_are_those_of_the_owner(
    city: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cameras = {site: part_of(site).cameras for site in DISTRICTS}
    events = [
        Event(camera, kind, 1_700_000_000.0 + 7 * number, 0.1, 0.5, str(number))  # type: ignore[arg-type]
        for number, camera in enumerate(OWNERS)
        for kind in ("entry", "exit")
    ]
    for options in ([], ["--walks"]):
        lines = {}
        for name in ("city", *DISTRICTS):
            names = [camera.id for camera in cameras.get(name, CITY.cameras)]
            heard = [event for event in events if event.camera in names]
            (city / "e.jsonl").write_bytes(b"".join(to_json(event) + b"\n" for event in heard))
            assert main(["predict", *options, f"{name}.json", "e.jsonl"]) == 0
            lines[name] = capsys.readouterr().out.splitlines()
        assert len(lines["city"]) == len(OWNERS)
        for site in DISTRICTS:
            own = [x for x in lines["city"] if OWNERS[json.loads(x)["camera"]] == site]
            assert own == [x for x in lines[site] if OWNERS[json.loads(x)["camera"]] == site]


def test_a_city_is_scored(city: Path, capsys: pytest.CaptureFixture[str]) -> None:
    events, rows = [], "track,identity\n"
    for number in range(20):
        for step, camera in enumerate(("cam0000", "cam0001")):
            for kind in ("entry", "exit"):
                t = 1_700_000_000.0 + 60 * number + 10 * step + (kind == "exit")
                events.append(Event(camera, kind, t, 0.5, 0.5, f"{camera}-{number}"))  # type: ignore[arg-type]
            rows += f"{camera}-{number},walker {number}\n"
    (city / "e.jsonl").write_bytes(b"".join(to_json(event) + b"\n" for event in events))
    (city / "i.csv").write_text(rows)

    assert main(["score", "city.json", "e.jsonl", "i.csv"]) == 0

    assert "next camera of " in capsys.readouterr().out


def test_what_is_no_city_is_refused(city: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["merge", "north.json", "--districts", "districts.toml"]
    assert main(arguments) == 1
    assert "of the site south there are 0 topologies" in capsys.readouterr().err

    (city / "south.json").write_text('{"schema": "camtopod/topology/9"}')
    assert main(["merge", "north.json", "south.json", "--districts", "districts.toml"]) == 66
    assert "south.json is not a topology" in capsys.readouterr().err

    (city / "districts.toml").write_text('[districts.north]\ncameras = ["a", "a/b"]\n')
    assert main(arguments) == 78
    assert "districts.toml:2: districts.north.cameras" in capsys.readouterr().err
    assert main(["check", "districts.toml"]) == 78
