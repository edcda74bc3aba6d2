"""What README shows is there: its commands, its lines of Python, the tests, files and extras it
names.
"""

from __future__ import annotations

import argparse
import importlib
import re
import shlex
import tomllib

import pytest
from pages import FENCED, invocations
from paths import ROOT
from serving import numbered, walkers

from camtopod.cli.main import COMMANDS, parser_of
from camtopod.codec import event_from_json
from camtopod.learn.learner import Learner
from camtopod.records import Event

README = (ROOT / "README.md").read_text()
PLACEHOLDERS = {
    "camtopod COMMAND --help": "camtopod learn events.jsonl",
    "camtopod completion SHELL": "camtopod completion zsh",
    "camtopod export TOPOLOGY.json --format F": "camtopod export TOPOLOGY.json --format dot",
    "camtopod ingest FORMAT [FILE]": "camtopod ingest jsonl FILE",
    "camtopod keys init\\|camera NAME\\|list": "camtopod keys init; camtopod keys camera NAME; camtopod keys list",
    "$(($(date +%s) - 3600))": "1700000000",
}
"""What stands for something else, and something that it stands for."""
BLOCKS = [block for language, block in FENCED.findall(README) if language == "python"]


def lines() -> list[str]:
    """Every line that is set as code, and every command between backquotes that has more than its
    name.
    """
    prose = FENCED.sub("", README)
    shown = [line.strip() for line in prose.splitlines() if line.startswith("    ")]
    quoted = [" ".join(text.split()) for text in re.findall(r"`([^`]+)`", prose)]
    return shown + [text for text in quoted if re.match(r"camtopod\s+\S+\s", text)]


def block_with(text: str) -> str:
    [found] = [block for block in BLOCKS if text in block]
    return found


def test_every_command_exists() -> None:
    parser, _ = parser_of(COMMANDS)
    seen, stood_for = set(), set()
    for line in lines():
        meant = line
        for placeholder, one in PLACEHOLDERS.items():
            if placeholder in meant:
                meant = meant.replace(placeholder, one)
                stood_for.add(placeholder)
        for arguments in invocations(meant):
            try:
                seen.add(parser.parse_args(arguments).command)
            except SystemExit:
                pytest.fail(line)
    assert stood_for == set(PLACEHOLDERS)
    assert set(COMMANDS) - seen == {"doctor"}, (
        "named without an argument, as are those in the table"
    )
    named = set(re.findall(r"`camtopod (\w+)`", README))
    assert named <= set(COMMANDS)
    assert seen | named == set(COMMANDS)


def test_every_bench_takes_what_it_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    """None is run: it ends where it has read its arguments."""

    class Read(Exception):
        pass

    def read_only(parser: argparse.ArgumentParser, given: list[str]) -> None:
        assert parse(parser, given)
        raise Read

    parse = argparse.ArgumentParser.parse_args
    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", read_only)
    shown = set(re.findall(r"`(?:python -m )?bench (\w+)([^`]*)`", README))
    assert len(shown) > 10
    for part, options in shown:
        main = importlib.import_module(f"bench.{part}").main
        if options:
            with pytest.raises(Read):
                main(shlex.split(options))


def test_every_test_file_and_extra_exists() -> None:
    tests = {path.stem for path in ROOT.glob("tests/**/test_*.py")}
    named = set(re.findall(r"\b(test_\w+)", README))
    assert len(named) > 15
    assert named - tests == set()
    for path in re.findall(r"\b((?:tests|deploy|bench)/[\w./-]*\w)", README):
        assert (ROOT / path).exists(), path
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    asked = {extra for some in re.findall(r"'\.\[([\w,]+)\]'", README) for extra in some.split(",")}
    assert asked == {"test", "web", "keys", "bench"}
    assert asked <= set(extras)
    assert set(
        re.findall(r"`\[(\w+)\]`", README.split("\n## Packages\n")[1].split("\n## ")[0])
    ) == set(extras)


def test_the_line_that_is_all_of_a_camera() -> None:
    [line] = [block for language, block in FENCED.findall(README) if language == "json"]
    assert event_from_json(line) == Event("lobby", "entry", 1700000000.25, 0.31, 0.88, "17")


# --- the lines of Python: those of the client and of the bus are in test_client_examples
# ---------------


def test_there_are_four_blocks() -> None:
    for block in BLOCKS:
        compile(block, "README.md", "exec")
    assert len(BLOCKS) == 4


def test_a_tracker_s_boxes_become_event_lines(capsys: pytest.CaptureFixture[str]) -> None:
    """Somebody crosses an empty picture in four seconds."""
    before, after = ([(k / 10, [], []) for k in some] for some in (range(20), range(60, 120)))
    there = [(k / 10, [7], [(48 * k - 960, 400, 48 * k - 860, 900)]) for k in range(20, 60)]
    exec(block_with("your_tracker"), {"your_tracker": [*before, *there, *after]})
    events = [event_from_json(line) for line in capsys.readouterr().out.splitlines()]
    assert [(event.camera, event.kind, event.t) for event in events] == [
        ("lobby", "entry", 2.0),
        ("lobby", "exit", 5.9),
    ]
    assert len({event.track for event in events}) == 1


def test_the_learner_s_surface_is_as_shown() -> None:
    block = block_with("learner.receive(event)")
    left = Event("a", "exit", walkers(1)[0].t, 0.9, 0.5)
    names = {"events": numbered(walkers(200)), "an_exit": left}
    exec(block, names)
    learner = names["learner"]
    assert isinstance(learner, Learner)
    assert learner.topology is not None
    assert {pair.cameras for pair in learner.topology.pairs} == {("a", "b"), ("a", "c")}
    assert {one.camera for one in learner.predictor().predict(left).next_[:2]} == {"b", "c"}
    assert learner.settings.lateness_seconds == 5.0
    live = re.search(r"# or, live: (.*)", block)
    assert live is not None
    for call in live[1].split(", "):
        eval(f"learner.{call}", {"learner": learner, "now": left.t})
    answers = re.findall(r'"(\w+)"', block.split("learner.receive(event)")[1].split("\n")[0])
    assert len(answers) == 4
    assert set(answers) <= set(learner.statistics())
