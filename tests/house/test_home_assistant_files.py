"""What deploy/ has for Home Assistant: the add-on's script with the real program, and the example."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tomllib
import urllib.request
from pathlib import Path

import pytest
import yaml
from paths import DEPLOY, ROOT
from serving import free_endpoint, wait_for

from camtopod import __version__
from camtopod.cli import exits
from camtopod.export import homeassistant
from camtopod.records import Prediction

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


def test_all_say_the_same_version() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    changes = re.findall(r"^## (\S+)$", (DEPLOY / "changelog.md").read_text(), re.MULTILINE)
    assert {project["version"], MANIFEST["version"], changes[0]} == {__version__}


@pytest.mark.parametrize(
    "text", re.findall(r"```yaml\n(.*?)```", (DEPLOY / "monitoring.md").read_text(), re.DOTALL)
)
def test_every_example_is_yaml(text: str) -> None:
    assert yaml.safe_load(text)


def test_the_live_view_follows_what_the_bridge_publishes() -> None:
    page = (DEPLOY / "monitoring.md").read_text().partition("### Follow me")[2]
    example, card = map(yaml.safe_load, re.findall(r"```yaml\n(.*?)```", page, re.DOTALL))
    cameras = example["input_select"]["live_view"]["options"]
    [automation] = example["automation"]
    [trigger] = automation["triggers"]

    # Entities and attributes are those that discovery announces.
    [look] = [one for one in homeassistant.CAMERA_ENTITIES if one.field == "look"]
    entity = look.name.lower().replace(" ", "_")
    assert trigger["entity_id"] == [f"sensor.{camera}_{entity}" for camera in cameras]
    prediction = homeassistant.prediction_state(
        homeassistant.Topics("site"), Prediction("lobby", None, 1e9, None, 1, 1.0, [])
    )
    [state] = map(json.loads, prediction.values())
    assert trigger["attribute"] in state
    assert set(re.findall(r"attributes\.(\w+)", str(automation["conditions"]))) <= state.keys()
    assert card["conditions"][0]["state"] in cameras
