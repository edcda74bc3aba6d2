"""`watch` and `web` with several `--site`: one map of all."""

from __future__ import annotations

import json
import re
import subprocess
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest
from serving import camtopod, wait_for
from two_sites import NAMES, OWNERS, TwoSites

from camtopod import codec
from camtopod.cli.main import main
from camtopod.config import District
from camtopod.config.districts_file import to_toml

LEARNED = ("border", "gate", "hall", "ramp", "yard")


@pytest.fixture(scope="module")
def sites(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TwoSites]:
    both = TwoSites(tmp_path_factory.mktemp("sites"), on_one_bus=True)
    with both.running(*NAMES):
        yield both


@pytest.fixture
def districts(tmp_path: Path) -> str:
    """Write the file that says who owns the cameras; return its path."""
    owned = {site: [name for name in OWNERS if OWNERS[name] == site] for site in NAMES}
    table = {
        "north": District(tuple(owned["north"]), ("border",)),
        "south": District(tuple(owned["south"]), ("gate",)),
    }
    path = tmp_path / "districts.toml"
    path.write_text(to_toml(table))
    return str(path)


def options(sites: TwoSites, *names: str) -> list[str]:
    """Return the options with which a command shows these sites."""
    chosen = [part for name in names for part in ("--site", name)]
    return ["--config", "none", "--connect", sites.endpoints["north"], *chosen]


def owners_shown(text: str) -> dict[str, str]:
    """Return the site in the line of each camera."""
    rows = re.findall(r"(?m)^[ !] (north|south) +(\S+) ", text)
    return {camera: site for site, camera in rows if "/" not in camera}


def test_watch_has_a_line_a_camera_with_the_site_that_owns_it(
    sites: TwoSites, districts: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        main([*options(sites, "north", "south"), "watch", "--once", "--districts", districts]) == 0
    )

    text = capsys.readouterr().out
    assert text.startswith("site north, south: daemon running")
    assert f"{len(LEARNED)} cameras" in text
    assert {name: owners_shown(text)[name] for name in LEARNED} == {
        name: OWNERS[name] for name in LEARNED
    }
    assert re.search(r"(?m)^  north +gate/\d+ +border/\d+ +unseen", text)
    assert re.search(r"(?m)^  south +border/\d+ +yard/\d+ +unseen", text)


def test_without_districts_a_camera_is_of_the_first_site_that_has_it(
    sites: TwoSites, capsys: pytest.CaptureFixture[str]
) -> None:
    for names in (("north", "south"), ("south", "north")):
        assert main([*options(sites, *names), "watch", "--once"]) == 0
        assert owners_shown(capsys.readouterr().out)["border"] == names[0]


def test_one_site_is_shown_as_ever(sites: TwoSites, capsys: pytest.CaptureFixture[str]) -> None:
    for names in (("north",), ("north", "north")):
        assert main([*options(sites, *names), "watch", "--once"]) == 0
        text = capsys.readouterr().out
        assert text.startswith("site north: daemon running")
        assert re.search(r"(?m)^[ !] gate ", text)
        assert "SITE" not in text


def test_commands_of_one_site_take_one(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["--site", "north", "--site", "south", "run"])
    assert "run is for one site: only one --site" in capsys.readouterr().err


def test_web_serves_one_page_of_both(sites: TwoSites, districts: str) -> None:
    command = ["web", "--listen", "127.0.0.1:0", "--districts", districts]
    process = camtopod(
        *options(sites, "north", "south"), *command, stderr=subprocess.PIPE, text=True
    )
    assert process.stderr is not None
    try:
        said = ""
        while not (address := re.search(r"the page is at (http://\S+)", said)):
            said = process.stderr.readline()
            assert said, "it has ended"

        def read(path: str) -> bytes:
            with urllib.request.urlopen(address[1] + path, timeout=20) as answer:
                return bytes(answer.read())

        def asked(path: str) -> dict[str, object]:
            return dict(json.loads(read(path)) or {})

        wait_for(lambda: asked("data/map").get("site") == "north, south", "the map")
        cameras = asked("data/map")["cameras"]
        assert isinstance(cameras, dict)
        assert set(LEARNED) <= set(cameras)
        assert asked("data/pair/border/gate")["cameras"] == ["border", "gate"]
        assert asked("data/camera/border")["zones"]
        assert asked("data/health")["live"]
        assert codec.decode_topology(read("api/topology")).site == "north, south"
        answer = asked("api/predict?camera=border&x=0.9&y=0.5")
        assert {one["camera"] for one in answer["next"]} & {"yard", "ramp"}  # type: ignore[attr-defined]
        assert [step["cameras"] for step in json.loads(read("data/growth"))] == [sorted(LEARNED)]
        assert b"border" in read("report.html")
        assert set(asked("data/hours")["hours"]["cameras"]) >= {"gate", "yard"}  # type: ignore[index]
    finally:
        process.terminate()
        assert process.wait(30) == 0
        process.stderr.close()


def test_the_configuration_says_where_sites_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    apart = TwoSites(tmp_path)
    config = tmp_path / "camtopod.toml"
    config.write_text(
        '[site]\nname = "north"\n'
        f'[bus]\nconnect = ["{apart.endpoints["north"]}"]\nconnect_seconds = 1\n'
        f'[sites.south]\nconnect = ["{apart.endpoints["south"]}"]\n'
    )
    command = ["--config", str(config), "--site", "south", "--site", "north", "watch", "--once"]
    with apart.running("north"):
        with apart.running("south"):
            assert main(command) == 0
            assert set(owners_shown(capsys.readouterr().out)) >= set(LEARNED)

        assert main(command) == 0
        said = capsys.readouterr()
        assert said.out.startswith("site south, north: daemon running, south cannot be reached")
        assert "site south: cannot reach the bus at" in said.err
        assert owners_shown(said.out)["gate"] == "north"
