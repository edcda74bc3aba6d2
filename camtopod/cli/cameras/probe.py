"""A look at several cameras at once, each in a process of its own, which may hang or crash."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

import msgspec

from camtopod.cli import exits
from camtopod.cli.cameras.camera_process import in_words
from camtopod.cli.exits import CommandError
from camtopod.config import Config, toml_lines
from camtopod.redact import redact, remember
from camtopod.serve.bus import BusError, dial
from camtopod.visible import visible
from camtopod.vision import VisionSettings
from camtopod.vision.source import LOOK_SECONDS, Probe, Question
from camtopod.web import pictures

PROGRAM = "camtopod.vision.source.probe"
PROCESSES_MAX = 8
START_SECONDS = 30.0
"""What a process may take beyond its look, to load its libraries on a machine that is busy."""


def probe_all(
    sources: Mapping[str, str],
    settings: VisionSettings,
    on_probe: Callable[[str, Probe], None],
    folder: Path | None = None,
) -> dict[str, Probe]:
    """What each source is like, by the camera's id; ``on_probe`` is told as soon as one is known.

    A picture of each camera that gives one is kept in ``folder``. Raises `CommandError` if that
    cannot be.
    """
    for source in sources.values():
        remember(source)
    if folder is not None:
        with _writing(folder):
            pictures.make(folder)
    with ThreadPoolExecutor(PROCESSES_MAX) as pool:
        looks = {
            pool.submit(_probe, source, settings, folder is not None): name
            for name, source in sources.items()
        }
        found = {}
        for look in as_completed(looks):
            camera, seen = looks[look], look.result()
            if folder is not None and seen.picture:
                with _writing(folder):
                    pictures.keep(folder, camera, seen.picture)
            found[camera] = msgspec.structs.replace(seen, picture=b"")
            on_probe(camera, found[camera])
    return {camera: found[camera] for camera in sources}


@contextlib.contextmanager
def _writing(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise CommandError(
            f"--pictures {folder}: cannot write {error.filename or folder}: {error.strerror}"
        ) from None


def _probe(source: str, settings: VisionSettings, picture: bool) -> Probe:
    """The source goes to the process through a pipe, as everybody can read a command line."""
    seconds = (
        settings.open_timeout_seconds + settings.read_timeout_seconds + LOOK_SECONDS + START_SECONDS
    )
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-m", PROGRAM],
            input=msgspec.json.encode(Question(source, settings, picture)),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # libraries write there, perhaps with the password
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join(sys.path),
            },  # it finds the same modules as this process
            timeout=seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Probe(f"no answer within {seconds:.0f} s")
    if done.returncode != 0:
        return Probe(f"the process that looked at it {in_words(done.returncode)}")
    return msgspec.json.decode(done.stdout, type=Probe)


def check_site(path: Path, config: Config, folder: Path | None) -> int:
    """Open every camera and the bus; what is found goes to standard error, a line each. The worst
    exit status.

    Pictures of the cameras are kept in ``folder``.
    """
    lines = toml_lines.key_lines(path.read_text(encoding="utf-8"))
    status = exits.DONE

    def tell(camera: str, probe: Probe) -> None:
        nonlocal status
        status = max(status, exits.INPUT if probe.problem else exits.DONE)
        where = f"{path}:{lines.get(('cameras', camera), 1)}: cameras.{camera}"
        print(visible(redact(f"{where}: {'; '.join(probe.words)}")), file=sys.stderr, flush=True)

    sources = {}
    for camera in config.cameras:
        try:
            sources[camera] = config.for_camera(camera).cameras[camera].source
        except OSError as error:
            tell(camera, Probe(f"cannot read {error.filename}: {error.strerror}"))
    probe_all(sources, config.vision, tell, folder)
    problem, found = _bus(config)
    print(visible(f"{path}: bus: {redact(problem or found)}"), file=sys.stderr)
    return max(status, exits.BUS if problem else exits.DONE)


def _bus(config: Config) -> tuple[str, str]:
    """What is wrong with the bus, or "", and what is there."""
    camera = next(iter(config.cameras), "")
    try:
        with dial(config.certified(camera)) as bus:
            if (
                not bus.present("daemon") and not config.bus.tls.ca
            ):  # which a camera's certificate is not shown
                return (
                    f"{bus.endpoint} is reached, but no daemon of site {bus.site} is there: `camtopod run`",
                    "",
                )
            return "", f"{bus.endpoint} is reached, site {bus.site}"
    except BusError as error:
        return str(error), ""
