"""`camtopod grab`: turn the video of a camera into events, on the bus or as lines of a file.

Without ``--camera`` it supervises one such process for each camera of a configuration.
"""

from __future__ import annotations

import argparse
import contextlib
import logging
import math
import os
import threading
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from camtopod import codec, redact
from camtopod.cli import exits
from camtopod.cli.cameras.heartbeat import HeartbeatSender
from camtopod.cli.common import (
    SignalRequests,
    camera_id,
    configuration,
    counted,
    ends_within,
    is_standard_output,
    open_output,
    signals,
    start_logging,
)
from camtopod.cli.exits import CommandError
from camtopod.config import CameraSettings, Config, detector_line
from camtopod.serve.runtime import clock, systemd
from camtopod.vision.detector.errors import DetectorError
from camtopod.vision.source import RETRY_SEPARATOR, FileOptions, captured_log, kind_of

if TYPE_CHECKING:
    from camtopod.records import Event
    from camtopod.vision.detector.detector import Detector
    from camtopod.vision.grabber import Grabber
    from camtopod.vision.pipeline import Analysis, Observer
    from camtopod.vision.settings import VisionSettings
    from camtopod.vision.show import Preview

log = logging.getLogger(__name__)

DRAIN_SECONDS = 10.0
"""Time that the grabber of a file waits until its events are stored, unless it is supervised."""
EVENTS_PER_MINUTE_MAX = 120
"""Events that people make within a minute at most: each second one enters and one leaves."""
LEAVE_SECONDS = 4.0
"""Time that a blocking source may delay the end after a signal."""


def add_parser(add: Any) -> None:
    """Add `grab`."""
    parser = add(
        description="Watches one camera and publishes an event for each person who enters or "
        "leaves its view. Without --camera it runs all cameras of --config, one process per "
        "camera. Settings are those of [vision] and [cameras.ID]; SOURCE replaces the one there.",
        epilog="example: camtopod grab --camera lobby rtsp://192.0.2.10/stream1",
    )
    parser.add_argument(
        "source",
        nargs="?",
        metavar="SOURCE",
        help="rtsp:// URL, video file or device number. What is learned from a video that is "
        "played again and again is not real",
    )
    parser.add_argument(
        "--camera", metavar="ID", type=camera_id, help="the camera's id, [A-Za-z0-9_.-]{1,64}"
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        help="write event lines to FILE ('-': standard output) instead of the bus",
    )
    parser.add_argument(
        "--show",
        metavar="FILE",
        type=Path,
        help="draw what the grabber sees into FILE on this machine, readable by you alone: .mp4: a "
        "video of the whole time; .jpg or .png: one image that is replaced every 2 seconds. "
        "Boxes and paths of the tracks, foreground, ignored areas, doors, events, and why each "
        "track became an event or not. It shows people; it is not sent",
    )
    parser.add_argument(
        "--explain",
        action="store_true",
        help="write a line to standard error for each object that appears and each track that "
        "ends: what it was taken for, and why it became an event or not",
    )
    parser.add_argument(
        "--start",
        type=float,
        default=0.0,
        metavar="SECONDS",
        help="video file: event time of its first frame (default 0)",
    )
    parser.add_argument(
        "--realtime",
        action="store_true",
        help="video file: read it in real time instead of as fast as possible",
    )
    parser.add_argument(
        "--state", metavar="DIRECTORY", help="directory of the spool (default: [state] directory)"
    )
    # Options that the supervisor passes to a camera's process.
    parser.add_argument("--restarts", type=int, default=0, help=argparse.SUPPRESS)
    parser.add_argument("--last-end", default="", help=argparse.SUPPRESS)


def run(args: argparse.Namespace) -> int:
    """Grab until the file ends or a signal arrives."""
    start_logging(args)
    with signals() as requests:
        if args.camera is None:
            return _all(args, requests)
        with ends_within(requests.stop, LEAVE_SECONDS, args.with_parent):
            try:
                return _one(args, requests.stop)
            except DetectorError as error:
                raise CommandError(
                    f"camera {args.camera}: its detector fails: {error}; `camtopod check --probe` "
                    f"tries it on a picture, and detector = false in [cameras.{args.camera}] does "
                    "without one"
                ) from None


def _all(args: argparse.Namespace, requests: SignalRequests) -> int:
    """Supervise one process for each camera of the configuration."""
    from camtopod.cli.cameras.supervisor import supervise

    config = configuration(args)
    if args.source is not None or args.out is not None or args.show is not None or args.explain:
        raise CommandError(
            "SOURCE, --out, --show and --explain need a camera: add --camera ID", exits.USAGE
        )
    if not config.cameras:
        raise CommandError(
            "no camera given: add --camera ID SOURCE, or a --config with cameras", exits.USAGE
        )
    return supervise(args, config, requests)


def _one(args: argparse.Namespace, stop: threading.Event) -> int:
    """Grab one camera, to the bus or to event lines; return the exit status."""
    config = configuration(args)
    settings = _settings(args, config)
    redact.remember(settings.source)
    heartbeats = HeartbeatSender()
    with contextlib.ExitStack() as stack:
        # Save standard output: from here on FFmpeg's messages arrive on it.
        to_stdout = args.out is not None and is_standard_output(args.out)
        output: BinaryIO = stack.enter_context(os.fdopen(os.dup(1), "wb"))
        ffmpeg_log = stack.enter_context(captured_log())
        from camtopod.vision.grabber import Grabber

        # Open the camera. Models load before the first heartbeat, as they may take long.
        detector = _detector(args, settings)
        heartbeats.beat("connecting", "not opened yet")
        preview = _preview(args, settings.vision)
        grabber = Grabber(
            args.camera,
            settings.source,
            wall_clock=clock.wall,
            file_options=FileOptions(args.start, args.realtime or settings.realtime),
            settings=settings.vision,
            ffmpeg_log=ffmpeg_log,
            observer=_observer(args, preview),
            detector=detector,
        )
        stack.enter_context(contextlib.closing(grabber))
        if preview is not None:
            stack.callback(preview.close)  # before the camera, which may take long

        if args.out is None:
            _to_bus(grabber, args, config, stop, heartbeats)
        elif to_stdout:
            _to_lines(grabber, output, stop, heartbeats)
        else:
            with open_output(args.out, live=kind_of(settings.source) != "file") as file:
                _to_lines(grabber, file, stop, heartbeats)
    return exits.DONE


def _settings(args: argparse.Namespace, config: Config) -> CameraSettings:
    """Return the camera's settings. Raises `CommandError` for a command line without sense."""
    settings = config.cameras.get(args.camera)
    if settings is None or not settings.source:
        raise CommandError(
            f"camera {args.camera} has no source: give SOURCE, or a --config with a source in "
            f"[cameras.{args.camera}]",
            exits.USAGE,
        )
    if not codec.T_MIN <= args.start < codec.T_MAX:
        raise CommandError(
            "--start must be a number of seconds since 1970 (not milliseconds), before the year "
            "3000",
            exits.USAGE,
        )
    return settings


def _detector(args: argparse.Namespace, settings: CameraSettings) -> Detector | None:
    """Try and load the camera's detector, if any. Raises `CommandError` with file and line."""
    if not settings.detector.model:
        return None
    from camtopod.cli.cameras.probe import try_detector
    from camtopod.vision.detector.detector import Detector
    from camtopod.vision.detector.model import DetectorModel

    report = try_detector(settings.detector)
    if report.problem:
        line, name = detector_line(args.config.read_text("utf-8"), args.camera, report.key)
        raise CommandError(f"{args.config}:{line}: {name}: {report.problem}", exits.CONFIG)
    return Detector(DetectorModel(settings.detector), settings.detector)


def _preview(args: argparse.Namespace, settings: VisionSettings) -> Preview | None:
    """Return the preview that --show asks for. Raises `CommandError` if it cannot be written."""
    if args.show is None:
        return None
    from camtopod.vision.show import Preview, ShowError

    try:
        return Preview(args.show, args.camera, settings)
    except ShowError as error:
        raise CommandError(f"--show: {error}") from None


def _observer(args: argparse.Namespace, preview: Preview | None) -> Observer | None:
    """Return what --show and --explain do with each frame; None without them."""
    if not args.explain:
        return preview
    from camtopod.vision.show import decision_line

    def observe(analysis: Analysis) -> None:
        for decision in analysis.decisions:
            log.info("%s", decision_line(args.camera, decision))
        if preview is not None:
            preview(analysis)

    return observe


def _until_stopped(
    grabber: Grabber, stop: threading.Event, heartbeats: HeartbeatSender
) -> Iterator[Event | None]:
    """Yield what a grabber yields until its source ends or a signal arrives.

    Its state is reported in heartbeats, and logged when it changes: each reason for a state once.
    """
    state = ""
    causes: set[str] = set()
    newest: deque[float] = deque(maxlen=EVENTS_PER_MINUTE_MAX + 1)
    too_many = False
    for event in grabber.events():
        if grabber.overdue_seconds == 0.0:  # otherwise the watchdog ends this process
            # Before the event: once a beat says "running", a file is not read again.
            heartbeats.beat(grabber.state, grabber.reason)

        # Log the state.
        if grabber.state != state:
            state = grabber.state
            causes.clear()
        cause = grabber.reason.partition(RETRY_SEPARATOR)[0]  # without the time of the next attempt
        if cause not in causes and state != "ended":
            causes.add(cause)
            say = log.warning if state in ("stalled", "blind") else log.info
            say("camera %s is %s", grabber.camera, f"{state}: {grabber.reason}".removesuffix(": "))

        if event is not None and not too_many:
            newest.append(event.t)
            too_many = len(newest) > EVENTS_PER_MINUTE_MAX and max(newest) - min(newest) < 60.0
            if too_many:
                words = (
                    f"makes more than {EVENTS_PER_MINUTE_MAX} events a minute, as rain, snow and "
                    "swaying things do: set min_height or draw an ignore area in "
                    f"[cameras.{grabber.camera}], or use a [detector]"
                )
                log.warning("camera %s %s", grabber.camera, words)
        yield event
        if stop.is_set():
            return
    heartbeats.beat(grabber.state, grabber.reason)
    if grabber.state == "ended":
        _log_end(grabber)


def _log_end(grabber: Grabber) -> None:
    """Log how much of a file was read, and its events; a warning if a part was not decoded."""
    names = ("frames_analysed", "frames_dropped", "entries", "exits")
    figures = grabber.statistics()
    picture_count, undecoded_count, entries, exit_count = (int(figures[name]) for name in names)
    parts = [grabber.reason, f"{counted(picture_count, 'picture')} analysed"]
    if undecoded_count:
        parts.append(f"{undecoded_count} could not be decoded")
    if figures["blind_seconds"]:
        parts.append(f"blind for {figures['blind_seconds']:.0f} s")
    parts += ["1 entry" if entries == 1 else f"{entries} entries", counted(exit_count, "exit")]
    say = log.warning if undecoded_count else log.info
    say("camera %s has ended: %s", grabber.camera, ", ".join(parts))


def _to_lines(
    grabber: Grabber, out: BinaryIO, stop: threading.Event, heartbeats: HeartbeatSender
) -> None:
    """Write event lines, each flushed at once. Raises `CommandError` if there was no picture."""
    for event in _until_stopped(grabber, stop, heartbeats):
        if event is not None:
            out.write(codec.to_json(event) + b"\n")
            out.flush()
    if grabber.state == "connecting":
        reason = (
            f"camera {grabber.camera} gave no picture, so no event is written: {grabber.reason}"
        )
        raise CommandError(reason, exits.INPUT)


def _to_bus(
    grabber: Grabber,
    args: argparse.Namespace,
    config: Config,
    stop: threading.Event,
    heartbeats: HeartbeatSender,
) -> None:
    """Publish the camera's events, and wait at the end of a file until they are stored.

    A supervised process waits for as long as it takes: it would be started again, and its events
    would count twice. Others wait for `DRAIN_SECONDS`.
    """
    from camtopod.cli.cameras.grabber_connection import GrabberConnection
    from camtopod.serve.outbox import OWNER, SpoolPublisher, open_spool

    names = config.sites_of(args.camera)
    sites = {name if number else OWNER: name for number, name in enumerate(names)}
    with contextlib.ExitStack() as stack:
        spool = open_spool(
            config.state_directory, names[0], args.camera, config.limits, config.sites_of
        )
        stack.callback(spool.close)
        publisher = SpoolPublisher(spool)
        stack.callback(publisher.close)
        connections = []
        for site in sites:
            connections.append(GrabberConnection(config, grabber, publisher, args, site))
            stack.callback(connections[-1].close, wait=False)

        def publish_statuses(are_last: bool = False) -> None:
            for connection in connections:
                connection.publish_status(are_last)

        # Publish events, and a status from time to time.
        next_status = 0.0
        for event in _until_stopped(grabber, stop, heartbeats):
            if event is not None:
                publisher.publish(event)
            publisher.retry()
            if time.monotonic() >= next_status:
                next_status = time.monotonic() + config.limits.status_seconds
                publish_statuses()

        # Wait until all is stored.
        deadline = time.monotonic() + DRAIN_SECONDS
        if systemd.SOCKET_VARIABLE in os.environ:
            deadline = math.inf
        while not stop.is_set():
            publisher.retry()
            is_stored = publisher.wait_stored(0.2)
            publish_statuses(are_last=is_stored)
            if is_stored:
                break
            backlog = publisher.waiting
            if time.monotonic() >= deadline:
                away = [name for site, name in sites.items() if publisher.count_waiting(site=site)]
                raise CommandError(
                    f"{backlog} events are not stored: is `camtopod run` running for site "
                    f"{' and '.join(away)}? They are kept in {spool.path} and published when this "
                    "camera is grabbed again",
                    exits.BUS,
                )
            heartbeats.beat(grabber.state, f"waiting for the daemon to store {backlog} events")
