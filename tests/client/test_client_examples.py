"""The examples of the client library with a real daemon; the pages show the same code."""

from __future__ import annotations

import ast
import json
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from fake_bus_daemon import NOW, LearnedDaemon, learned, put, running
from pages import blocks
from paths import DEPLOY, EXAMPLES, ROOT
from serving import T0, closing_event, free_endpoint, numbered, small_config, wait_for, walkers

from camtopod.codec import to_json
from camtopod.records import Event
from camtopod.serve.bus import dial

README = (ROOT / "README.md").read_text()
PROTOCOL = (DEPLOY / "protocol.md").read_text()
LINES_MAX = 10
"""Without imports."""


def printed(
    learned_daemon: LearnedDaemon,
    name: str,
    events: list[Event],
    looks: dict[str, list[float]] | None = None,
) -> list[str]:
    """Return the output of an example for these events, with an appearance for each track."""
    command = [sys.executable, str(EXAMPLES / name), learned_daemon.daemon.endpoint]
    lines = [json.loads(to_json(event)) for event in events]
    if looks is not None:
        lines = [{**line, "look": looks[line["track"]]} for line in lines]
    given = "".join(json.dumps(line) + "\n" for line in lines).encode()
    done = subprocess.run(command, input=given, capture_output=True, timeout=100)
    assert done.stderr == b""
    return done.stdout.decode().splitlines()


def walk(track: int, t: float, to: str) -> list[Event]:
    """Return events of a walk from the view of a to another, which takes 9 s."""
    a, other = (str(10 * track + k) for k in (1, 2))
    return [
        Event("a", "entry", t, 0.11, 0.5, a),
        Event("a", "exit", t + 4, 0.89, 0.5, a),
        Event(to, "entry", t + 13, 0.11, 0.5, other),
        Event(to, "exit", t + 17, 0.89, 0.5, other),
    ]


def test_where_next(learned_daemon: LearnedDaemon) -> None:
    found = re.fullmatch(
        r"a -> (?:most likely )?[bc] (\d+) %, in (\d+) to (\d+) s; .*",
        printed(learned_daemon, "next_camera.py", walk(1, NOW, "b"))[0],
    )

    assert found is not None
    chance, soonest, latest = map(int, found.groups())
    assert 40 <= chance <= 60
    assert 6 <= soonest < 9 < latest <= 12


def through_both(number: int, t: float) -> list[Event]:
    """Return events of eight seconds in the view of a, the last three of them also in that of b."""
    a, b = (str(10 * number + k) for k in (1, 2))
    return [
        Event("a", "entry", t, 0.11, 0.5, a),
        Event("b", "entry", t + 5, 0.11, 0.5, b),
        Event("a", "exit", t + 8, 0.89, 0.5, a),
        Event("b", "exit", t + 14, 0.89, 0.5, b),
    ]


def test_where_views_overlap_the_track_that_goes_on_is_named(tmp_path: Path) -> None:
    begin = np.cumsum(np.random.default_rng(3).exponential(20.0, 200))
    events = [
        event for number, t in enumerate(begin) for event in through_both(number, T0 + float(t))
    ]
    events = [*numbered(sorted(events, key=lambda event: event.t)), closing_event()]
    with (
        running(tmp_path, free_endpoint()) as daemon,
        dial(small_config(tmp_path, daemon.endpoint)) as bus,
    ):
        put(bus, *events)
        learned(daemon, events)
        command = [sys.executable, str(EXAMPLES / "handing_over.py"), daemon.endpoint]
        two = sorted(
            [*through_both(301, NOW), *through_both(302, NOW + 2)], key=lambda event: event.t
        )
        given = b"".join(to_json(event) + b"\n" for event in two)
        done = subprocess.run(command, input=given, capture_output=True, timeout=100)

    assert done.stderr == b""
    found = [line.rsplit(" ", 1) for line in done.stdout.decode().splitlines()]
    assert [pair for pair, _ in found] == ["a/3011 = b/3012", "a/3021 = b/3022"]
    assert all(int(share.rstrip("%")) >= 70 for _, share in found)


def test_who_is_who(learned_daemon: LearnedDaemon) -> None:
    events = sorted(
        [*walk(1, NOW, "b"), *walk(2, NOW + 6, "c"), *walk(3, NOW + 60, "b")],
        key=lambda event: event.t,
    )

    assert sorted(printed(learned_daemon, "gating.py", events)) == [
        "a/11 = b/12",
        "a/21 = c/22",
        "a/31 = b/32",
    ]


def test_who_is_who_without_a_daemon(tmp_path: Path) -> None:
    walks = [*walk(1, NOW, "b"), *walk(2, NOW + 6, "c"), *walk(3, NOW + 60, "b")]
    for name, events in (("learn", [*walkers(200), closing_event()]), ("match", walks)):
        (tmp_path / name).write_bytes(b"".join(to_json(event) + b"\n" for event in events))
    example = EXAMPLES / "offline.py"
    command = [sys.executable, example, tmp_path / "learn", tmp_path / "match"]

    done = subprocess.run(command, capture_output=True, timeout=100, text=True)

    assert done.stderr == ""
    assert sorted(done.stdout.splitlines()) == ["a/11 = b/12", "a/21 = c/22", "a/31 = b/32"]
    assert len(example.read_text().splitlines()) <= 27


def test_who_is_who_by_looks_and_by_the_site(learned_daemon: LearnedDaemon) -> None:
    """Appearance decides between simultaneous exits; strangers are not joined."""
    red, blue = [1.0, 0.0, 0.2], [0.0, 1.0, 0.2]
    looks = {"11": red, "21": blue, "12": blue, "22": red, "31": red, "32": blue}
    walks = [*walk(1, NOW, "b"), *walk(2, NOW + 0.3, "b"), *walk(3, NOW + 300, "b")]

    found = printed(learned_daemon, "by_looks.py", sorted(walks, key=lambda event: event.t), looks)

    assert sorted(found) == ["a/11 = b/22", "a/21 = b/12"]


def test_as_it_comes(learned_daemon: LearnedDaemon) -> None:
    """It follows until interrupted, and then ends completely."""
    command = [
        sys.executable,
        "-u",
        str(EXAMPLES / "in_asyncio.py"),
        learned_daemon.daemon.endpoint,
    ]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as running:
        assert running.stdout is not None
        lines: list[str] = []
        reader = threading.Thread(target=lines.extend, args=(running.stdout,), daemon=True)
        reader.start()

        def heard() -> bool:
            learned_daemon.walks(1, 15)
            return any(re.match(r"a -> [bc] \d+ %, in", line) for line in lines)

        try:
            wait_for(heard, "a prediction")
            running.send_signal(signal.SIGINT)
            running.wait(30)
        finally:
            running.kill()
        reader.join()
    assert re.match(r"version \d+: \d pairs of cameras", lines[0])


def printed_until_a_prediction(
    learned_daemon: LearnedDaemon, block: str, lines_min: int
) -> list[str]:
    """Run a block of Python while objects pass, until it has printed so many lines."""
    with subprocess.Popen(
        [sys.executable, "-u", "-c", block], stdout=subprocess.PIPE, text=True
    ) as running:
        assert running.stdout is not None
        lines: list[str] = []
        reader = threading.Thread(target=lines.extend, args=(running.stdout,), daemon=True)
        reader.start()

        def enough() -> bool:
            learned_daemon.walks(1, 15)
            return len(lines) >= lines_min

        try:
            wait_for(enough, "a prediction")
        finally:
            running.kill()
        reader.join()
    return lines


def test_the_bus_itself_as_the_page_shows_it(learned_daemon: LearnedDaemon) -> None:
    """The lines without camtopod run as shown, except for the endpoint."""
    [shown] = blocks(PROTOCOL, "python")

    assert (
        len([line for line in shown.splitlines() if line and not line.startswith("import ")])
        <= LINES_MAX
    )
    assert shown.count('"tcp/127.0.0.1:7447"') == 1
    lines = printed_until_a_prediction(
        learned_daemon, shown.replace("tcp/127.0.0.1:7447", learned_daemon.daemon.endpoint), 2
    )
    assert [pair["cameras"] for pair in ast.literal_eval(lines[0])] == [["a", "b"], ["a", "c"]]
    prediction = ast.literal_eval(lines[1])
    assert prediction["camera"] in "abc"
    assert prediction["leave"] + sum(
        one["probability"] for one in prediction["next"]
    ) == pytest.approx(1.0)


def test_the_client_as_readme_shows_it(learned_daemon: LearnedDaemon) -> None:
    [shown] = blocks(README, "python")
    assert shown.count(".connect()") == 1
    here = shown.replace("connect()", f"connect(connect={learned_daemon.daemon.endpoint!r})")
    lines = printed_until_a_prediction(learned_daemon, here, 1)
    assert re.match(r"[abc] -> (leaves the site|[abc]) \d+ %", lines[0])
