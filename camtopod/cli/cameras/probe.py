"""Probe several cameras at once, each in a process of its own, which may hang or crash."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

import msgspec
from msgspec.structs import replace

from camtopod.cli import exits
from camtopod.cli.cameras.camera_process import exit_reason
from camtopod.cli.common import say, writing
from camtopod.cli.site_choice import right_site
from camtopod.config import CameraSettings, Config, detector_line, key_lines, secret_files
from camtopod.redact import remember
from camtopod.serve.bus import BusError, access, dial
from camtopod.visible import visible
from camtopod.vision.detector.model import ModelReport
from camtopod.vision.settings import DetectorSettings
from camtopod.vision.source import PROBE_SECONDS_MAX, SETTLE_SECONDS_MAX, Probe, ProbeRequest

PROGRAM = "camtopod.vision.source.probe"
"""Module that the process runs."""
START_SECONDS = 30.0
"""Time allowed beyond the probe itself, to load libraries on a busy machine."""


def probe_all(
    cameras: Mapping[str, CameraSettings],
    on_probe: Callable[[str, Probe], None],
    folder: Path | None = None,
) -> dict[str, Probe]:
    """Probe the source and the detector of each camera; return the results by camera id.

    on_probe: called with each result as soon as it is known.
    folder: where to keep a picture of each camera that gives one. Raises `CommandError` if it
        cannot be written.
    """
    for settings in cameras.values():
        remember(settings.source)
    if folder is not None:
        with writing(folder):
            folder.mkdir(mode=0o750, parents=True, exist_ok=True)

    # Probe all, and handle each result as soon as it is known.
    with ThreadPoolExecutor(8) as pool:
        futures = {
            pool.submit(_probe, settings, folder is not None): camera
            for camera, settings in cameras.items()
        }
        probes = {}
        for future in as_completed(futures):
            camera = futures[future]
            probe = future.result()
            if folder is not None and probe.picture:
                with writing(folder):
                    secret_files.write(folder / f"{camera}.jpg", probe.picture, 0o640)
            probes[camera] = replace(probe, picture=b"")
            on_probe(camera, probes[camera])
    return {camera: probes[camera] for camera in cameras}


def _probe(settings: CameraSettings, picture: bool) -> Probe:
    """Probe one camera in a process, which gets it through a pipe: command lines are public."""
    request = ProbeRequest(settings.source, settings.vision, picture, settings.detector)
    seconds = PROBE_SECONDS_MAX + (SETTLE_SECONDS_MAX if picture else 0.0) + START_SECONDS
    try:
        process = subprocess.run(
            [sys.executable, "-P", "-m", PROGRAM],
            input=msgspec.json.encode(request),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,  # libraries write there, perhaps with the password
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},  # to find the same modules
            timeout=seconds,
            check=False,
        )
        if process.returncode == 0:
            return msgspec.json.decode(process.stdout, type=Probe)
        reason = f"the process that tried it: {exit_reason(process.returncode)}"
    except subprocess.TimeoutExpired:
        reason = f"no answer within {seconds:.0f} s"

    # What the library died of: the model, if it dies of that alone, or the source.
    model = settings.detector.model
    if model and not settings.source:
        return Probe(detector=ModelReport(f"cannot run {model}: {reason}"))
    if model and (report := try_detector(settings.detector)).problem:
        return Probe(detector=report)
    return Probe(reason)


def try_detector(detector: DetectorSettings) -> ModelReport:
    """Load and run a model in a process of its own, as its engine may crash on it."""
    return _probe(CameraSettings(detector=detector), picture=False).detector


def check_site(path: Path, config: Config) -> int:
    """Open every camera and the bus, print one line about each, and return the worst exit status.

    Where the configuration has a folder for the cameras' pictures, they are renewed.
    """
    text = path.read_text(encoding="utf-8")
    lines = key_lines(text)
    statuses = [exits.DONE]

    def tell(camera: str, probe: Probe) -> None:
        if probe.problem or probe.codec:
            place = f"{path}:{lines.get(('cameras', camera), 1)}: cameras.{camera}"
            say(visible(f"{place}: {'; '.join(probe.lines)}"))
        if probe.problem:
            statuses.append(exits.INPUT)
        if about := probe.detector.problem or probe.detector.text:
            line, name = detector_line(text, camera, probe.detector.key)
            if camera and not name.startswith("cameras."):
                about += f" (camera {camera})"
            say(visible(f"{path}:{line}: {name}: {about}"))
        if probe.detector.problem:
            statuses.append(exits.CONFIG)

    # Read the sources, then open the cameras. Detectors are run also without a source here.
    cameras = dict(config.cameras) or {"": config.new_camera}
    for camera in config.cameras:
        try:
            cameras[camera] = config.for_camera(camera).cameras[camera]
        except OSError as error:
            tell(camera, Probe(f"cannot read {error.filename}: {error.strerror}"))
    probe_all(
        {
            name: camera_settings
            for name, camera_settings in cameras.items()
            if camera_settings.source or camera_settings.detector.model
        },
        tell,
        config.web.pictures_folder,
    )

    # Open the bus.
    status, state = _bus(config)
    say(visible(f"{path}: bus: {state}"))
    return max(*statuses, status)


def _bus(config: Config) -> tuple[int, str]:
    """Return exit status and state of the bus."""
    try:
        access.check_files(config)
    except BusError as error:
        return exits.BUS, str(error)
    try:
        with dial(config.certified(next(iter(config.cameras), ""))) as bus:
            # A camera's certificate does not allow to see whether a daemon is there.
            if bus.list_alive("daemon") or config.bus.tls.ca:
                return exits.DONE, f"connected to {bus.endpoint}, site {bus.site}"
            advice = right_site(bus, config) or ": start it with `camtopod run`"
            return exits.BUS, (
                f"connected to {bus.endpoint}, but no daemon of site {bus.site} is there{advice}"
            )
    except BusError as error:
        if config.listens:  # it is this machine that begins it
            return exits.DONE, f"not there yet: `camtopod run` begins it at {config.listens[0]}"
        return exits.BUS, str(error)
