"""The command dispatcher: commands, common options, exit statuses, no traceback."""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import re
import subprocess
import sys
import types
from pathlib import Path
from typing import Any

import pytest
from paths import ROOT
from serving import camtopod, walkers

from camtopod.cli import exits, main
from camtopod.cli.common import configuration, start_logging
from camtopod.cli.exits import CommandError, InputError
from camtopod.codec import to_json
from camtopod.config import Config, config_file
from camtopod.serve.storage.journal import Journal


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    """Add a command ``probe`` which keeps its arguments and calls ``act``."""
    module = types.ModuleType("camtopod.cli.commands.probe")
    module.seen = []  # type: ignore[attr-defined]
    module.act = lambda args: 0  # type: ignore[attr-defined]

    def add_parser(add: Any) -> None:
        add().add_argument("word", nargs="?")

    def run(args: argparse.Namespace) -> int:
        module.seen.append(args)
        return int(module.act(args))

    module.add_parser, module.run = add_parser, run  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "camtopod.cli.commands.probe", module)
    monkeypatch.setitem(main.COMMANDS, "probe", "for this test")
    return module


def test_help_names_every_command_and_is_quick_to_load(capsys: pytest.CaptureFixture[str]) -> None:
    def help_of(*command: str) -> str:
        with pytest.raises(SystemExit) as caught:
            main.main([*command, "--help"])
        assert caught.value.code == 0
        return capsys.readouterr().out

    whole = help_of()
    for name in main.COMMANDS:
        assert re.search(rf"(?m)^    {name}\b", whole)
        text = help_of(name)
        assert "--connect ENDPOINT" in text
        assert re.search(rf"example: camtopod .*\b{name}\b", text)
    script = (
        "import sys; sys.argv = ['camtopod', '--help']\n"
        "from camtopod.cli.main import main\n"
        "try: main()\nexcept SystemExit: pass\n"
        "heavy = {'numpy', 'scipy', 'cv2', 'zenoh', 'sqlite3', 'msgspec'} & set(sys.modules)\n"
        "assert not heavy, heavy"
    )
    subprocess.run([sys.executable, "-c", script], check=True, stdout=subprocess.DEVNULL, cwd=ROOT)


def test_completion_by_shtab(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(SystemExit) as caught:
        main.main(["--print-completion", "bash"])
    assert caught.value.code == 0
    script = capsys.readouterr().out
    complete = "COMP_WORDS=(camtopod grab --rea); COMP_CWORD=2; _shtab_camtopod camtopod --rea grab"
    offered = subprocess.run(
        ["bash", "-c", f'{script}\n{complete}; echo "${{COMPREPLY[@]}}"'],
        check=True,
        capture_output=True,
        text=True,
    )
    assert offered.stdout.split() == ["--realtime"]

    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main.main(["--print-completion", "zsh"]) == exits.FAILED
    assert "needs the package 'shtab'" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments", [[], ["nonsense"], ["probe", "--nonsense"], ["--log-format", "xml", "probe"]]
)
def test_usage(
    arguments: list[str], command: types.ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main.main(arguments)
    assert caught.value.code == exits.USAGE
    out, err = capsys.readouterr()
    assert out == ""
    begins = re.findall(r"(?m)^    camtopod (\w+)", err)
    assert begins == ([] if arguments else ["demo", "init", "up"])


def test_common_options_stand_before_or_after_the_command(command: types.ModuleType) -> None:
    options = ["--site=hq", "--connect=tcp/a:1", "--connect", "tcp/b:2", "--log-format", "json"]
    assert main.main([*options, "probe", "w"]) == 0
    assert main.main(["probe", "w", *options]) == 0
    assert main.main(["--site", "hq", "probe", "w"]) == 0

    before, after, few = command.seen
    assert vars(before) == vars(after)
    assert (before.site, before.connect) == ("hq", ["tcp/a:1", "tcp/b:2"])
    assert (before.log_format, before.word) == ("json", "w")
    assert (few.config, few.connect, few.log_format) == (None, [], "text")


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (CommandError("no good"), 1, "no good"),
        (InputError("cannot read x"), 66, "cannot read x"),
        (CommandError("no bus", exits.BUS), 69, "no bus"),
        (
            FileNotFoundError(2, "No such file or directory", "x.jsonl"),
            66,
            "cannot read x.jsonl: No such file",
        ),
        (OSError("rtsp://a:p@ss@h failed"), 1, "rtsp://***@h failed"),
        (ModuleNotFoundError(name="zenoh"), 1, "probe needs the package 'zenoh', which is not"),
        (KeyboardInterrupt(), 1, "interrupted"),
        (BrokenPipeError(), 1, ""),
    ],
)
def test_expected_errors_become_statuses(
    error: BaseException,
    status: int,
    said: str,
    command: types.ModuleType,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(args: argparse.Namespace) -> int:
        raise error

    command.act = fail  # type: ignore[attr-defined]
    monkeypatch.setattr(main.os, "dup2", lambda *given: None)
    assert main.main(["probe"]) == status
    out, err = capfd.readouterr()
    assert out == ""
    assert said in err
    assert "Traceback" not in err


def test_a_reader_that_goes_away_is_no_error_message() -> None:
    process = camtopod("check", "--example", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.close()
    _, err = process.communicate(timeout=30)
    assert (process.returncode, err) == (1, b"")


# --- check, and the configuration with the common options on top ----------------------------------


def test_check(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good, bad = tmp_path / "good.toml", tmp_path / "bad.toml"
    good.write_text('[site]\nname = "hq"\n')
    bad.write_text('[site]\nnmae = "hq"\n[learn]\nwindow_hours = "x"\n')
    assert main.main(["check", str(good)]) == 0
    assert main.main(["--config", str(good), "check"]) == 0
    assert capsys.readouterr().out == ""
    assert main.main(["check", str(bad)]) == 78
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == [
        f"{bad}:2: site.nmae: no such key; did you mean 'name'?",
        f"{bad}:4: learn.window_hours: expected a number, got a string",
    ]
    assert main.main(["check", str(tmp_path / "none.toml")]) == 66
    assert main.main(["check"]) == 2
    capsys.readouterr()
    assert main.main(["check", "--example"]) == 0
    config_file.parse(capsys.readouterr().out)


def test_check_says_what_holds_for_each_camera(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "c.toml"
    path.write_text(
        "[vision]\nanalysed_fps = 9\n[cameras.a]\nsource = '0'\nanalysed_fps = 7\ndoors = [[0.5, 0.5]]\n"
        "ignore = [[[0, 0], [0.5, 0], [0.5, 1], [0, 1]]]\n[cameras.b]\nmin_height = 0.1\n"
        "sites = ['site', 'annex']\n[sites.annex]\nconnect = ['tcp/h:1']\n"
    )
    assert main.main(["check", str(path)]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "authentication" not in line]
    assert lines == [
        f"{path}:8: warning: cameras.b: source is missing; add it, or source_file, or grab this"
        " camera with `camtopod grab --camera b SOURCE`",
        f"{path}:3: cameras.a: ignore: 1, doors: 1",
        f"{path}:8: cameras.b: analysed_fps = 9.0, min_height = 0.1, delivers to site, annex",
        f"{path}: no mistakes; site site, 2 cameras",
    ]


def test_a_source_that_no_program_reads_is_a_mistake(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "camtopod.toml"
    sources = ("rstp://192.0.2.1/a", "onvif://192.0.2.1", "rtsp://192.0.2.1/a", "film.mp4", "0")
    path.write_text("".join(f'[cameras.c{n}]\nsource = "{s}"\n' for n, s in enumerate(sources)))
    assert main.main(["check", str(path)]) == exits.CONFIG
    wrong, only_init = capsys.readouterr().err.splitlines()
    assert wrong.startswith(f"{path}:2: cameras.c0.source: rstp:// is none of rtsp, rtsps,")
    assert only_init.startswith(f"{path}:4: cameras.c1.source: `camtopod init` asks")


def arguments(**given: Any) -> argparse.Namespace:
    return argparse.Namespace(
        **{"config": None, "site": None, "connect": [], "log_format": "text", **given}
    )


def test_the_command_line_is_on_top_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "c.toml"
    path.write_text(
        '[site]\nname = "hq"\n[bus]\nlisten = ["tcp/0.0.0.0:7000"]\n[state]\ndirectory = "/x"\n'
    )
    assert configuration(arguments(config=path)).site.name == "hq"
    loaded = configuration(arguments(config=path, site="lab", connect=["tcp/h:1"], state="/y"))
    assert (loaded.site.name, loaded.dials, loaded.listens) == ("lab", ("tcp/h:1",), ())
    assert loaded.state_directory == Path("/y")
    assert configuration(arguments()) == Config()


@pytest.mark.parametrize(
    ("given", "status"),
    [
        ({"site": "a/b"}, 2),
        ({"connect": ["localhost"]}, 2),
        ({"config": Path("/nonexistent/c.toml")}, 66),
        ({"config": Path(__file__)}, 78),
    ],
)
def test_a_wrong_common_option(given: dict[str, Any], status: int) -> None:
    with pytest.raises(CommandError) as caught:
        configuration(arguments(**given))
    assert caught.value.status == status


def test_a_configuration_that_is_found_is_named_and_its_mistakes_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    near = Path("camtopod.toml")
    far = tmp_path / "etc.toml"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(main, "PLACES", (near, far))
    events = ["learn", str(tmp_path / "e.jsonl")]
    Path(events[1]).write_bytes(b"".join(to_json(one) + b"\n" for one in walkers(20)))

    def learned(*options: str) -> tuple[str, list[str]]:
        """Return the site of what is learned, and what is said of configurations."""
        assert main.main([*options, *events]) == exits.DONE
        out, err = capsys.readouterr()
        return json.loads(out)["site"], [line for line in err.splitlines() if "toml" in line]

    assert learned() == ("site", [])
    far.write_text('[site]\nname = "far"\n')
    assert learned() == ("far", [f"camtopod: configuration: {far}"])
    near.write_text('[site]\nname = "near"\n')
    assert learned("--site", "own") == ("own", ["camtopod: configuration: camtopod.toml"])
    assert learned("--config", str(far)) == ("far", [])
    near.write_text("[bus]\nlisten = 7\n")
    assert learned("--config", "none") == ("site", [])
    for command in (
        events,
        ["run"],
        ["grab"],
        ["ingest", "jsonl", "x"],
        ["keys", "list"],
        ["check"],
    ):
        assert main.main(command) == exits.CONFIG
        assert "camtopod.toml:2: bus.listen" in capsys.readouterr().err
    near.unlink()
    near.mkdir()
    assert main.main(["run"]) == exits.INPUT
    assert "cannot read camtopod.toml: Is a directory; --config none" in capsys.readouterr().err


def test_where_the_state_is(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("STATE_DIRECTORY", "XDG_STATE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("HOME", "/home/someone")
    assert Config().state_directory == Path("/home/someone/.local/state/camtopod")
    monkeypatch.setenv("XDG_STATE_HOME", "/xdg")
    assert Config().state_directory == Path("/xdg/camtopod")
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/camtopod")
    assert Config().state_directory == Path("/var/lib/camtopod")
    assert config_file.parse('[state]\ndirectory = "~/x"').state_directory == Path(
        "/home/someone/x"
    )
    monkeypatch.delenv("HOME")
    monkeypatch.setattr("pwd.getpwuid", {}.__getitem__)
    assert config_file.parse('[state]\ndirectory = "~/x"').state_directory == Path("/nonexistent/x")


# --- logs -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", main.LOG_FORMATS)
def test_log_formats(form: str, capsys: pytest.CaptureFixture[str]) -> None:
    start_logging(arguments(log_format=form, command="run", with_parent=None))
    logging.getLogger("camtopod.serve.x").warning('says "%s"', "rtsp://admin:p@ss:w/rd@h/x\x1b[2J")
    line = capsys.readouterr().err.rstrip("\n")

    if form == "text":
        assert re.fullmatch(r'\S{19}Z warning: says "rtsp://\*\*\*@h/x\\u001b\[2J"', line)
    elif form == "json":
        record = json.loads(line)
        assert (record["level"], record["from"]) == ("warning", "serve.x")
        assert record["message"] == 'says "rtsp://***@h/x\x1b[2J"'
        assert re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z", record["t"])
    else:
        assert re.fullmatch(r't=\S+Z level=warning from=serve\.x message="says \\"rtsp:.*"', line)
        assert "p@ss" not in line

    with contextlib.suppress(ValueError):
        try:
            raise ValueError("rtsp://admin:p@ss:w/rd@host/x")
        finally:
            logging.exception("failed")
    trace = capsys.readouterr().err
    assert "failed" in trace
    assert "w/rd" not in trace


# --- run ------------------------------------------------------------------------------------------


def test_run_says_why_it_cannot(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    config = tmp_path / "c.toml"
    file = tmp_path / "file"
    file.write_text("")

    def run(text: str, state: Path) -> tuple[int, str]:
        config.write_text(text)
        status = main.main(["--config", str(config), "run", "--state", str(state)])
        return status, capsys.readouterr().err

    status, said = run('[bus]\nlisten = ["tcp/127.0.0.1:0"]\n', file / "x")
    assert (status, "cannot write the state directory" in said) == (exits.STATE, True)
    status, said = run("[bus]\nlisten = 5\n", tmp_path)
    assert (status, f"{config}:2: bus.listen: expected" in said) == (exits.CONFIG, True)
    away = '[bus]\nconnect = ["tcp/127.0.0.1:1"]\nconnect_seconds = 0.2\n'
    assert run(away, tmp_path / "s")[0] == exits.BUS
    with contextlib.closing(Journal(tmp_path / "newer")) as journal:
        journal.set_meta("format", "99")
    status, said = run('[bus]\nlisten = ["tcp/127.0.0.1:0"]\n', tmp_path / "newer")
    assert (status, "journal.db has format 99" in said) == (exits.STATE, True)


# --- no password in what is said -----------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments",
    [
        ["grab", "rtsp://u:hunter2@h/x", "rtsp://u:hunter2@h/y"],
        ["rtsp://u:hunter2@h"],
        ["ingest", "rtsp://u:hunter2@h"],
        ["grab", "--start", "rtsp://u:hunter2@h"],
    ],
)
def test_a_command_line_that_is_wrong_keeps_its_password(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main.main(arguments)
    assert caught.value.code == exits.USAGE
    said = capsys.readouterr().err
    assert "rtsp://***@h" in said
    assert "hunter2" not in said


def test_a_crash_shows_no_password_and_ends_with_a_status() -> None:
    """Of the main thread; the end of another one is shown and changes nothing."""
    script = (
        "import threading\n"
        "from camtopod.cli import main\n"
        "def fail(): raise ValueError('rtsp://u:hunter2@h/x is broken \\x1b[2J')\n"
        "def run():\n"
        "    thread = threading.Thread(target=fail, name='other'); thread.start(); thread.join()\n"
        "    fail()\n"
        "main.main = run\n"
        "main.console()\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == exits.FAILED
    assert "in thread other:" in done.stderr
    assert done.stderr.count("ValueError: rtsp://***@h/x is broken") == 2
    assert "hunter2" not in done.stderr
    assert "\x1b" not in done.stderr


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
@pytest.mark.parametrize(
    ("command", "status"), [("schema event", exits.DONE), ("nonsense", exits.USAGE)]
)
def test_any_standard_stream_may_be_closed(command: str, closed: str, status: int) -> None:
    line = f'exec "{sys.executable}" -m camtopod {command} {closed}'
    done = subprocess.run(["sh", "-c", line], capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == status
    assert "Traceback" not in done.stderr
    assert bool(done.stdout) == (command == "schema event" and ">&-" not in closed.split())
