"""The contents of the pages exist: commands, benches, Python lines, tests, files and extras.

Python lines of the client and the bus are tested in `test_client_examples`, what is special to the
pages of deploy/ in `test_deploy`.
"""

from __future__ import annotations

import argparse
import functools
import importlib
import re
import shlex
import tomllib
from pathlib import Path

import numpy
import pytest
import scipy.optimize
from pages import FENCED, PAGES, blocks, invocations, links, shown
from paths import ROOT
from serving import free_endpoint, walkers

import camtopod
from camtopod import client
from camtopod.adapt import FORMATS
from camtopod.cli.main import COMMANDS, parser_of
from camtopod.codec import event_from_json
from camtopod.records import Event

LINES_MAX, COLUMNS_MAX = 170, 100
"""Of README.md: what somebody reads in five minutes, as wide as the code."""
TEXTS = {str(page.relative_to(ROOT)): page.read_text() for page in PAGES}
README = TEXTS["README.md"]
ALL = "\n".join(TEXTS.values())
PLACEHOLDERS = {
    "camtopod COMMAND --help": "camtopod learn events.jsonl",
    "camtopod schema NAME": "camtopod schema event",
    "--format F": "--format dot",
    "camtopod ingest FORMAT [FILE]": "camtopod ingest jsonl FILE",
    "camtopod keys init\\|camera NAME\\|list": "camtopod keys init; camtopod keys camera NAME; camtopod keys list",
}
"""A placeholder, and an example of what it stands for."""
PYTHON = [(page, block) for page, text in TEXTS.items() for block in blocks(text, "python")]


def block_with(text: str) -> str:
    [found] = [block for _, block in PYTHON if text in block]
    return found


def ids(page: Path) -> str:
    return str(page.relative_to(ROOT))


# --- form -----------------------------------------------------------------------------------------


def test_readme_is_short() -> None:
    lines = README.splitlines()
    assert len(lines) <= LINES_MAX
    assert [line for line in lines if len(line) > COLUMNS_MAX and line[0] != "|"] == []


def test_every_page_is_listed() -> None:
    found = {
        path
        for folder in ("bench", "camtopod", "deploy", "tests")
        for path in (ROOT / folder).rglob("*.md")
    }

    assert found | {ROOT / "README.md"} == set(PAGES)


@pytest.mark.parametrize("page", PAGES, ids=ids)
def test_every_link_leads_to_a_file(page: Path) -> None:
    for target in links(page.read_text()):
        path, _, heading = target.partition("#")
        file = (page.parent / path) if path else page
        assert file.exists(), target
        if heading:
            headings = re.findall(r"^#+ (.*)$", FENCED.sub("", file.read_text()), re.MULTILINE)
            anchors = [re.sub(r"[^\w -]", "", one.lower()).replace(" ", "-") for one in headings]
            assert heading in anchors, target


def test_every_page_can_be_reached_from_readme() -> None:
    reached, waiting = set(), [ROOT / "README.md"]
    while waiting:
        page = waiting.pop()
        reached.add(page)
        targets = (page.parent / target.partition("#")[0] for target in links(page.read_text()))
        pages = (target.resolve() for target in targets if target.suffix == ".md")
        waiting += [target for target in pages if target not in reached]

    assert reached >= set(PAGES)


# --- commands -------------------------------------------------------------------------------------


def test_every_command_exists() -> None:
    parser, _ = parser_of(COMMANDS)
    seen, replaced = set(), set()
    for page, text in TEXTS.items():
        for line in shown(text):
            meant = line
            for placeholder, example in PLACEHOLDERS.items():
                if placeholder in meant:
                    meant = meant.replace(placeholder, example)
                    replaced.add(placeholder)
            if name := re.fullmatch(r"(?:\S*/)?camtopod( \w+)?", meant):
                assert name[1] is None or name[1][1:] in COMMANDS, f"{page}: {line}"
                continue
            if "camtopod" not in meant:
                continue
            for arguments in invocations(meant):
                try:
                    seen.add(parser.parse_args(arguments).command)
                except SystemExit as end:  # 0: an option that prints and ends
                    if end.code != 0:
                        pytest.fail(f"{page}: {line}")

    assert replaced == set(PLACEHOLDERS)
    assert seen == set(COMMANDS)


def test_every_command_is_in_the_table() -> None:
    cells = re.findall(r"^\| (`camtopod \w.*?`) \|", TEXTS["deploy/commands.md"], re.MULTILINE)
    named = [name for cell in cells for name in re.findall(r"`camtopod (\w+)", cell)]

    assert sorted(named) == sorted(COMMANDS)
    assert set(re.findall(r"`camtopod (\w+)`", ALL)) <= set(COMMANDS)


def test_every_bench_takes_what_it_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    """None is run: each ends after parsing its arguments."""

    class Read(Exception):
        pass

    def read_only(parser: argparse.ArgumentParser, given: list[str]) -> None:
        assert parse(parser, given)
        raise Read

    parse = argparse.ArgumentParser.parse_args
    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", read_only)
    lines = [line for text in TEXTS.values() for line in shown(text)]
    benches = {found for line in lines for found in re.findall(r"\bbench (\w+)([^`]*)", line)}
    assert len(benches) > 15
    for part, options in benches:
        main = importlib.import_module(f"bench.{part}").main
        given = options.split(" #")[0].replace("{hall,crowd,walkway,road}", "hall")
        if given.strip():
            with pytest.raises(Read):
                main(shlex.split(given))


# --- names ----------------------------------------------------------------------------------------


def test_every_test_exists() -> None:
    tests = {path.stem for path in ROOT.glob("tests/**/test_*.py")}
    named = set(re.findall(r"\b(test_\w+?)(?:\.py)?\b(?!\()", ALL))

    assert len(named) > 25
    functions = {
        name
        for path in ROOT.glob("tests/**/test_*.py")
        for name in re.findall(r"^def (test_\w+)", path.read_text(), re.MULTILINE)
    }
    assert named - tests - functions == set()


@pytest.mark.parametrize("page", PAGES, ids=ids)
def test_every_file_exists(page: Path) -> None:
    """A path is relative to the checkout, a module's file to its page."""
    text = page.read_text()
    for path in re.findall(r"(?<![\w/.-])((?:tests|deploy|bench|camtopod)/[\w./@-]*\w)", text):
        if not path.startswith("deploy/site"):
            assert list(ROOT.glob(f"{path}*")), path


@pytest.mark.parametrize("page", ["camtopod/ARCHITECTURE.md", "camtopod/learn/METHOD.md"])
def test_every_module_exists(page: str) -> None:
    """`folder/module` is below the package, or below the page's own folder."""
    named = set(re.findall(r"`([a-z_]+/[a-z_/]*[a-z_])(?:[.]\w+)?`", TEXTS[page]))
    named = {name for name in named if not name.startswith(("tests/", "bench/", "deploy/"))}

    assert len(named) > 10
    bases = (ROOT / "camtopod", (ROOT / page).parent)
    found = {
        name
        for name in named
        for base in bases
        if (base / f"{name}.py").exists() or (base / name / "__init__.py").exists()
    }
    assert named - found - {"topology/delta"} == set()


def test_architecture_lists_every_package() -> None:
    listed = blocks(TEXTS["camtopod/ARCHITECTURE.md"], "text")[0]
    folders = {path.parent.name for path in (ROOT / "camtopod").rglob("__init__.py")}

    assert folders - {"camtopod"} == set(re.findall(r"(?<![\w/.])([a-z_]+)/", listed)) - {
        "camtopod",
        "static",
    }
    shared = {path.stem for path in (ROOT / "camtopod").glob("*.py")} - {"__init__", "__main__"}
    assert shared <= set(re.findall(r"\b([a-z_]+)\b", listed))


def test_every_format_has_an_example() -> None:
    page = TEXTS["deploy/integrations.md"]
    assert {name for name in FORMATS if f"camtopod ingest {name} " not in page} == set()


def test_every_extra_exists() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = set(project["optional-dependencies"])
    asked = {extra for some in re.findall(r"'\.\[([\w,]+)\]'", ALL) for extra in some.split(",")}

    assert {"test", "web", "keys", "bench", "dev", "examples", "metrics", "mqtt"} <= asked
    assert asked <= extras
    packages = TEXTS["deploy/commands.md"].split("\n## Packages\n")[1].split("\n## ")[0]
    assert set(re.findall(r"`\[(\w+)\]`", packages)) == extras


# --- lines of Python and JSON ---------------------------------------------------------------------


def test_the_line_that_is_all_of_a_camera() -> None:
    [line] = blocks(README, "json")
    assert event_from_json(line) == Event("lobby", "entry", 1700000000.25, 0.31, 0.88, "17")


def test_every_block_of_python_compiles_and_is_run_by_some_test() -> None:
    for page, block in PYTHON:
        compile(block, page, "exec")
    assert len(PYTHON) == 5


def test_tracks_are_handed_over_without_a_daemon() -> None:
    events = walkers(200)
    names = {"camtopod": camtopod, "numpy": numpy, "scipy": scipy, "events": events}
    for kind, name in (("exit", "exits"), ("entry", "entries")):
        names[name] = [event for event in events[-60:] if event.kind == kind]
    exec(block_with("Gate("), names)
    assert len(names["pairs"]) > 5
    assert all(
        names["exits"][row].camera != names["entries"][column].camera
        for row, column in names["pairs"]
    )


def test_a_tracker_s_boxes_are_published(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A person crosses an empty picture in four seconds."""
    events: list[Event] = []

    class Recording(client.Publisher):
        def publish(self, *further: Event) -> None:
            events.extend(further)
            super().publish(*further)

    recording = functools.partial(Recording, connect=free_endpoint(), state=tmp_path)
    monkeypatch.setattr(client, "Publisher", recording)

    before, after = ([(k / 10, [], []) for k in some] for some in (range(20), range(60, 120)))
    there = [(k / 10, [7], [(48 * k - 960, 400, 48 * k - 860, 900)]) for k in range(20, 60)]
    exec(block_with("your_tracker"), {"your_tracker": [*before, *there, *after]})
    assert [(event.camera, event.kind, event.t) for event in events] == [
        ("lobby", "entry", 2.0),
        ("lobby", "exit", 5.9),
    ]
    assert len({event.track for event in events}) == 1
    with recording("lobby") as again:
        assert again.waiting == 2, "no daemon was there"


def test_no_message_sends_to_the_readme_which_a_package_has_not() -> None:
    for path in (ROOT / "camtopod").rglob("*.py"):
        assert "see README" not in " ".join(path.read_text().split()).replace('" "', ""), path
