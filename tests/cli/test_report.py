"""`camtopod report`: a web page as one file; `test_web_browser` tests it in a browser."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from pathlib import Path
from typing import Any

import msgspec
import pytest
from synthetic_topology import synthetic_topology

from camtopod import codec
from camtopod.cli import exits, main
from camtopod.records import Topology

SITE = msgspec.structs.replace(synthetic_topology(12), version=3)


def written(tmp_path: Path, *options: str, topology: Topology = SITE) -> str:
    """Write the report on a topology with the command."""
    source, out = tmp_path / "topology.json", tmp_path / "report.html"
    source.write_bytes(codec.to_json(topology))
    assert main.main(["report", str(source), "--out", str(out), *options]) == exits.DONE
    return out.read_text("utf-8")


def held(text: str) -> Any:
    """Return the data in a report."""
    found = re.search(
        r'<script type="application/json" id="report">(.*?)</script>', text, re.DOTALL
    )
    assert found is not None
    return json.loads(found[1])


def test_it_holds_everything_the_page_asks_for(tmp_path: Path) -> None:
    data = held(written(tmp_path))
    assert set(data["cameras"]) == {camera.id for camera in SITE.cameras}
    assert set(data["pairs"]) == set(data["map"]["edges"])
    assert len(data["links"]) == len(SITE.links)
    assert all(details["chart"]["samples"] for details in data["links"].values())
    assert [one["version"] for one in data["versions"]] == [3]


def test_its_policy_lets_this_very_script_run_and_nothing_else(tmp_path: Path) -> None:
    text = written(tmp_path)
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text)
    assert policy is not None
    for tag in ("style", 'script type="module"'):
        content = re.search(f"<{tag}>(.*?)</{tag.split()[0]}>", text, re.DOTALL)
        assert content is not None
        digest = base64.b64encode(hashlib.sha256(content[1].encode()).digest()).decode()
        assert f"{tag.split()[0]}-src 'sha256-{digest}'" in policy[1]
    assert policy[1].startswith("default-src 'none';")
    addresses = set(re.findall(r"https?://[^\"'\s<]+", text))
    assert addresses == {"http://www.w3.org/2000/svg"}, "a name, which nobody asks for anything"


def test_text_in_the_data_cannot_end_its_element(tmp_path: Path) -> None:
    evil = "</script><script>alert(1)</script>"
    text = written(tmp_path, topology=msgspec.structs.replace(SITE, site=evil))
    assert "alert(1)</script>" not in text
    assert held(text)["map"]["site"] == evil


def test_older_versions_are_on_the_time_line_and_compared(tmp_path: Path) -> None:
    updates = tmp_path / "updates.jsonl"
    older = [
        msgspec.structs.replace(SITE, version=version, pairs=SITE.pairs[version:])
        for version in (1, 2)
    ]
    other = msgspec.structs.replace(SITE, epoch="another", version=1)
    updates.write_bytes(b"\n".join(codec.to_json(one) for one in (*older, SITE, other)))
    data = held(written(tmp_path, "--updates", str(updates)))
    assert [one["version"] for one in data["versions"]] == [1, 2, 3]
    first, second, third = data["versions"]
    (gone,) = second["changes"]
    assert (first["since"], second["since"], third["changes_count"]) == (None, 1, 2)
    assert (gone["kind"], gone["now"]) == ("pair", None)


def test_pictures_are_in_it(tmp_path: Path) -> None:
    folder = tmp_path / "pictures"
    folder.mkdir()
    (folder / "cam0001.png").write_bytes(b"a picture")
    data = held(written(tmp_path, "--pictures", str(folder)))
    assert data["pictures"] == {
        "cam0001": "data:image/png;base64," + base64.b64encode(b"a picture").decode()
    }
    assert [name for name, camera in data["cameras"].items() if camera["picture"]] == ["cam0001"]


def test_what_cannot_be_read_or_written_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "topology.json"
    source.write_bytes(codec.to_json(SITE))
    bad = tmp_path / "bad.jsonl"
    bad.write_text("{}\n", "utf-8")
    strange = tmp_path / "strange.json"
    strange.write_bytes(codec.to_json(msgspec.structs.replace(SITE, zones=SITE.zones[1:])))
    for options, status, said in (
        ([str(tmp_path / "none.json")], exits.INPUT, "none.json"),
        ([str(bad)], exits.INPUT, "is not a topology"),
        ([str(strange)], exits.INPUT, f"there is no '{SITE.zones[0].id}' in it"),
        ([str(source), "--updates", str(bad)], exits.INPUT, "line 1 is not a topology"),
        ([str(source), "--updates", str(tmp_path / "none")], exits.INPUT, "cannot read"),
        ([str(source), "--pictures", str(tmp_path / "none")], exits.INPUT, "no such directory"),
        ([str(source), "--out", str(tmp_path / "none" / "x.html")], exits.FAILED, "cannot write"),
    ):
        assert main.main(["report", *options]) == status
        assert said in capsys.readouterr().err
    assert main.main(["report", str(source)]) == exits.DONE
    assert capsys.readouterr().out.startswith("<!doctype html>")
