"""`camtopod learn --districts`: in processes of this machine, and on a cluster with TLS."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import distributed
import pytest
from city_recording import CAMERAS, DISTRICTS, EVENTS
from serving import wait_for

from camtopod import load_topology
from camtopod.city import recordings
from camtopod.cli.city import learn_city
from camtopod.cli.main import main
from camtopod.codec import to_json
from camtopod.config import districts_file
from camtopod.learn.settings import Settings
from camtopod.records import Event

LEARN = ["learn", "e.jsonl", "--districts", "districts.toml", "--topology", "city.json"]


def write_lines(path: Path, events: list[Event]) -> None:
    path.write_bytes(b"".join(to_json(event) + b"\n" for event in events))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working folder, with a recording and its districts."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "districts.toml").write_text(districts_file.to_toml(DISTRICTS))
    write_lines(tmp_path / "e.jsonl", EVENTS)
    return tmp_path


@pytest.fixture(scope="module")
def by_hand(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """Return the city that `learn` of each district's lines, and `merge`, make."""
    folder = tmp_path_factory.mktemp("by_hand")
    (folder / "districts.toml").write_text(districts_file.to_toml(DISTRICTS))
    paths = [str(folder / f"{site}.json") for site in DISTRICTS]
    for (site, district), path in zip(DISTRICTS.items(), paths, strict=True):
        cameras = {*district.cameras, *district.hears}
        lines = folder / f"{site}.jsonl"
        write_lines(lines, [event for event in EVENTS if event.camera in cameras])
        assert main(["learn", str(lines), "--site", site, "--topology", path]) == 0
    options = ["--districts", str(folder / "districts.toml"), "--out", str(folder / "city.json")]
    assert main(["merge", *paths, *options]) == 0
    return (folder / "city.json").read_bytes()


@pytest.fixture
def _fits_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fit in this process, as processes are another test's matter."""
    monkeypatch.setattr(recordings, "in_process", lambda fit, *arguments: fit(*arguments))


def test_a_city_is_that_of_learn_and_merge(
    folder: Path,
    by_hand: bytes,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)  # not installed
    rows = EVENTS[1::2] + EVENTS[::2]  # in no order, in two files, with lines that do not count
    strangers = [Event("yard", "entry", event.t, 0.1, 0.2) for event in EVENTS[:3]]
    write_lines(folder / "e.jsonl", rows[:400])
    write_lines(folder / "f.jsonl", rows[400:] + rows[:2] + strangers)

    assert main(["learn", "e.jsonl", "f.jsonl", *LEARN[2:]]) == 0

    assert (folder / "city.json").read_bytes() == by_hand
    said = capfd.readouterr().err
    total = len(EVENTS) + 5
    assert f"{total - 3} of {total} lines were accepted" in said
    assert "lines were rejected: no-district 3; 2 of" in said
    assert "no district owns yard" in said
    assert "topology: version 1," in said
    assert sorted(path.name for path in folder.iterdir()) == [
        "city.json", "districts.toml", "e.jsonl", "f.jsonl"
    ]  # fmt: skip


@pytest.mark.usefixtures("_fits_here")
def test_a_run_that_was_interrupted_goes_on(
    folder: Path,
    by_hand: bytes,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    def interrupted(_: object, parts: Path, district: str, settings: Settings) -> None:
        if district != "d0":
            raise KeyboardInterrupt
        recordings.fit_district(parts, district, settings)

    (folder / "city.json").write_text("as it was")
    with (folder / "e.jsonl").open("a") as file:
        file.writelines(["no event\n"] * len(EVENTS))
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {0})
    with monkeypatch.context() as patch:
        patch.setattr(recordings, "in_process", interrupted)
        assert main(LEARN) == 1
    assert (folder / "city.json").read_text() == "as it was"
    [parts] = folder.glob("city.json.*.parts")
    before = (parts / "d0.0.json").stat().st_mtime_ns

    monkeypatch.setattr(recordings, "split", None)  # it is not needed again
    monkeypatch.setattr(learn_city.shutil, "rmtree", lambda folder: None)
    assert main(LEARN) == 1  # too few lines

    assert (folder / "city.json").read_bytes() == by_hand
    assert (parts / "d0.0.json").stat().st_mtime_ns == before
    said = capfd.readouterr().err
    assert f"{len(EVENTS)} of {2 * len(EVENTS)} lines were accepted" in said


@pytest.mark.usefixtures("_fits_here")
def test_what_cannot_be_learned_is_named(folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    write_lines(folder / "e.jsonl", [event for event in EVENTS if event.camera == CAMERAS[0]])

    assert main(LEARN) == 1

    said = capfd.readouterr().err
    assert "camtopod: district d2: no events: nothing to learn from" in said
    [parts] = folder.glob("city.json.*.parts")
    assert f"the same command goes on from {parts}" in said
    assert not (folder / "city.json").exists()
    for text in ("no event\n" * 3, ""):
        (folder / "e.jsonl").write_text(text)
        for _ in range(2):
            assert main(LEARN) == 66


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([*LEARN, "--updates", "u.jsonl"], "--districts goes without --updates and --table"),
        ([*LEARN, "--table"], "--districts goes without --updates and --table"),
        (LEARN[:4], "--districts needs --topology OUT.json"),
        ([*LEARN[:-1], "-"], "--districts needs --topology OUT.json"),
        (["learn", "-", *LEARN[2:]], "--districts reads files, not standard input"),
        ([*LEARN[:2], "--insecure"], "--scheduler and --insecure are for --districts"),
        ([*LEARN[:2], "--scheduler", "tls://a:1"], "--scheduler and --insecure are for"),
        ([*LEARN, "--scheduler", "tcp://192.0.2.1:8786"], "on the way to tcp://192.0.2.1:8786"),
    ],
)
def test_options_that_do_not_go_together(
    folder: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], sentence: str
) -> None:
    before = sorted(folder.iterdir())
    assert main(arguments) == 2

    assert sentence in capsys.readouterr().err
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize(
    ("address", "is_private"),
    [
        ("tls://scheduler.example:8786", True),
        ("tcp://127.0.0.1:8786", True),
        ("localhost:8786", True),
        ("tcp://[::1]:8786", True),
        ("tcp://192.0.2.1:8786", False),
        ("192.0.2.1:8786", False),
        ("tcp://localhost.example:8786", False),
        ("tcp://[::1:8786", False),
        ("ws://scheduler.example:80", False),
    ],
)
def test_only_tls_leaves_the_machine(address: str, is_private: bool) -> None:
    assert learn_city.is_private(address) is is_private


def test_without_the_extra_a_sentence_says_what_is_missing(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delitem(sys.modules, "camtopod.city.cluster", raising=False)
    monkeypatch.setitem(sys.modules, "distributed", None)

    assert main([*LEARN, "--scheduler", "tls://127.0.0.1:8786"]) == 1

    assert "needs the package 'distributed', which is not installed" in capsys.readouterr().err


def test_an_insecure_scheduler_is_taken_if_told(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def client(address: str, **_: object) -> None:
        raise OSError(f"tried {address}")

    monkeypatch.setattr(distributed, "Client", client)
    assert main([*LEARN, "--scheduler", "192.0.2.1:8786", "--insecure"]) == 1

    assert "tried 192.0.2.1:8786" in capsys.readouterr().err


# --- a cluster with TLS ---


@pytest.fixture
def tls(folder: Path) -> Iterator[Mapping[str, str]]:
    """Run a scheduler and a worker with TLS; return the environment with their certificates."""
    assert main(["keys", "--keys", "keys", "init", "--host", "127.0.0.1"]) == 0
    keys = folder / "keys" / "daemon"
    variables = {"CA_FILE": keys / "ca.pem"}
    for role in ("SCHEDULER", "WORKER", "CLIENT"):
        variables[f"{role}__CERT"] = keys / "certificate.pem"
        variables[f"{role}__KEY"] = keys / "private.key"
    environment = {
        **os.environ,
        **{f"DASK_DISTRIBUTED__COMM__TLS__{key}": str(path) for key, path in variables.items()},
    }
    file = [
        "--scheduler-file",
        str(folder / "scheduler.json"),
        "--dashboard-address",
        "127.0.0.1:0",
    ]
    programs = {
        "dask_scheduler": ["--protocol", "tls", "--host", "127.0.0.1", "--port", "0"],
        "dask_worker": ["--no-nanny", "--nthreads", "1", "--host", "127.0.0.1"],
    }
    processes = []
    try:
        for program, options in programs.items():
            command = [sys.executable, "-m", f"distributed.cli.{program}", *file, *options]
            processes.append(subprocess.Popen(command, env=environment, cwd=folder))
            wait_for((folder / "scheduler.json").exists, "the scheduler")
        yield environment
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait(60)


def test_a_cluster_with_tls_learns_the_same(
    folder: Path, by_hand: bytes, tls: Mapping[str, str]
) -> None:
    address = json.loads((folder / "scheduler.json").read_text())["address"]
    assert address.startswith("tls://127.0.0.1:")

    command = [sys.executable, "-m", "camtopod", *LEARN, "--scheduler", address]
    done = subprocess.run(command, env={**tls}, capture_output=True, timeout=200, check=False)

    assert done.returncode == 0, done.stderr
    assert (folder / "city.json").read_bytes() == by_hand
    assert b"topology: version 1," in done.stderr
    assert {part.site for part in load_topology("city.json").parts or ()} == {*DISTRICTS}
