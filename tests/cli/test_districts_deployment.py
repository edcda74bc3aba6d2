"""`camtopod districts --deploy`: files that run a city, in Kubernetes or by systemd."""

from __future__ import annotations

import contextlib
import io
import json
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import kubernetes_validate
import pytest
import yaml
import zenoh
from city_parts import CITY, DISTRICTS
from paths import DEPLOY
from serving import T0, WAIT_SECONDS, camtopod, free_endpoint, wait_for

from camtopod.cli import exits
from camtopod.cli.city import deployment
from camtopod.cli.main import main
from camtopod.codec import to_json
from camtopod.config import SITES_MAX, Config, District, Districts, Limits, districts_file
from camtopod.config.config_file import load, parse
from camtopod.records import Event
from camtopod.serve.bus import dial

TWO = {
    "north": District(("gate1", "gate2"), ("square4",)),
    "South_1": District(("square4", "yard"), ("gate2",)),
}
"""Two small districts; gate2 and square4 are at the border."""
LABELS = {"north": "north", "South_1": "south-1"}


def deployed(folder: Path, kind: str, districts: Districts = TWO) -> Path:
    """Write the files of districts, and return their folder."""
    (folder / "districts.toml").write_text(districts_file.to_toml(districts))
    arguments = ["districts", str(folder / "districts.toml"), "--deploy", kind]
    assert main([*arguments, str(folder / kind)]) == 0
    return folder / kind


def objects_of(text: str) -> dict[str, dict[str, Any]]:
    """Return the objects of a manifest, by their kind."""
    objects = list(yaml.safe_load_all(text))
    assert len({one["kind"] for one in objects}) == len(objects)
    return {one["kind"]: one for one in objects}


def assert_delivers(config: Config, name: str, districts: Districts = TWO) -> None:
    """Check the tables of the cameras of a district."""
    assert (config.site.name, tuple(config.cameras)) == (name, districts[name].cameras)
    for camera in config.cameras:
        hearers = [site for site, district in districts.items() if camera in district.hears]
        assert config.sites_of(camera) == (name, *hearers)


# --- Kubernetes -----------------------------------------------------------------------------------


@pytest.mark.parametrize("city", ["two", "synthetic"])
def test_kubernetes_takes_every_manifest(city: str, tmp_path: Path) -> None:
    version = kubernetes_validate.latest_version()
    folder = deployed(tmp_path, "kubernetes", TWO if city == "two" else DISTRICTS)
    manifests = [DEPLOY / "kubernetes.yaml", *folder.glob("*.yaml")]
    assert len(manifests) == 3
    for path in manifests:
        objects = objects_of(path.read_text())
        for one in objects.values():
            kubernetes_validate.validate(one, version, strict=True)
        wrong = objects["StatefulSet"]
        wrong["spec"]["replica"] = wrong["spec"].pop("replicas")
        with pytest.raises(kubernetes_validate.ValidationError):
            kubernetes_validate.validate(wrong, version, strict=True)


def test_each_district_has_a_router_and_a_daemon_of_its_own(tmp_path: Path) -> None:
    folder = deployed(tmp_path, "kubernetes")
    endpoints = {}
    for name, label in LABELS.items():
        objects = objects_of((folder / f"{label}.yaml").read_text())
        assert objects["StatefulSet"]["metadata"]["name"] == f"camtopod-{label}"
        router, [port] = objects["Service"]["metadata"]["name"], objects["Service"]["spec"]["ports"]
        endpoints[name] = f"tcp/{router}:{port['port']}"
        config = parse(objects["ConfigMap"]["data"]["camtopod.toml"])
        assert (config.site.name, config.dials) == (name, (endpoints[name],))

        # Selectors meet the labels of this district's pods alone, and volumes its configuration.
        pods = {kind: objects[kind]["spec"]["template"] for kind in ("Deployment", "StatefulSet")}
        assert objects["Service"]["spec"]["selector"] == pods["Deployment"]["metadata"]["labels"]
        policy = objects["NetworkPolicy"]["spec"]
        assert policy["podSelector"]["matchLabels"] == pods["Deployment"]["metadata"]["labels"]
        sources = [one["podSelector"]["matchLabels"] for one in policy["ingress"][0]["from"]]
        assert sources == [pods["StatefulSet"]["metadata"]["labels"], {"camtopod": "grabber"}]
        for kind, pod in pods.items():
            assert objects[kind]["spec"]["selector"]["matchLabels"] == pod["metadata"]["labels"]
            volumes = [one["configMap"] for one in pod["spec"]["volumes"] if "configMap" in one]
            assert volumes == [objects["ConfigMap"]["metadata"]]
        [container] = pods["StatefulSet"]["spec"]["containers"]
        assert container["readinessProbe"]["httpGet"]["path"] == "/readyz"
        [claim] = objects["StatefulSet"]["spec"]["volumeClaimTemplates"]
        assert claim["metadata"]["name"] in [one["name"] for one in container["volumeMounts"]]

    for name, label in LABELS.items():
        config = load(folder / f"{label}.toml")
        assert_delivers(config, name)
        assert config.dials == (endpoints.pop(name),)
        assert {site: config.at(site).dials for site in config.sites} == {
            site: (f"tcp/zenoh-{LABELS[site]}:7447",) for site in LABELS if site != name
        }


def test_a_daemon_asks_for_what_was_measured() -> None:
    rows = re.findall(
        r"^\| ([\d,]+) \| (\d+) s \| ([\d.]+) GB \| \d+ s \|",
        (DEPLOY / "large.md").read_text(),
        re.MULTILINE,
    )
    assert len(rows) == 2
    measured = deployment.MEASURED
    assert deployment.MARGIN == 2, "the page says twice"
    columns = zip(
        *((int(n.replace(",", "")), float(s), float(gb)) for n, s, gb in rows), strict=True
    )
    assert [*columns] == [measured["cameras"], measured["cpu_seconds"], measured["memory_gb"]]

    def figures(cameras: int) -> list[int]:
        return [int(re.sub("[mM]$", "", value)) for value in deployment.demand(cameras).values()]

    assert figures(10) == figures(100)
    assert all(a < b < c for a, b, c in zip(figures(100), figures(500), figures(1000), strict=True))
    for number, seconds, gigabytes in rows:
        millicores, memory, memory_max = figures(int(number.replace(",", "")))
        assert millicores == pytest.approx(deployment.MARGIN * float(seconds) / 3.6, abs=1)
        assert memory == 1000 * float(gigabytes)
        assert memory_max == deployment.MARGIN * memory
    unit = (DEPLOY / "camtopod.service").read_text()
    [limit] = re.findall(r"^MemoryMax=(\d+)G$", unit, re.MULTILINE)
    assert int(limit) * 1024**3 >= figures(1000)[-1] * 10**6


# --- systemd --------------------------------------------------------------------------------------


def test_systemd_takes_the_units_of_the_districts(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("needs systemd-analyze (Debian: systemd)")
    folder, units = deployed(tmp_path, "systemd"), tmp_path / "units"
    units.mkdir()
    names = {
        "camtopod-router@.service": "camtopod-router@north.service",
        "camtopod@.service": "camtopod@north.service",
        "camtopod-grab-north@.service": "camtopod-grab-north@gate1.service",
        "camtopod-grab-south-1@.service": "camtopod-grab-south-1@yard.service",
    }
    assert {path.name for path in folder.glob("*.service")} == names.keys()
    for file, name in names.items():
        text = (folder / file).read_text()
        program = re.compile("^ExecStart=/(opt/camtopod/bin/camtopod|usr/bin/zenohd) ", re.M)
        assert len(program.findall(text)) == 1
        (units / name).write_text(program.sub("ExecStart=/bin/true ", text))
    for name in names.values():
        verify = ["systemd-analyze", "verify", "--man=no", str(units / name)]
        done = subprocess.run(verify, capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, ""), name
        exposure = ["systemd-analyze", "security", "--offline=true", "--no-pager", "--threshold=20"]
        done = subprocess.run([*exposure, str(units / name)], capture_output=True, text=True)
        assert done.returncode == 0, done.stdout


def test_the_units_of_districts_share_no_user_state_or_configuration(tmp_path: Path) -> None:
    folder = deployed(tmp_path, "systemd")
    daemon = (folder / "camtopod@.service").read_text()
    assert "\nUser=" not in daemon
    assert "\nStateDirectory=camtopod/%i\n" in daemon
    assert " --config /etc/camtopod/%i.toml " in daemon
    assert daemon.count(" camtopod-router@%i.service\n") == 2, "After and Wants"
    router = (folder / "camtopod-router@.service").read_text()
    assert " --config /etc/camtopod/%i.router.json5\n" in router
    for label in LABELS.values():
        grabber = (folder / f"camtopod-grab-{label}@.service").read_text()
        assert f" --config /etc/camtopod/{label}.toml " in grabber


def test_every_configuration_is_without_mistakes(tmp_path: Path) -> None:
    for kind in deployment.KINDS:
        folder = deployed(tmp_path, kind, DISTRICTS)
        for name in DISTRICTS:
            assert main(["check", str(folder / f"{name}.toml")]) == 0
            assert_delivers(load(folder / f"{name}.toml"), name, DISTRICTS)


@contextlib.contextmanager
def running(config: Path, state: Path) -> Iterator[None]:
    """Run a daemon in a process of its own, from when it is ready."""
    process = camtopod(
        "--config", str(config), "run", "--state", str(state), stderr=subprocess.PIPE
    )
    assert process.stderr is not None
    try:
        assert any(b"ready at" in line for line in process.stderr)
        yield
    finally:
        process.terminate()
        process.communicate(timeout=WAIT_SECONDS)


def test_the_events_of_a_border_camera_reach_the_daemons_of_both_districts(tmp_path: Path) -> None:
    """As the files say, but for the ports, which are free ones, and with a router of Python."""
    folder = deployed(tmp_path, "systemd")
    ports = {f"tcp/127.0.0.1:{deployment.ROUTER_PORT + k}": free_endpoint() for k in range(2)}
    for path in (*folder.glob("*.toml"), *folder.glob("*.json5")):
        text = path.read_text()
        for endpoint, free in ports.items():
            text = text.replace(endpoint, free)
        path.write_text(text)
    counts = {"gate1": 3, "gate2": 20, "yard": 5}
    heard = {"north": 3 + 20, "South_1": 20 + 5}
    with contextlib.ExitStack() as stack:
        for label in LABELS.values():
            router = zenoh.Config.from_file(str(folder / f"{label}.router.json5"))
            stack.enter_context(zenoh.open(router))
        for label in LABELS.values():
            stack.enter_context(running(folder / f"{label}.toml", tmp_path / f"state-{label}"))

        for name, label in LABELS.items():
            cameras = [camera for camera in TWO[name].cameras if camera in counts]
            events = [
                Event(camera, "entry", T0 + n) for camera in cameras for n in range(counts[camera])
            ]
            recording = tmp_path / f"{label}.jsonl"
            recording.write_bytes(b"".join(to_json(event) + b"\n" for event in events))
            ingest = ["ingest", "jsonl", str(recording), "--state", str(tmp_path / f"box-{label}")]
            assert main(["--config", str(folder / f"{label}.toml"), *ingest]) == 0

        for name, label in LABELS.items():
            bus = stack.enter_context(dial(load(folder / f"{label}.toml")))

            def stored(bus: Any = bus) -> int:
                [(_, status)] = bus.query("status/daemon", {"format": "application/json"}, one=True)
                return int(json.loads(status)["events"]["stored"])

            wait_for(lambda name=name, stored=stored: stored() >= heard[name], "the events")
            assert stored() == heard[name]


# --- the command ----------------------------------------------------------------------------------


def test_a_cut_is_written_and_deployed_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("whole.json").write_bytes(to_json(CITY))
    cut = ["districts", "whole.json", "--cameras-max", "12", "--out", "cut.toml"]
    assert main([*cut, "--deploy", "kubernetes", "a city"]) == 0
    err = capsys.readouterr().err.splitlines()
    assert err[-2].endswith(" 'a city'/*.yaml")
    assert err[-1] == "     kubectl apply -f 'a city'"

    assert main(["districts", "cut.toml", "--deploy", "systemd", "units"]) == 0
    labels = districts_file.load(Path("cut.toml"))
    assert capsys.readouterr().err.endswith(" ".join(f"camtopod@{name}" for name in labels) + "\n")
    assert {path.stem for path in Path("a city").iterdir()} == labels.keys()

    content = io.BufferedReader(io.BytesIO(Path("cut.toml").read_bytes()))  # type: ignore[arg-type]
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(content))
    assert main(["districts", "-", "--deploy", "systemd", "again"]) == 0
    for path in Path("units").iterdir():
        assert Path("again", path.name).read_bytes() == path.read_bytes()


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = deployed(tmp_path, "systemd")
    (folder / "north.toml").write_text("mine")
    again = ["districts", str(tmp_path / "districts.toml"), "--deploy", "systemd"]
    assert main([*again, str(folder)]) == 1
    assert f"{folder} is not empty: give --deploy a new folder" in capsys.readouterr().err
    assert main([*again, str(folder / "north.toml")]) == 1
    assert "cannot write" in capsys.readouterr().err
    assert (folder / "north.toml").read_text() == "mine"


def hearers(number: int) -> Districts:
    """Return a district that hears a camera of each of a number of others, which hear its own."""
    return {
        "a": District(("a",), tuple(f"b{n}" for n in range(number))),
        **{f"b{n}": District((f"b{n}",), ("a",)) for n in range(number)},
    }


def large(number: int) -> Districts:
    return {"a": District(tuple(f"c{n}" for n in range(number)))}


@pytest.mark.parametrize(
    ("districts", "sentence"),
    [
        ({"a_b": District(("x",)), "A.b": District(("y",))}, "district A.b: its name in"),
        ({"..": District(("x",))}, "district ..: its name in Kubernetes and systemd would be --"),
        ({"a" * 44: District(("x",))}, "1 to 43 letters"),
        (hearers(SITES_MAX), f"a camera of a has more than {SITES_MAX} sites"),
        (large(Limits().cameras_max + 1), "district a hears more than 1000 cameras"),
    ],
)
def test_districts_that_could_not_run_are_refused(
    districts: Districts, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "districts.toml").write_text(districts_file.to_toml(districts))
    for kind in deployment.KINDS:
        arguments = ["districts", str(tmp_path / "districts.toml"), "--deploy", kind]
        assert main([*arguments, str(tmp_path / kind)]) == 1
        assert sentence in capsys.readouterr().err
        assert not (tmp_path / kind).exists()


@pytest.mark.parametrize(
    "districts", [{"a" * 43: District(("x",))}, hearers(SITES_MAX - 1), large(Limits().cameras_max)]
)
def test_the_largest_are_taken(districts: Districts, tmp_path: Path) -> None:
    folder = deployed(tmp_path, "kubernetes", districts)
    for path in folder.glob("*.toml"):
        assert load(path).site.name == tomllib.loads(path.read_text())["site"]["name"]


@pytest.mark.parametrize(
    "options", [[], ["--deploy", "nomad", "x"], ["--table", "t.csv", "--deploy", "systemd", "x"]]
)
def test_usage(options: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("districts.toml").write_text(districts_file.to_toml(TWO))
    assert main(["districts", "districts.toml", *options]) == exits.USAGE
    assert [path.name for path in tmp_path.iterdir()] == ["districts.toml"]
