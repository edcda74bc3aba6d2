"""A configuration that is found without --config: it is named, and its mistakes are."""

from __future__ import annotations

from pathlib import Path

import pytest

from camtopod.cli import exits, implicit_config
from camtopod.cli.main import main

WRONG = '[site]\nname = "hq"\n[bus]\nlisten = 7\n'


@pytest.fixture(autouse=True)
def etc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in a folder of its own; return the place of the second file."""
    work, file = tmp_path / "work", tmp_path / "etc" / "camtopod.toml"
    work.mkdir()
    file.parent.mkdir()
    monkeypatch.chdir(work)
    monkeypatch.setattr(implicit_config, "PLACES", (Path("camtopod.toml"), file))
    return file


def simulated(folder: Path) -> str:
    events = folder / "events.jsonl"
    assert main(["simulate", "--cameras", "2", "--hours", "0.1", "--events", str(events)]) == 0
    return str(events)


def site_learned(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[str, str]:
    """Return the site that `learn` writes, and what it says of configurations."""
    capsys.readouterr()
    assert main([*arguments]) == 0
    out, err = capsys.readouterr()
    said = [line for line in err.splitlines(keepends=True) if ".toml" in line]
    return out.partition('"site":"')[2].partition('"')[0], "".join(said)


def test_the_nearest_is_read_and_named(
    tmp_path: Path, etc: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    learn = ["learn", simulated(tmp_path)]
    assert site_learned(capsys, *learn) == ("site", "")
    etc.write_text('[site]\nname = "far"\n')
    assert site_learned(capsys, *learn) == ("far", f"camtopod: configuration: {etc}\n")
    Path("camtopod.toml").write_text('[site]\nname = "near"\n')
    said = "camtopod: configuration: ./camtopod.toml\n"
    assert site_learned(capsys, *learn) == ("near", said)
    assert site_learned(capsys, "--site", "own", *learn) == ("own", said)
    assert site_learned(capsys, "--config", "none", *learn) == ("site", "")
    assert site_learned(capsys, "--config", str(etc), *learn) == ("far", "")


def test_a_broken_one_is_skipped_where_it_is_not_needed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    learn = ["learn", simulated(tmp_path)]
    Path("camtopod.toml").write_text(WRONG)
    site, said = site_learned(capsys, *learn)
    assert site == "site"
    assert said.startswith("camtopod: ./camtopod.toml has mistakes")
    assert "it is not used" in said
    assert main(["--config", "camtopod.toml", *learn]) == exits.CONFIG, "it was asked for"


@pytest.mark.parametrize(
    "command", [["run"], ["grab"], ["ingest", "jsonl", "x"], ["keys", "list"], ["check"]]
)
def test_a_broken_one_is_named_where_it_is_needed(
    command: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    Path("camtopod.toml").write_text(WRONG)
    assert main(command) == exits.CONFIG
    assert "camtopod.toml:4: bus.listen" in capsys.readouterr().err


def test_one_that_cannot_be_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    learn = ["learn", simulated(tmp_path)]
    Path("camtopod.toml").mkdir()
    site, said = site_learned(capsys, *learn)
    assert (site, "./camtopod.toml cannot be read (Is a directory)" in said) == ("site", True)
    assert main(["grab"]) == exits.INPUT
    assert "cannot read camtopod.toml: Is a directory" in capsys.readouterr().err
