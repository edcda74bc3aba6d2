"""Files that run the districts of a city: in Kubernetes, or by systemd on one machine.

Each has a template in `templates`. `deploy/generate.py` makes the files of a single site from them.
"""

from __future__ import annotations

import json
import math
import re
import shlex
import textwrap
from importlib import resources
from itertools import chain
from pathlib import Path

import numpy as np

from camtopod.cli.common import open_output, say, writing
from camtopod.cli.exits import CommandError
from camtopod.config import SITES_MAX, Districts, Limits, districts_file

MEASURED = {"cameras": (100, 1_000), "cpu_seconds": (82.0, 303.0), "memory_gb": (0.37, 0.97)}
"""Processor time of daemons in an hour, and their peak memory, by the number of cameras of their
site (deploy/large.md).
"""
MARGIN = 2.0
"""Limit of a daemon, in multiples of the measured figures."""
ROUTER_PORT = 7447
"""Port of the router of the first district on a machine; each further one has the next."""
LABEL = re.compile("[a-z0-9]([a-z0-9-]{0,41}[a-z0-9])?")
"""A name in Kubernetes (DNS-1123), with space for a prefix and a suffix."""
KINDS = {
    "kubernetes": (
        {"{}.yaml": "kubernetes.yaml", "{}.toml": "district.toml"},
        "now: sed -i 's,image: camtopod,image: REGISTRY/camtopod,' {folder}/*.yaml\n"
        "     kubectl apply -f {folder}",
    ),
    "systemd": (
        {
            "camtopod@.service": "daemon.service",
            "camtopod-router@.service": "router.service",
            "camtopod-grab-{}@.service": "grabber.service",
            "{}.router.json5": "router.json5",
            "{}.toml": "district.toml",
        },
        "now: mkdir -p /etc/camtopod && cp -i {folder}/*.toml {folder}/*.json5 /etc/camtopod && "
        "cp -i {folder}/*.service /etc/systemd/system\n"
        "     systemctl daemon-reload && systemctl enable --now {units}",
    ),
}
"""Kind -> template of each file, in whose name {} is the district's, and the steps that follow."""


def filled(template: str, **values: str) -> str:
    """Return a template in which @NAME@ is replaced by a value, or by the template of that name.

    Lines of a value are indented as its place is.
    """

    def value(place: re.Match[str]) -> str:
        indent, name = place.groups()
        return textwrap.indent(
            values[name] if name in values else filled(name, **values).rstrip(), indent
        )

    path = resources.files(__package__) / "templates" / template
    return re.sub("( *)@([A-Za-z0-9_.]+)@", value, path.read_text("utf-8"))


def demand(cameras: int) -> dict[str, str]:
    """Return the requests and limits of a site's daemon in Kubernetes: processor and memory.

    cameras: number of cameras that the site hears.
    """
    cpu_seconds, memory_gb = (
        float(np.interp(cameras, MEASURED["cameras"], MEASURED[name]))
        for name in ("cpu_seconds", "memory_gb")
    )
    return {
        "CPU": f"{math.ceil(MARGIN * cpu_seconds / 3.6)}m",
        "MEMORY": f"{math.ceil(1000 * memory_gb)}M",
        "MEMORY_MAX": f"{math.ceil(1000 * MARGIN * memory_gb)}M",
    }


def names_by_label(districts: Districts) -> dict[str, str]:
    """Return each district by its name in files, units and Kubernetes. Raises `CommandError`."""
    names: dict[str, str] = {}
    for name, district in districts.items():
        label = re.sub("[_.]", "-", name.lower())
        if not LABEL.fullmatch(label) or names.setdefault(label, name) != name:
            raise CommandError(
                f"district {name}: its name in Kubernetes and systemd would be {label}, which must "
                "have 1 to 43 letters, digits and '-', no '-' at an end, and be no other's"
            )
        if len(district.cameras) + len(district.hears) > Limits().cameras_max:
            raise CommandError(f"district {name} hears more than {Limits().cameras_max} cameras")
    return names


def texts_of(kind: str, districts: Districts) -> dict[str, str]:
    """Return the text of each file of a kind of deployment. Raises `CommandError`."""
    names = names_by_label(districts)
    endpoints = {
        name: f"tcp/127.0.0.1:{ROUTER_PORT + k}" if kind == "systemd" else f"tcp/zenoh-{label}:7447"
        for k, (label, name) in enumerate(names.items())
    }
    sites_by_camera = districts_file.sites_by_camera(districts)
    texts: dict[str, str] = {}
    for label, name in names.items():
        district, endpoint = districts[name], endpoints[name]
        sites = {camera: sites_by_camera[camera] for camera in district.cameras}
        if max(map(len, sites.values())) > SITES_MAX:
            raise CommandError(f"a camera of {name} has more than {SITES_MAX} sites")
        tables = [
            *(
                f"[sites.{json.dumps(site)}]\nconnect = {json.dumps([endpoints[site]])}\n"
                for site in sorted({*chain(*sites.values())} - {name})
            ),
            *(
                f'[cameras.{json.dumps(camera)}]\n# source = "rtsp://192.0.2.12:554/stream1"\n'
                + (f"sites = {json.dumps(sites[camera])}\n" if len(sites[camera]) > 1 else "")
                for camera in district.cameras
            ),
        ]
        values = {
            **demand(len(district.cameras) + len(district.hears)),
            "SITE": name,
            "ENDPOINT": endpoint,
            "TABLES": "\n".join(tables),
            "DAEMON": f"camtopod-{label}",
            "ROUTER": f"zenoh-{label}",
            "LISTEN": endpoint if kind == "systemd" else "tcp/0.0.0.0:7447",
            "HEAD": "# The daemon of a district: systemctl enable --now camtopod@DISTRICT",
            "TITLE": "camtopod daemon of district %i",
            "AFTER": " camtopod-router@%i.service",
            "DAEMON_CONFIG": "%i",
            "USER": "",
            "STATE": "camtopod/%i",
            "GRABBER": f"camtopod-grab-{label}",
            "CONFIG": label,
        }
        texts |= {
            file.format(label): filled(template, **values)
            for file, template in KINDS[kind][0].items()
        }
    return texts


def write(districts: Districts, kind: str, folder: str) -> None:
    """Write the files into a new folder, and print the next steps. Raises `CommandError`."""
    texts = texts_of(kind, districts)
    with writing(folder):
        Path(folder).mkdir(parents=True, exist_ok=True)
        if any(Path(folder).iterdir()):
            raise CommandError(f"{folder} is not empty: give --deploy a new folder")
    for file, text in texts.items():
        with open_output(Path(folder, file)) as output:
            output.write(text.encode())
    say(
        KINDS[kind][1].format(
            folder=shlex.quote(folder),
            units=" ".join(f"camtopod@{label}" for label in names_by_label(districts)),
        )
    )
