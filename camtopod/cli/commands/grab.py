"""`camtopod grab`: one camera to events, on the bus or as lines; or all cameras of a
configuration.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import logging
import math
import os
import re
import signal
import threading
import time
from typing import TYPE_CHECKING, Any, BinaryIO

import msgspec

from camtopod import codec, redact
from camtopod.cli import descriptors, exits
from camtopod.cli.cameras import Heart, restarted
from camtopod.cli.common import (
    Leaving,
    Told,
    accepted,
    configuration,
    leaving,
    signals,
    start_logging,
)
from camtopod.cli.exits import CommandError
from camtopod.config import RESERVED, CameraSettings, Config
from camtopod.records import CAMERA_PATTERN
from camtopod.serve.runtime import clock, systemd
from camtopod.vision.source import AGAIN, ffmpeg_log, kind_of

if TYPE_CHECKING:
    from camtopod.serve.bus import Bus
    from camtopod.serve.outbox import Publisher
    from camtopod.vision import Grabber

log = logging.getLogger(__name__)

DRAIN_SECONDS = 10.0
"""How long a file's grabber waits at the end for its last events to be acknowledged, if nobody
looks after it.
"""
_DRAIN_LOOK_SECONDS = 0.2
DAEMON_SECONDS = 5.0
"""How long after it has reached the bus a grabber waits for a daemon before it says that there is
none.
"""
_DAEMON_LOOK_SECONDS = 0.5
LEAVE_SECONDS = 4.0
"""After a signal, how long a source that blocks may hold up the end."""
HANDOVER_SECONDS = LEAVE_SECONDS + 2.0
"""How long the processes of a grabber that was killed, and started again at once, may take to
end.
"""
_HANDOVER_LOOK_SECONDS = 0.2


def add_parser(subparsers: Any) -> None:
    """Add `grab`."""
    parser = subparsers.add_parser(
        "grab",
        help="one camera to entry and exit events",
        description="Watches one camera and publishes an event for whoever enters or leaves its view. "
        "Without --camera it runs all cameras of --config, a process each.",
    )
    parser.add_argument(
        "source", nargs="?", metavar="SOURCE", help="rtsp:// URL, video file or device number"
    )
    parser.add_argument("--camera", metavar="ID", help="the camera's id, [A-Za-z0-9_.-]{1,64}")
    parser.add_argument(
        "--out", metavar="FILE", help="write event lines here ('-': standard output), use no bus"
    )
    parser.add_argument(
        "--start", type=float, metavar="SECONDS", help="a file: time of its first frame (default 0)"
    )
    parser.add_argument(
        "--realtime", action="store_true", default=None, help="a file: at its own pace"
    )
    parser.add_argument(
        "--speed", type=float, metavar="FACTOR", help="a file: with --realtime, times its own pace"
    )
    parser.add_argument(
        "--state", metavar="DIRECTORY", help="where the spool is kept (default: [state] directory)"
    )
    given = (
        "with-parent",
        "config-fd",
        "beat-fd",
        "restarts",
    )  # to a camera's process by the one above it
    for option in given:
        parser.add_argument(f"--{option}", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--last-end", default="", help=argparse.SUPPRESS)


def run(args: argparse.Namespace) -> int:
    """Grab until the file ends or a signal comes."""
    start_logging(args)
    faulthandler.enable(file=2)  # systemd's watchdog ends what hangs with SIGABRT
    descriptors.raise_limit()
    with signals() as told:
        if args.camera is None:
            return _all(args, told)
        faulthandler.register(signal.SIGUSR1, file=2)  # to tell where it hangs before it is killed
        with leaving(told.stop, LEAVE_SECONDS, args.with_parent) as left:
            return _one(args, told, left)


def _all(args: argparse.Namespace, told: Told) -> int:
    config, text = accepted(args)
    if args.source is not None or args.out is not None:
        raise CommandError("which camera is it? add --camera ID", exits.USAGE)
    if not config.cameras:
        raise CommandError(
            "nothing to grab: name --camera ID SOURCE, or a --config with cameras", exits.USAGE
        )
    _refuse_a_second(config, told.stop)
    from camtopod.cli.cameras import supervise

    return supervise(args, config, text, told)


def _refuse_a_second(config: Config, stop: threading.Event) -> None:
    """Raises `CommandError` if another grabber has the spool of a camera and does not end within
    `HANDOVER_SECONDS`.
    """
    from camtopod.serve.outbox import spool_path
    from camtopod.serve.storage import held_by

    paths = {
        camera: spool_path(config.state_directory, config.site.name, camera)
        for camera in config.cameras
    }
    deadline = time.monotonic() + HANDOVER_SECONDS
    while held := {camera: why for camera, path in paths.items() if (why := held_by(path))}:
        if time.monotonic() >= deadline or stop.wait(_HANDOVER_LOOK_SECONDS):
            raise CommandError(f"{', '.join(held)}: {next(iter(held.values()))}", exits.STATE)


def _one(args: argparse.Namespace, told: Told, left: Leaving) -> int:
    config = configuration(args)
    settings = _camera(args, config)
    redact.remember(settings.source)
    with contextlib.ExitStack() as stack:
        output = stack.enter_context(os.fdopen(os.dup(1), "wb")) if args.out == "-" else None
        heard = stack.enter_context(
            ffmpeg_log.listening()
        )  # FFmpeg talks on standard output from here on
        from camtopod.vision import Grabber

        heart = Heart(args.beat_fd)
        heart.beat("connecting", "not opened yet")
        grabber = Grabber(
            args.camera,
            settings.source,
            start=settings.start,
            realtime=settings.realtime,
            speed=settings.speed,
            wall_clock=clock.wall,
            settings=config.vision,
            complaints=heard,
        )
        stack.enter_context(contextlib.closing(grabber))
        if args.out is not None:
            return _to_lines(
                grabber, output or stack.enter_context(_file(args.out)), told.stop, left
            )
        return _to_bus(grabber, args, config, settings, told, heart)


def _camera(args: argparse.Namespace, config: Config) -> CameraSettings:
    """The camera's settings: the configuration's, with the command line on top."""
    if args.camera in RESERVED:
        raise CommandError(f"--camera {args.camera}: this name is taken on the bus", exits.USAGE)
    if not re.match(CAMERA_PATTERN, args.camera):
        raise CommandError(
            f"--camera {args.camera!r}: 1 to 64 of the characters A-Z a-z 0-9 _ . -", exits.USAGE
        )
    known = config.cameras.get(args.camera)
    if args.source is None and known is None:
        raise CommandError(
            f"camera {args.camera} has no SOURCE, and no configuration names it", exits.USAGE
        )
    given: dict[str, Any] = {
        name: getattr(args, name, None) for name in CameraSettings.__struct_fields__
    }
    given = {name: value for name, value in given.items() if value is not None}
    if not 0 < given.get("speed", 1.0) < math.inf:
        raise CommandError("--speed must be a number above 0", exits.USAGE)
    if not math.isfinite(given.get("start", 0.0)):
        raise CommandError("--start must be a number of seconds", exits.USAGE)
    return msgspec.structs.replace(known or CameraSettings(""), **given)


def _file(path: str) -> BinaryIO:
    try:
        return open(path, "wb")
    except OSError as error:
        raise CommandError(f"cannot write {path}: {error.strerror}") from None


def _to_lines(grabber: Grabber, out: BinaryIO, stop: threading.Event, left: Leaving) -> int:
    """Event lines, each out at once. The exit status, which is 66 if there was not one picture."""
    said = _Said(grabber)
    events = (
        grabber.events()
    )  # kept until the return, as closing it may wait for OpenCV longer than there is time
    for event in events:
        said.tell()
        if event is not None:
            out.write(codec.to_json(event) + b"\n")
            out.flush()
        if stop.is_set():
            break
    if grabber.state == "connecting":
        left.status = exits.INPUT
        log.error("camera %s has given no picture: %s", grabber.camera, grabber.reason)
    return left.status


class _Said:
    """Says what state a camera is in: when that changes, and each reason for a state once."""

    def __init__(self, grabber: Grabber) -> None:
        self._grabber = grabber
        self._state = ""
        self._reasons: set[str] = set()

    def tell(self) -> None:
        """Say it if it is new."""
        camera, state, reason = self._grabber.camera, self._grabber.state, self._grabber.reason
        cause = reason.partition(AGAIN)[0]  # when it is tried again is another time each time
        if state != self._state:
            self._state = state
            self._reasons.clear()
        elif cause in self._reasons:
            return
        self._reasons.add(cause)
        log.info("camera %s is %s%s", camera, state, f": {reason}" if reason else "")


def _to_bus(
    grabber: Grabber,
    args: argparse.Namespace,
    config: Config,
    settings: CameraSettings,
    told: Told,
    heart: Heart,
) -> int:
    from camtopod.serve.bus import BusError, dial
    from camtopod.serve.outbox import Publisher, open_spool
    from camtopod.serve.storage import StateError

    with contextlib.ExitStack() as stack:
        try:
            spool = open_spool(config.state_directory, config.site.name, args.camera, config.limits)
        except StateError as error:
            raise CommandError(str(error), exits.STATE) from None
        stack.callback(spool.close)
        publisher = Publisher(spool, config.limits.spool_batch_events)
        connection = _Connection(config, grabber, publisher, args)
        stack.callback(connection.close)
        if (
            kind_of(settings.source) != "file"
        ):  # it goes on whether the bus is there or not; a file can wait
            connection.keep_dialling()
        else:
            try:
                connection.use(dial(config))
            except BusError as error:
                raise CommandError(str(error), exits.BUS) from None
        _publish_all(grabber, publisher, connection, config, told, heart)
        _drain(grabber, publisher, connection, args, told, heart)
        if publisher.unacknowledged and not told.stop.is_set():
            raise CommandError(
                f"{publisher.unacknowledged} events are not acknowledged: is `camtopod run` running for site "
                f"{config.site.name}? They wait in {spool.path} and go out when this camera is grabbed again"
            )
    return exits.DONE


def _publish_all(
    grabber: Grabber,
    publisher: Publisher,
    connection: _Connection,
    config: Config,
    told: Told,
    heart: Heart,
) -> None:
    said, next_status = _Said(grabber), 0.0
    heart.beat(grabber.state, grabber.reason, connection.daemon)
    for event in grabber.events():
        if grabber.overdue_seconds == 0.0:  # else whoever hears no beat ends this process
            # Before the event: from then on a file has been begun.
            heart.beat(grabber.state, grabber.reason, connection.daemon)
        if event is not None:
            publisher.publish(event)
        else:
            publisher.retry()
        said.tell()
        now = time.monotonic()
        if now >= next_status:
            next_status = now + config.limits.status_seconds
            connection.tell_status()
        if told.reload.is_set():
            told.reload.clear()
            log.warning(
                "camera %s: the configuration is read at the start only; start it again",
                grabber.camera,
            )
        if told.stop.is_set():
            return
    publisher.retry()
    connection.tell_status()
    heart.beat(grabber.state, grabber.reason, connection.daemon)


def _drain(
    grabber: Grabber,
    publisher: Publisher,
    connection: _Connection,
    args: argparse.Namespace,
    told: Told,
    heart: Heart,
) -> None:
    """At a file's end, wait until its events are acknowledged, for `DRAIN_SECONDS`.

    Whoever is looked after waits for as long as it takes: it would be started again, and its events
    count twice.
    """
    looked_after = args.beat_fd is not None or systemd.SOCKET_VARIABLE in os.environ
    deadline = time.monotonic() + DRAIN_SECONDS
    while not told.stop.is_set() and not publisher.drained(_DRAIN_LOOK_SECONDS):
        if not looked_after and time.monotonic() >= deadline:
            return
        publisher.retry()
        connection.tell_status()
        heart.beat(
            grabber.state,
            f"{publisher.unacknowledged} events wait for the daemon",
            connection.daemon,
        )


class _Connection:
    """The grabber's way to the bus, which may come later than the first events, and whether the
    daemon is there.
    """

    def __init__(
        self, config: Config, grabber: Grabber, publisher: Publisher, args: argparse.Namespace
    ) -> None:
        self._config, self._grabber, self._publisher = config, grabber, publisher
        self._tells = (
            args.beat_fd is None
        )  # otherwise the process above tells it, once for all cameras
        self._daemons: set[str] = set()
        self.daemon: str | None = None
        """Why the daemon is not reached; "" if it is, None where that is not known yet."""
        self._restarts, self._last_end = args.restarts or 0, args.last_end
        self._bus: Bus | None = None
        self._closed = threading.Event()
        self._mutex = threading.Lock()

    def use(self, bus: Bus) -> None:
        """Publish there from now on."""
        with self._mutex:
            if self._closed.is_set():
                bus.close()
                return
            self._publisher.attach(bus, [self._grabber.camera])
            bus.answer(
                f"status/{self._grabber.camera}", lambda key, parameters: self.status(), "status"
            )
            if not self._config.bus.tls.ca:  # a camera's certificate does not allow this
                bus.watch_alive("daemon", self._on_daemon)
            self._bus = bus
        threading.Thread(target=self._look, args=[bus], name="reach", daemon=True).start()

    def keep_dialling(self) -> None:
        """Dial in the background until there is a bus; events wait in the spool."""

        def keep() -> None:
            from camtopod.serve.bus import BusError, dial

            while not self._closed.is_set():
                try:
                    self.use(dial(self._config))
                    return
                except BusError as error:
                    self._note(str(error))

        threading.Thread(target=keep, daemon=True).start()

    def _on_daemon(self, name: str, alive: bool) -> None:
        (self._daemons.add if alive else self._daemons.discard)(name)

    def _look(self, bus: Bus) -> None:
        """Note whether the daemon is reached, until the end."""
        reached_at = time.monotonic()
        while not self._closed.wait(_DAEMON_LOOK_SECONDS):
            if not bus.connected:
                reached_at = math.inf
                self._note(f"the daemon at {bus.endpoint} is not reached any more")
            elif self._daemons or self._config.bus.tls.ca:
                self._note("")
            else:
                reached_at = min(reached_at, time.monotonic())
                if time.monotonic() - reached_at >= DAEMON_SECONDS:
                    self._note(
                        f"the bus at {bus.endpoint} is reached, but no daemon of site {bus.site} is there"
                    )

    def _note(self, why: str) -> None:
        """Say it when it changes; ``why`` the daemon is not reached, "" if it is."""
        before, self.daemon = self.daemon, why
        if not self._tells or bool(why) == bool(before):
            return
        if why:
            log.warning("%s; events wait in the spool", why)
        elif before:
            log.info("the daemon is reached again")

    def status(self) -> dict[str, Any]:
        """What ``status/{camera}`` says."""
        return {
            "camera": self._grabber.camera,
            "state": self._grabber.state,
            "reason": redact.redact(
                restarted(self._restarts, self._last_end, self._grabber.reason)
            ),
            "restarts": self._restarts,
            "last_end": self._last_end,
            "t": clock.wall(),
            **self._grabber.statistics(),
            **self._publisher.statistics(),
        }

    def tell_status(self) -> None:
        """Publish the status, if there is a bus."""
        if self._bus is not None:
            self._bus.put(f"status/{self._grabber.camera}", self.status(), "status")

    def close(self) -> None:
        """Close the bus, now or as soon as it is reached."""
        self._closed.set()
        with self._mutex:
            if self._bus is not None:
                self._bus.close()
