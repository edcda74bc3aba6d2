"""`camtopod grab`: turn the video of a camera into events, on the bus or as lines of a file.

Without ``--camera`` it supervises one such process for each camera of a configuration.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import logging
import math
import os
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import msgspec

from camtopod import codec, redact
from camtopod.cli import descriptors, exits
from camtopod.cli.cameras.camera_process import with_restarts
from camtopod.cli.cameras.heartbeat import HeartbeatSender
from camtopod.cli.common import (
    ForcedExit,
    SignalRequests,
    check_camera,
    configuration,
    ends_within,
    open_output,
    signals,
    start_logging,
)
from camtopod.cli.exits import CommandError
from camtopod.config import CameraSettings, Config, detector_line
from camtopod.serve.runtime import clock, systemd
from camtopod.vision.source import RETRY_SEPARATOR, captured_log, kind_of

if TYPE_CHECKING:
    from camtopod.serve.bus import Bus
    from camtopod.serve.outbox import Publisher
    from camtopod.vision.analysis import Analysis, Observer
    from camtopod.vision.detector.detector import Detector
    from camtopod.vision.grabber import Grabber
    from camtopod.vision.settings import VisionSettings
    from camtopod.vision.show import Preview

log = logging.getLogger(__name__)

DRAIN_SECONDS = 10.0
"""Time that the grabber of a file waits at its end until its events are stored, unless it is
supervised."""
LEAVE_SECONDS = 4.0
"""Time that a blocking source may delay the end after a signal."""
_DAEMON_LOOK_SECONDS = 2.0
"""Interval at which it looks for the daemon."""


def add_parser(subparsers: Any) -> None:
    """Add `grab`."""
    parser = subparsers.add_parser(
        "grab",
        help="turn the video of one camera, or of all configured ones, into entry and exit events",
        description="Watches one camera and publishes an event for each person who enters or "
        "leaves its view. Without --camera it runs all cameras of --config, one process per "
        "camera. Settings are those of [vision] and [cameras.ID]; SOURCE replaces the one there.",
        epilog="example: camtopod grab --camera lobby rtsp://192.0.2.10/stream1",
    )
    parser.add_argument(
        "source", nargs="?", metavar="SOURCE", help="rtsp:// URL, video file or device number"
    )
    parser.add_argument("--camera", metavar="ID", help="the camera's id, [A-Za-z0-9_.-]{1,64}")
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
        "video of the whole time; .jpg or .png: one picture that is replaced every 2 seconds. "
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
        metavar="SECONDS",
        help="video file: event time of its first frame (default 0)",
    )
    parser.add_argument(
        "--realtime",
        action="store_true",
        default=None,
        help="video file: read it in real time instead of as fast as possible",
    )
    parser.add_argument(
        "--speed",
        type=float,
        metavar="FACTOR",
        help="video file: with --realtime, read it FACTOR times as fast",
    )
    parser.add_argument(
        "--state", metavar="DIRECTORY", help="directory of the spool (default: [state] directory)"
    )
    # Options that the supervisor passes to a camera's process.
    for option in ("with-parent", "beat-fd", "restarts"):
        parser.add_argument(f"--{option}", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--last-end", default="", help=argparse.SUPPRESS)


def run(args: argparse.Namespace) -> int:
    """Grab until the file ends or a signal arrives."""
    start_logging(args)
    faulthandler.enable(file=2)  # systemd and the supervisor end a hung process with SIGABRT
    descriptors.raise_limit()
    with signals() as requests:
        if args.camera is None:
            return _all(args, requests)
        with ends_within(requests.stop, LEAVE_SECONDS, args.with_parent) as forced_exit:
            return _one(args, requests, forced_exit)


def _all(args: argparse.Namespace, requests: SignalRequests) -> int:
    """Supervise one process for each camera of the configuration."""
    from camtopod.cli.cameras.supervisor import supervise
    from camtopod.serve.outbox import spool_path
    from camtopod.serve.storage import lock_reason

    config = configuration(args)
    if args.source is not None or args.out is not None or args.show is not None or args.explain:
        raise CommandError(
            "SOURCE, --out, --show and --explain need a camera: add --camera ID", exits.USAGE
        )
    if not config.cameras:
        raise CommandError(
            "no camera given: add --camera ID SOURCE, or a --config with cameras", exits.USAGE
        )
    for camera in config.cameras:
        path = spool_path(config.state_directory, config.site.name, camera)
        if reason := lock_reason(path):
            raise CommandError(f"{camera}: {reason}", exits.STATE)
    return supervise(args, config, requests)


def _one(args: argparse.Namespace, requests: SignalRequests, forced_exit: ForcedExit) -> int:
    """Grab one camera, to the bus or to event lines."""
    check_camera(args.camera)
    config = configuration(args)
    settings = _settings(args, config)
    redact.remember(settings.source)
    with contextlib.ExitStack() as stack:
        # Save standard output: from here on FFmpeg's messages arrive on it.
        output = stack.enter_context(os.fdopen(os.dup(1), "wb")) if args.out == "-" else None
        ffmpeg_log = stack.enter_context(captured_log())
        from camtopod.vision.grabber import Grabber

        detector = _detector(args, settings)

        # Open the camera.
        heartbeats = HeartbeatSender(args.beat_fd)
        heartbeats.beat("connecting", "not opened yet")
        preview = _preview(args, settings.vision)
        grabber = Grabber(
            args.camera,
            settings.source,
            start=settings.start,
            realtime=settings.realtime,
            speed=settings.speed,
            wall_clock=clock.wall,
            settings=settings.vision,
            ffmpeg_log=ffmpeg_log,
            observer=_observer(args, preview),
            detector=detector,
        )
        stack.enter_context(contextlib.closing(grabber))
        if preview is not None:
            stack.callback(preview.close)  # before the camera, which may take long

        if args.out is not None:
            lines = output or stack.enter_context(open_output(args.out))
            return _to_lines(grabber, lines, requests.stop, forced_exit)
        _to_bus(grabber, args, config, settings, requests, heartbeats)
        return exits.DONE


def _settings(args: argparse.Namespace, config: Config) -> CameraSettings:
    """Return the camera's settings: those of the configuration, overridden by the command line."""
    settings = config.cameras.get(args.camera)
    if settings is None or not settings.source:
        raise CommandError(
            f"camera {args.camera} has no source: give SOURCE, or a --config with a source in "
            f"[cameras.{args.camera}]",
            exits.USAGE,
        )
    given: dict[str, Any] = {name: getattr(args, name) for name in ("start", "realtime", "speed")}
    given = {name: value for name, value in given.items() if value is not None}
    if not 0 < given.get("speed", 1.0) < math.inf:
        raise CommandError("--speed must be a number above 0", exits.USAGE)
    if not math.isfinite(given.get("start", 0.0)):
        raise CommandError("--start must be a number of seconds", exits.USAGE)
    return msgspec.structs.replace(settings, **given)


def _detector(args: argparse.Namespace, settings: CameraSettings) -> Detector | None:
    """Load the camera's detector, if it has one. Raises `CommandError` with file and line."""
    if not settings.detector.model:
        return None
    from camtopod.vision.detector.detector import Detector
    from camtopod.vision.detector.model import DetectorError, Model

    try:
        return Detector(Model(settings.detector), settings.detector)
    except DetectorError as error:
        text = args.config.read_text(encoding="utf-8")
        line, name = detector_line(text, args.camera, error.key)
        raise CommandError(f"{args.config}:{line}: {name}: {error}", exits.CONFIG) from None


def _preview(args: argparse.Namespace, settings: VisionSettings) -> Preview | None:
    """Return the preview that --show asks for. Raises `CommandError` if it cannot be written."""
    if args.show is None:
        return None
    from camtopod.cli.cameras.decision_words import clock_words, words_of
    from camtopod.vision.show import Preview, ShowError, Words

    def warn(reason: str) -> None:
        log.warning("--show: %s; it is not written any more, events go on", reason)

    try:
        return Preview(args.show, args.camera, settings, Words(clock_words, words_of), warn)
    except ShowError as error:
        raise CommandError(f"--show: {error}") from None


def _observer(args: argparse.Namespace, preview: Preview | None) -> Observer | None:
    """Return what --show and --explain do with each frame; None without them."""
    if not args.explain:
        return preview
    from camtopod.cli.cameras.decision_words import decision_line

    def observe(analysis: Analysis) -> None:
        for decision in analysis.decisions:
            log.info("%s", decision_line(args.camera, decision))
        if preview is not None:
            preview(analysis)

    return observe


def _to_lines(
    grabber: Grabber, out: BinaryIO, stop: threading.Event, forced_exit: ForcedExit
) -> int:
    """Write event lines, each flushed at once; return the exit status (66 if there was no
    picture).
    """
    state_log = _StateLog(grabber)
    # The generator is kept until the return: closing it may wait for OpenCV longer than there is
    # time.
    events = grabber.events()
    for event in events:
        state_log.update()
        if event is not None:
            out.write(codec.to_json(event) + b"\n")
            out.flush()
        if stop.is_set():
            break
    if grabber.state == "connecting":
        forced_exit.status = exits.INPUT
        log.error("camera %s gave no picture: %s", grabber.camera, grabber.reason)
    return forced_exit.status


class _StateLog:
    """Logs the state of a camera when it changes, and each reason for a state once."""

    def __init__(self, grabber: Grabber) -> None:
        self._grabber = grabber
        self._logged: set[tuple[str, str]] = set()

    def update(self) -> None:
        """Log state and reason if they are new."""
        state = self._grabber.state
        reason = self._grabber.reason
        cause = reason.partition(RETRY_SEPARATOR)[0]  # without the time of the next attempt
        if (state, cause) in self._logged:
            return
        if not any(logged == state for logged, _ in self._logged):
            self._logged.clear()
        self._logged.add((state, cause))
        log.info(": ".join(filter(None, [f"camera {self._grabber.camera} is {state}", reason])))


def _to_bus(
    grabber: Grabber,
    args: argparse.Namespace,
    config: Config,
    settings: CameraSettings,
    requests: SignalRequests,
    heartbeats: HeartbeatSender,
) -> None:
    """Publish the camera's events, and wait at the end of a file until they are stored."""
    from camtopod.serve.outbox import Publisher, open_spool

    with contextlib.ExitStack() as stack:
        spool = open_spool(config.state_directory, config.site.name, args.camera, config.limits)
        stack.callback(spool.close)
        publisher = Publisher(spool)

        # Connect: a live camera does not wait for the bus, a file can.
        connection = _Connection(config, grabber, publisher, args)
        stack.callback(connection.close)
        connection.open(in_background=kind_of(settings.source) != "file")

        # Publish, then wait until all is stored.
        _publish_all(grabber, publisher, connection, config, requests, heartbeats)
        _drain(grabber, publisher, connection, args, requests, heartbeats)
        if publisher.waiting and not requests.stop.is_set():
            raise CommandError(
                f"{publisher.waiting} events are not stored: is `camtopod run` running for site "
                f"{config.site.name}? They are kept in {spool.path} and published when this camera "
                f"is grabbed again{connection.other_site()}"
            )


def _publish_all(
    grabber: Grabber,
    publisher: Publisher,
    connection: _Connection,
    config: Config,
    requests: SignalRequests,
    heartbeats: HeartbeatSender,
) -> None:
    """Publish events and statuses until the source ends or a signal arrives."""
    state_log = _StateLog(grabber)
    next_status = 0.0
    heartbeats.beat(grabber.state, grabber.reason)
    for event in grabber.events():
        if grabber.overdue_seconds == 0.0:  # otherwise the watchdog ends this process
            # Before the event: once a beat says "running", a file is not read again.
            heartbeats.beat(grabber.state, grabber.reason)
        if event is not None:
            publisher.publish(event)
        else:
            publisher.retry()

        state_log.update()
        now = time.monotonic()
        if now >= next_status:
            next_status = now + config.limits.status_seconds
            connection.publish_status()
        if requests.reload.is_set():
            requests.reload.clear()
            log.warning(
                "camera %s: the configuration is read only at the start; restart the command",
                grabber.camera,
            )
        if requests.stop.is_set():
            return
    publisher.retry()
    connection.publish_status()
    heartbeats.beat(grabber.state, grabber.reason)


def _drain(
    grabber: Grabber,
    publisher: Publisher,
    connection: _Connection,
    args: argparse.Namespace,
    requests: SignalRequests,
    heartbeats: HeartbeatSender,
) -> None:
    """Wait at the end of a file until its events are stored, for at most `DRAIN_SECONDS`.

    A supervised process waits for as long as it takes: it would be started again, and its events
    would count twice.
    """
    supervised = args.beat_fd is not None or systemd.SOCKET_VARIABLE in os.environ
    deadline = math.inf if supervised else time.monotonic() + DRAIN_SECONDS
    while not requests.stop.is_set() and not publisher.wait_stored(0.2):
        if time.monotonic() >= deadline:
            return
        publisher.retry()
        connection.publish_status()
        heartbeats.beat(
            grabber.state, f"waiting for the daemon to store {publisher.waiting} events"
        )


class _Connection:
    """Connection of the grabber to the bus, which may come later than the first events.

    It also logs when the daemon cannot be reached any more, and when it can again.
    """

    def __init__(
        self, config: Config, grabber: Grabber, publisher: Publisher, args: argparse.Namespace
    ) -> None:
        self._config = config
        self._grabber = grabber
        self._publisher = publisher
        self._restarts = args.restarts or 0
        self._last_end = args.last_end
        self._daemons: set[str] = set()
        self._unreached = False
        self._bus: Bus | None = None
        self._closed = threading.Event()
        self._mutex = threading.Lock()

    def open(self, in_background: bool) -> None:
        """Connect, now or in the background; until then events wait in the spool.

        Raises `BusError` if there is no bus now.
        """
        from camtopod.serve.bus import dial

        if not in_background:
            self._use(dial(self._config))
        threading.Thread(target=self._run, name="reach", daemon=True).start()

    def _run(self) -> None:
        """Connect if that is not done yet; then look for the daemon until the end."""
        from camtopod.serve.bus import BusError, dial

        while self._bus is None and not self._closed.is_set():
            try:
                self._use(dial(self._config))
            except BusError as error:
                self._note_unreached(str(error))

        while not self._closed.wait(_DAEMON_LOOK_SECONDS) and self._bus is not None:
            endpoint = self._bus.endpoint
            if not self._bus.connected:
                self._note_unreached(f"the connection to the daemon at {endpoint} is lost")
            elif not self._daemons:
                self._note_unreached(
                    f"connected to the bus at {endpoint}, but no daemon of site {self._bus.site} "
                    f"is there{self.other_site()}"
                )
            elif self._unreached:
                self._unreached = False
                log.info("camera %s: connected to the daemon again", self._grabber.camera)

    def _use(self, bus: Bus) -> None:
        """Publish on ``bus`` from now on."""
        camera = self._grabber.camera
        with self._mutex:
            if self._closed.is_set():
                bus.close()
                return
            self._publisher.attach(bus, [camera])
            bus.answer_queries(f"status/{camera}", lambda key, parameters: self.status(), "status")
            bus.watch_alive("daemon", self._on_daemon)
            self._bus = bus

    def _on_daemon(self, name: str, alive: bool) -> None:
        (self._daemons.add if alive else self._daemons.discard)(name)

    def _note_unreached(self, why: str) -> None:
        """Log once that the daemon is not reached."""
        if not self._unreached:
            self._unreached = True
            camera = self._grabber.camera
            log.warning("camera %s: %s; events are kept in the spool", camera, why)

    def other_site(self) -> str:
        """Return which site has a daemon if this one has none; see `camtopod.cli.site_choice`."""
        from camtopod.cli.site_choice import right_site

        return "" if self._bus is None else right_site(self._bus, self._config)

    def status(self) -> dict[str, Any]:
        """Return the content of ``status/{camera}``."""
        reason = with_restarts(self._restarts, self._last_end, self._grabber.reason)
        return {
            "camera": self._grabber.camera,
            "state": self._grabber.state,
            "reason": redact.redact(reason),
            "restarts": self._restarts,
            "last_end": self._last_end,
            "t": clock.wall(),
            **self._grabber.statistics(),
            **self._publisher.statistics(),
        }

    def publish_status(self) -> None:
        """Publish the status if there is a connection."""
        if self._bus is not None:
            self._bus.publish(f"status/{self._grabber.camera}", self.status(), "status")

    def close(self) -> None:
        """Close the bus, now or as soon as it is connected."""
        self._closed.set()
        with self._mutex:
            self._publisher.close()
            if self._bus is not None:
                self._bus.close()
