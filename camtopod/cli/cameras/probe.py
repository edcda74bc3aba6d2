"""Probe several cameras at once, each in a process of its own, which may hang or crash."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from types import MappingProxyType

import msgspec

from camtopod.cli import exits
from camtopod.cli.cameras.camera_process import exit_reason
from camtopod.cli.exits import CommandError
from camtopod.cli.site_choice import right_site
from camtopod.config import Config, detector_line, toml_lines
from camtopod.redact import redact, remember
from camtopod.serve.bus import BusError, dial
from camtopod.visible import visible
from camtopod.vision.detector.model_report import ModelReport
from camtopod.vision.settings import DetectorSettings, VisionSettings
from camtopod.vision.source import PROBE_SECONDS, SETTLE_SECONDS_MAX, Probe, ProbeRequest
from camtopod.web import pictures

PROGRAM = "camtopod.vision.source.probe"
"""Module that the process runs."""
PROCESSES_MAX = 8
"""Most processes at a time."""
START_SECONDS = 30.0
"""Time allowed beyond the probe itself, to load libraries on a busy machine."""


def probe_all(
    sources: Mapping[str, str],
    settings: Mapping[str, VisionSettings],
    on_probe: Callable[[str, Probe], None],
    folder: Path | None = None,
    detectors: Mapping[str, DetectorSettings] = MappingProxyType({}),
) -> dict[str, Probe]:
    """Probe each source; return the results by camera id.

    settings, detectors: those of each camera; detectors may be missing.
    on_probe: called with each result as soon as it is known.
    folder: where to keep a picture of each camera that gives one. Raises `CommandError` if it
        cannot be written.
    """
    for source in sources.values():
        remember(source)
    if folder is not None:
        with _writing(folder):
            pictures.make_folder(folder)

    # Probe all, and handle each result as soon as it is known.
    with ThreadPoolExecutor(PROCESSES_MAX) as pool:
        looks = {
            pool.submit(
                _probe, source, settings[name], folder is not None, detectors.get(name)
            ): name
            for name, source in sources.items()
        }
        found = {}
        for look in as_completed(looks):
            camera = looks[look]
            seen = look.result()
            if folder is not None and seen.picture:
                with _writing(folder):
                    pictures.store_picture(folder, camera, seen.picture)
            found[camera] = msgspec.structs.replace(seen, picture=b"")
            on_probe(camera, found[camera])
    return {camera: found[camera] for camera in sources}


@contextlib.contextmanager
def _writing(folder: Path) -> Iterator[None]:
    """Turn an OSError of the block into a `CommandError` about --pictures."""
    try:
        yield
    except OSError as error:
        raise CommandError(
            f"--pictures {folder}: cannot write {error.filename or folder}: {error.strerror}"
        ) from None


def _probe(
    source: str, settings: VisionSettings, picture: bool, detector: DetectorSettings | None
) -> Probe:
    """Probe one source in a process, which gets it through a pipe: command lines are public."""
    request = ProbeRequest(source, settings, picture, detector or DetectorSettings())
    seconds = (
        settings.open_timeout_seconds
        + settings.read_timeout_seconds
        + PROBE_SECONDS
        + (SETTLE_SECONDS_MAX if picture else 0.0)
        + START_SECONDS
    )
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-m", PROGRAM],
            input=msgspec.json.encode(request),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # libraries write there, perhaps with the password
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join(sys.path),
            },  # so that it finds the same modules
            timeout=seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return Probe(f"no answer within {seconds:.0f} s")
    if done.returncode != 0:
        return Probe(f"the process that probed it {exit_reason(done.returncode)}")
    return msgspec.json.decode(done.stdout, type=Probe)


def check_site(path: Path, config: Config, folder: Path | None) -> int:
    """Open every camera and the bus, print one line about each, and return the worst exit status.

    folder: where to keep pictures of the cameras, or None.
    """
    text = path.read_text(encoding="utf-8")
    lines = toml_lines.key_lines(text)
    status = exits.DONE

    def tell(camera: str, probe: Probe) -> None:
        nonlocal status
        status = max(status, exits.INPUT if probe.problem else exits.DONE)
        where = f"{path}:{lines.get(('cameras', camera), 1)}: cameras.{camera}"
        print(visible(redact(f"{where}: {'; '.join(probe.lines)}")), file=sys.stderr, flush=True)
        tell_detector(camera, probe.detector)

    def tell_detector(camera: str, found: ModelReport) -> None:
        nonlocal status
        status = max(status, exits.CONFIG if found.problem else exits.DONE)
        line, name = detector_line(text, camera, found.key)
        if found.problem or found.text:
            of = f" (camera {camera})" if camera and not name.startswith("cameras.") else ""
            text_of_model = found.problem or found.text
            print(
                visible(redact(f"{path}:{line}: {name}: {text_of_model}{of}")),
                file=sys.stderr,
                flush=True,
            )

    # Read the sources, then open cameras and bus.
    sources = {}
    for camera in config.cameras:
        try:
            if source := config.for_camera(camera).cameras[camera].source:
                sources[camera] = source
        except OSError as error:
            tell(camera, Probe(f"cannot read {error.filename}: {error.strerror}"))
    settings = {camera: config.cameras[camera].vision for camera in sources}
    detectors = {camera: config.cameras[camera].detector for camera in config.cameras}
    probe_all(sources, settings, tell, folder, detectors)

    # Detectors of cameras that cannot be opened here.
    others = {camera: one for camera, one in detectors.items() if camera not in sources}
    for camera, detector in (others if config.cameras else {"": config.detector}).items():
        if detector.model:
            tell_detector(camera, _probe("", config.vision, False, detector).detector)
    problem, found = _bus(config)
    print(visible(f"{path}: bus: {redact(problem or found)}"), file=sys.stderr)
    return max(status, exits.BUS if problem else exits.DONE)


def _bus(config: Config) -> tuple[str, str]:
    """Return (problem or "", state) of the bus."""
    camera = next(iter(config.cameras), "")
    try:
        with dial(config.certified(camera)) as bus:
            # A camera's certificate does not allow to see whether a daemon is there.
            if not bus.list_alive("daemon") and not config.bus.tls.ca:
                return (
                    f"connected to {bus.endpoint}, but no daemon of site {bus.site} is there"
                    f"{right_site(bus, config) or ': start it with `camtopod run`'}",
                    "",
                )
            return "", f"connected to {bus.endpoint}, site {bus.site}"
    except BusError as error:
        return str(error), ""
