"""What deploy/ has for Home Assistant: the add-on's script with the real program, and the example."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
import yaml
from paths import DEPLOY, ROOT
from serving import free_endpoint, wait_for

from camtopod.cli import exits
from camtopod.export import homeassistant
from camtopod.export.arrivals import Passing
from camtopod.records import Match

ADD_ON = DEPLOY / "home-assistant"
MANIFEST = yaml.safe_load((ADD_ON / "config.yaml").read_text())


def start(folder: Path, **options: str) -> subprocess.Popen[bytes]:
    """Run the add-on's script in a folder as the Supervisor lays it out."""
    program = folder / "camtopod"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m camtopod "$@"\n')
    program.chmod(0o755)
    given = folder / "options.json"
    given.write_text(json.dumps({**MANIFEST["options"], **options}))
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "CAMTOPOD_FOLDER": str(folder),
        "CAMTOPOD_OPTIONS": str(given),
        "CAMTOPOD_PROGRAM": str(program),
        "CAMTOPOD_PAGE": "127.0.0.1:0",
        "STATE_DIRECTORY": str(folder / "state"),
    }
    command = ["bash", str(ADD_ON / "run.sh")]
    return subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, cwd=folder)


def test_the_add_on_runs_all_programs_until_it_is_stopped(tmp_path: Path) -> None:
    bus, health = free_endpoint(), free_endpoint().removeprefix("tcp/")
    (tmp_path / "camtopod.toml").write_text(
        f'[bus]\nlisten = ["{bus}"]\n[health]\nlisten = "{health}"\n'
        '[cameras.lobby]\nsource = "rtsp://127.0.0.1:1/none"\n'
    )
    with start(tmp_path) as running:
        assert running.stderr is not None
        wanted = {b"the page is at", b"lobby"}
        while wanted:
            line = running.stderr.readline()
            assert line, f"it ended before {wanted}"
            wanted = {one for one in wanted if one not in line}

        def ready() -> bool:
            try:
                with urllib.request.urlopen(f"http://{health}/readyz", timeout=5) as answer:
                    return bool(answer.status == 200)
            except OSError:
                return False

        wait_for(ready, "the daemon")
        running.send_signal(signal.SIGTERM)
        running.stderr.read()  # ends when the last program has ended
        assert running.wait(30) == 0


def test_the_add_on_ends_when_one_of_its_programs_does(tmp_path: Path) -> None:
    (tmp_path / "camtopod.toml").write_text("[bus]\nlisten = 3\n")
    with start(tmp_path) as running:
        _, said = running.communicate(timeout=60)
    assert running.returncode == exits.CONFIG
    assert b"camtopod.toml:2: bus.listen" in said


def test_the_manifest_is_complete() -> None:
    assert MANIFEST["schema"].keys() == MANIFEST["options"].keys()
    script = (ADD_ON / "run.sh").read_text()
    assert set(re.findall(r"\boption (\w+)", script)) == MANIFEST["options"].keys()
    assert {"name", "slug", "description", "arch"} <= MANIFEST.keys()
    assert MANIFEST["map"] == ["app_config"]  # the Supervisor warns of the older addon_config


@pytest.mark.parametrize(
    "text", re.findall(r"```yaml\n(.*?)```", (DEPLOY / "monitoring.md").read_text(), re.DOTALL)
)
def test_every_example_is_yaml(text: str) -> None:
    assert yaml.safe_load(text)


def test_the_pages_name_entities_that_discovery_announces() -> None:
    announced = homeassistant.discovery(homeassistant.Topics("site"), ["hall"])
    entities = set()
    for topic, config in announced.items():
        _, component, *_ = topic.split("/")
        says = json.loads(config)
        name = f"{says['device']['name']} {says['name']}".lower().replace(" ", "_")
        entities.add(f"{component}.{name}")
    page = (DEPLOY / "monitoring.md").read_text()

    named = set(re.findall(r"\b(?:binary_sensor|sensor|event)\.\w+", page))
    assert len(named) >= 5
    assert named <= entities


def test_the_blueprint_reads_what_the_bridge_publishes() -> None:
    class Loader(yaml.SafeLoader):
        """Reads `!input NAME` as {"input": NAME}."""

    Loader.add_constructor("!input", lambda loader, node: {"input": loader.construct_scalar(node)})
    text = (ADD_ON / "one-notification-a-walk.yaml").read_text()
    blueprint = yaml.load(text, Loader)
    inputs = blueprint["blueprint"]["input"]
    match = Match("hall", 1e9, 1, [], 1.0, "hall@1000000000", "17")
    topics = homeassistant.Topics("site")
    passing = Passing(match, [match], again=True, was="hall@2")
    [message] = map(json.loads, homeassistant.walk_messages(topics, passing).values())

    assert set(re.findall(r"!input (\w+)", text)) == inputs.keys()
    assert inputs["topic"]["default"] == topics.walk
    assert set(re.findall(r"\bmatch\.(\w+)", text)) <= message.keys()
    assert set(re.findall(r"\bone\.(\w+)", text)) <= message["passages"][0].keys()
