"""The container files: commands exist, confinement is complete, and a router runs as configured."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import yaml
import zenoh
from paths import DEPLOY
from serving import free_endpoint, small_config, wait_for

from camtopod.cli.main import COMMANDS, parser_of
from camtopod.config.config_file import parse
from camtopod.config.settings import Config
from camtopod.keys import rules
from camtopod.records import Event
from camtopod.serve import bus as buses

COMPOSE = yaml.safe_load((DEPLOY / "compose.yaml").read_text())
KUBERNETES = list(yaml.safe_load_all((DEPLOY / "kubernetes.yaml").read_text()))
CONTAINERFILE = (DEPLOY / "Containerfile").read_text()
[USER] = re.findall(r"^USER (\S+)$", CONTAINERFILE, re.MULTILINE)
[ENTRYPOINT] = map(json.loads, re.findall(r"^ENTRYPOINT (.*)$", CONTAINERFILE, re.MULTILINE))


def of_kind(kind: str) -> list[dict[str, Any]]:
    return [document for document in KUBERNETES if document["kind"] == kind]


def containers() -> list[dict[str, Any]]:
    sets = of_kind("Deployment") + of_kind("StatefulSet")
    return [one for each in sets for one in each["spec"]["template"]["spec"]["containers"]]


def routers(tmp_path: Path) -> dict[str, zenoh.Config]:
    """Return every router configuration, as zenoh reads it."""
    [config_map] = of_kind("ConfigMap")
    inline = tmp_path / "inline.json5"
    inline.write_text(config_map["data"]["router.json5"])
    return {
        "own": zenoh.Config.from_file(str(DEPLOY / "router.json5")),
        "kubernetes": zenoh.Config.from_file(str(inline)),
    }


def test_compose_confines_the_container() -> None:
    confined = {
        "user": USER,
        "read_only": True,
        "cap_drop": ["ALL"],
        "security_opt": ["no-new-privileges:true"],
    }
    [service] = COMPOSE["services"].values()
    assert service.items() >= confined.items()
    assert not {"privileged", "network_mode", "pid", "ipc"} & set(service)
    assert all(port.startswith("127.0.0.1:") for port in service["ports"])
    [config] = [volume for volume in service["volumes"] if ":/etc/camtopod" in volume]
    assert config.endswith(":ro")
    assert {"healthcheck", "mem_limit", "pids_limit"} <= service.keys()


def test_compose_starts_what_there_is() -> None:
    parser, _ = parser_of(COMMANDS)
    [service] = COMPOSE["services"].values()
    args = parser.parse_args([*ENTRYPOINT[1:], *service["command"]])
    assert (args.command, args.listen) == ("up", "0.0.0.0:8780")
    named = {volume.split(":")[0] for volume in service["volumes"]}
    assert set(COMPOSE["volumes"]) == {name for name in named if name.isalpha()}
    extras = re.findall(r"/source\[([a-z,]+)\]", CONTAINERFILE)
    assert extras == ["metrics,mqtt,web"]


def test_kubernetes_confines_every_container_and_starts_what_there_is() -> None:
    confined = {
        "runAsNonRoot": True,
        "runAsUser": int(USER.split(":")[0]),
        "readOnlyRootFilesystem": True,
        "allowPrivilegeEscalation": False,
        "capabilities": {"drop": ["ALL"]},
    }
    for container in containers():
        assert container["securityContext"].items() >= confined.items()
        assert "memory" in container["resources"]["limits"]
    [daemon] = [container for container in containers() if container["image"] == "camtopod"]
    parser, _ = parser_of(COMMANDS)

    assert parser.parse_args([*ENTRYPOINT[1:], *daemon["args"]]).command == "run"
    [config_map] = of_kind("ConfigMap")
    listen = parse(config_map["data"]["camtopod.toml"]).health.listen
    [port] = daemon["ports"]
    assert listen == f"0.0.0.0:{port['containerPort']}"
    [stateful] = of_kind("StatefulSet")
    assert stateful["spec"]["template"]["metadata"]["annotations"] == {
        "prometheus.io/scrape": "true",
        "prometheus.io/port": str(port["containerPort"]),
        "prometheus.io/path": "/metrics",
    }


def test_images_are_pinned() -> None:
    images = [container["image"] for container in containers()]
    for image in images:
        assert image == "camtopod" or re.fullmatch(r"docker\.io/eclipse/zenoh:1\.10\.[0-9]+", image)


def test_a_router_looks_for_nobody(tmp_path: Path) -> None:
    """Like the daemon's own session and the router with certificates."""
    quiet = rules.session_settings("router")
    for name, config in routers(tmp_path).items():
        for path, value in quiet.items():
            if path == "mode" or path.endswith("/enabled"):
                assert json.loads(config.get_json(path)) == value, (name, path)
        assert json.loads(config.get_json("listen/endpoints")) == ["tcp/0.0.0.0:7447"]
        largest = json.loads(config.get_json("transport/link/rx/max_message_size"))
        assert largest == Config().bus.message_bytes_max


def test_events_pass_a_router(tmp_path: Path) -> None:
    endpoint, config = free_endpoint(), routers(tmp_path)["own"]
    config.insert_json5("listen/endpoints", json.dumps([endpoint]))
    client = small_config(tmp_path, endpoint)
    received: list[str] = []
    with zenoh.open(config), buses.dial(client) as grabber, buses.dial(client) as daemon:
        daemon.subscribe("event/*", lambda key, content: received.append(key))

        def passed() -> bool:
            grabber.publish("event/a", Event("a", "entry", 1.0), "event")
            return received != []

        wait_for(passed, "an event")

    assert set(received) == {"event/a"}
