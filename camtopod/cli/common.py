"""What several commands share: configuration with the common options, logging, ending on a
signal.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import os
import re
import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec

from camtopod.cli import exits
from camtopod.cli.exits import CommandError, InputError
from camtopod.cli.terminal import standard_streams
from camtopod.config import DEFAULT_ENDPOINT, is_endpoint, secret_files, settings
from camtopod.records import CAMERA_PATTERN
from camtopod.redact import redact
from camtopod.serve.runtime import Progress, systemd
from camtopod.visible import visible, visible_lines

log = logging.getLogger(__name__)

_PARENT_LOOK_SECONDS = 0.5


def accepted(args: argparse.Namespace) -> tuple[settings.Config, bytes]:
    """The configuration, and the file's content that says so. Raises `CommandError`."""
    try:
        raw = b"" if args.config is None else args.config.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {args.config}: {error.strerror}") from None
    return configuration(args, raw), raw


def configuration(args: argparse.Namespace, raw: bytes | None = None) -> settings.Config:
    """The configuration with ``--site``, ``--connect``, ``--state`` on top. Raises `CommandError`.

    ``raw``: the file's content as it was read before, which a process that was started with
    ``--config-fd`` gets from the one above it.
    """
    above = getattr(args, "config_fd", None)
    if raw is None and above is not None:
        raw = Path(f"/proc/self/fd/{above}").read_bytes()
    loaded = settings.Config()
    if args.config is not None:
        try:
            loaded = settings.load(args.config, raw)
        except settings.ConfigError as error:
            raise CommandError(f"the configuration is wrong:\n{error}", exits.CONFIG) from None
        except OSError as error:
            raise InputError(f"cannot read {args.config}: {error.strerror}") from None
        if above is None:  # or that one has said it, once for all cameras
            for sentence in secret_files.exposed(loaded.secrets(args.config)):
                log.warning("%s", sentence)
    loaded = with_options(args, loaded)
    if getattr(args, "camera", None):
        try:
            loaded = loaded.for_camera(args.camera)
        except OSError as error:
            raise InputError(
                f"the source of camera {args.camera}: {error.filename}: {error.strerror}"
            ) from None
    return loaded


def with_options(args: argparse.Namespace, loaded: settings.Config) -> settings.Config:
    """``--site``, ``--connect`` and ``--state`` on top of what a file says. Raises
    `CommandError`.
    """
    if args.site is not None:
        if not re.match(CAMERA_PATTERN, args.site):
            raise CommandError(
                f"--site {args.site!r}: 1 to 64 of the characters A-Z a-z 0-9 _ . -", exits.USAGE
            )
        loaded = msgspec.structs.replace(loaded, site=settings.SiteSettings(args.site))
    if args.connect:
        for endpoint in args.connect:
            if not is_endpoint(endpoint):
                raise CommandError(
                    f"--connect {endpoint!r}: write it like {DEFAULT_ENDPOINT}", exits.USAGE
                )
            if loaded.bus.tls.ca and not endpoint.startswith("tls/"):
                raise CommandError(
                    f"--connect {endpoint!r}: write tls/..., as [bus.tls] is set", exits.USAGE
                )
        bus = msgspec.structs.replace(loaded.bus, connect=tuple(args.connect), listen=())
        loaded = msgspec.structs.replace(loaded, bus=bus)
    if getattr(args, "state", None):
        loaded = msgspec.structs.replace(loaded, state=settings.StateSettings(args.state))
    return loaded


class _Formatter(logging.Formatter):
    """One line a record, secrets taken out; a traceback takes more, which are indented. Times are
    UTC.
    """

    converter = staticmethod(time.gmtime)

    def __init__(self, form: str) -> None:
        super().__init__()
        self._form = form

    def format(self, record: logging.LogRecord) -> str:
        stamp = f"{self.formatTime(record, '%Y-%m-%dT%H:%M:%S')}.{int(record.msecs):03d}Z"
        message = redact(record.getMessage())
        trace = "\n" + redact(self.formatException(record.exc_info)) if record.exc_info else ""
        level = record.levelname.lower()
        name = record.name.removeprefix("camtopod.")

        if self._form == "json":
            content = {"t": stamp, "level": level, "from": name, "message": message + trace}
            return visible(json.dumps(content, ensure_ascii=False))
        if self._form == "logfmt":
            quoted = json.dumps(message + trace, ensure_ascii=False)
            return visible(f"t={stamp} level={level} from={name} message={quoted}")
        line = visible(message if level == "info" else f"{level}: {message}")
        return line + visible_lines(trace)


def start_logging(args: argparse.Namespace) -> None:
    """Messages of all modules to standard error in the form asked for."""
    handler = logging.StreamHandler()
    handler.setFormatter(_Formatter(args.log_format))
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)


class Told(NamedTuple):
    """What signals have asked for."""

    stop: threading.Event
    """SIGTERM or SIGINT has come, or the terminal has gone."""
    reload: threading.Event
    """SIGHUP has come; whoever obeys clears it first."""


@contextlib.contextmanager
def signals(reloads: bool = True) -> Iterator[Told]:
    """What SIGTERM, SIGINT and, for a program that ``reloads``, SIGHUP ask for while the block
    runs.

    A thread of its own sets the events, told by the C side of the interpreter: setting an event in
    a handler can deadlock with the wait it interrupts, and no handler runs while the main thread is
    inside a library.
    """
    told = Told(threading.Event(), threading.Event())
    numbers = [signal.SIGTERM, signal.SIGINT] + ([signal.SIGHUP] if reloads else [])
    at_a_terminal = os.isatty(0)
    heard, written = os.pipe()
    os.set_blocking(written, False)

    def obey() -> None:
        while came := os.read(heard, 1):
            if came[0] == signal.SIGHUP and not (at_a_terminal and not os.isatty(0)):
                told.reload.set()
            elif came[0] in numbers:  # others have handlers of their own
                told.stop.set()

    with contextlib.ExitStack() as stack:
        stack.callback(os.close, heard)
        thread = threading.Thread(target=obey, name="signals", daemon=True)
        thread.start()
        stack.callback(thread.join)
        stack.callback(os.close, written)
        stack.callback(
            signal.set_wakeup_fd, signal.set_wakeup_fd(written, warn_on_full_buffer=False)
        )
        for number in numbers:
            stack.callback(signal.signal, number, signal.signal(number, lambda *_: None))
        yield told


@contextlib.contextmanager
def until_signal() -> Iterator[threading.Event]:
    """An event that is set by SIGTERM or SIGINT while the block runs."""
    with signals(reloads=False) as told:
        yield told.stop


class Leaving:
    """``status``: of a process that is ended because its block did not end in time."""

    def __init__(self) -> None:
        self.status = exits.DONE


@contextlib.contextmanager
def leaving(stop: threading.Event, seconds: float, parent: int | None = None) -> Iterator[Leaving]:
    """Once told to stop the block has ``seconds`` to end, or the process ends as it stands: what
    must not be lost is on disk by then. It is told to stop, too, when the process ``parent`` is no
    longer the one above.
    """
    done, given = threading.Event(), Leaving()

    def watch() -> None:
        while not stop.wait(_PARENT_LOOK_SECONDS):
            if parent is not None and os.getppid() != parent:
                stop.set()
        if not done.wait(seconds):
            log.warning("something did not end within %g s and is left as it is", seconds)
            standard_streams.settle()
            os._exit(given.status)

    threading.Thread(target=watch, name="leaving", daemon=True).start()
    try:
        yield given
    finally:
        done.set()
        stop.set()


@contextlib.contextmanager
def watched(progress: Progress, status: str) -> Iterator[None]:
    """Tell systemd that it runs, in the words of ``status``, and feed its watchdog while the block
    gets on.
    """
    with systemd.watchdog(progress.stuck, lambda: False):
        systemd.notify("READY=1", systemd.status(status))
        try:
            yield
        finally:
            systemd.notify("STOPPING=1")
