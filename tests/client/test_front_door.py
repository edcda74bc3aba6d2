"""What `import camtopod` offers: each name with an example that runs, loaded when it is asked for."""

from __future__ import annotations

import doctest
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from fake_bus_daemon import LearnedDaemon
from msgspec.structs import replace

import camtopod
from camtopod.codec import to_json

NAMES = sorted(camtopod.__all__)
SCIPY = ("Learner", "export_topology", "learn_topology")


def examples(name: str) -> list[doctest.DocTest]:
    """Return the examples in the docstring of a name."""
    found = doctest.DocTestFinder(recurse=False).find(getattr(camtopod, name), name)
    return [one for one in found if one.examples]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the events and the topology of the example of `learn_topology`.

    With them is a city of which that topology is the only part.
    """
    path = tmp_path_factory.mktemp("front")
    [example] = examples("learn_topology")
    run = "".join(one.source for one in example.examples)
    names: dict[str, Any] = {}
    exec(f"{run}\ntopology = learn_topology(events)", names)
    topology = names["topology"]
    (path / "events.jsonl").write_bytes(b"\n".join(map(to_json, names["events"])))
    owners = {camera.id: topology.site for camera in topology.cameras}
    (path / "topology.json").write_bytes(to_json(topology))
    (path / "city.json").write_bytes(to_json(replace(topology, parts=[topology], owners=owners)))
    return path


def test_the_name_of_a_file_is_neither_a_topology_nor_events() -> None:
    take_topology: list[Callable[[Any], object]] = [
        camtopod.Predictor,
        camtopod.CityPredictor,
        camtopod.Gate,
        lambda name: camtopod.score(name, [], {}),
        lambda name: camtopod.export_topology(name, "dot"),
    ]
    for take in take_topology:
        with pytest.raises(
            TypeError, match=r"'topology\.json' is no topology; load_topology reads"
        ):
            take("topology.json")
    for name in ("events.jsonl", Path("events.jsonl")):
        with pytest.raises(TypeError, match=r"events\.jsonl.* is no list of events; load_events"):
            camtopod.learn_topology(name)  # type: ignore[arg-type]


def test_what_is_no_event_is_said_to_be_none(folder: Path) -> None:
    topology = camtopod.load_topology(folder / "topology.json")
    row: Any = {"camera": "lobby", "kind": "exit", "t": 1.0}
    takes: list[Callable[[], object]] = [
        lambda: camtopod.learn_topology([row]),
        lambda: camtopod.Predictor(topology).predict(row),
        lambda: camtopod.Gate(topology).affinity([row], []),
        lambda: camtopod.score(topology, [row], {}),
    ]
    for take in takes:
        with pytest.raises(TypeError, match=r"is no camtopod\.Event; load_events reads"):
            take()
    with pytest.raises(ValueError, match="no file is named"):
        camtopod.load_events()


@pytest.mark.parametrize("name", [name for name in NAMES if name != "Site"])
def test_the_example_of_a_name_runs(
    name: str, folder: Path, learned_daemon: LearnedDaemon, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    found = examples(name)
    here = partial(camtopod.connect, connect=learned_daemon.daemon.endpoint)
    monkeypatch.setattr(camtopod, "connect", here, raising=False)

    assert len(found) == 1, "a name without an example"
    assert doctest.DocTestRunner().run(found[0]).failed == 0


@pytest.mark.parametrize("names", [sorted({*NAMES} - {*SCIPY}), *([name] for name in SCIPY)])
def test_only_the_learner_and_the_layout_need_scipy(names: list[str]) -> None:
    code = f"import sys; from camtopod import {', '.join(names)}; print('scipy' in sys.modules)"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)

    assert said.stdout.strip() == str(names[0] in SCIPY), said.stderr


def test_a_name_that_does_not_exist_is_named() -> None:
    assert set(NAMES) <= set(dir(camtopod))
    with pytest.raises(AttributeError, match="'Topologie'"):
        camtopod.Topologie  # noqa: B018


def test_a_users_program_is_typed(tmp_path: Path) -> None:
    pytest.importorskip("mypy")
    program = tmp_path / "program.py"
    program.write_text(
        "import camtopod\n"
        "topology: camtopod.Topology = camtopod.load_topology('t.json')\n"
        "with camtopod.connect() as site:\n"
        "    reveal_type(site.predict('lobby', 1.0))\n"
        "camtopod.Topologie\n"
    )
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", str(program)]
    said = subprocess.run(command, capture_output=True, text=True, timeout=110, cwd=tmp_path)

    wrong = [line for line in said.stdout.splitlines() if "error:" in line]
    assert 'Revealed type is "camtopod.records.prediction.Prediction"' in said.stdout
    assert len(wrong) == 1, said.stdout
    assert '"Topologie"' in wrong[0]
