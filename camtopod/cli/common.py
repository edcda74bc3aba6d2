"""Functions shared by several commands: configuration with the common options, logging, signals."""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec

from camtopod.cli import exits, implicit_config
from camtopod.cli.exits import CommandError, InputError
from camtopod.config import DEFAULT_ENDPOINT, is_endpoint, secret_files, settings
from camtopod.records import CAMERA_PATTERN
from camtopod.redact import redact
from camtopod.serve.runtime import Progress, systemd
from camtopod.visible import visible, visible_lines

log = logging.getLogger(__name__)

_PARENT_LOOK_SECONDS = 0.5
"""Interval at which `ends_within` checks that its parent process still exists."""


def configuration_and_text(args: argparse.Namespace) -> tuple[settings.Config, bytes]:
    """Return the configuration and the content of its file. Raises `CommandError`."""
    try:
        raw = b"" if args.config is None else args.config.read_bytes()
    except OSError as error:
        raise InputError(_unreadable(args, error)) from None
    return configuration(args, raw), raw


def configuration(args: argparse.Namespace, raw: bytes | None = None) -> settings.Config:
    """Return the configuration with ``--site``, ``--connect``, ``--state`` applied. Raises
    `CommandError`.

    raw: content of the file if it has been read already. A process that was started with
    ``--config-fd`` reads it from that descriptor, which its supervisor passes on.
    """
    # Read the file, the supervisor's copy of it, or nothing (defaults).
    above = getattr(args, "config_fd", None)
    if raw is None and above is not None:
        raw = Path(f"/proc/self/fd/{above}").read_bytes()
    loaded = settings.Config()
    if args.config is not None:
        try:
            loaded = settings.load(args.config, raw)
        except settings.ConfigError as error:
            if not implicit_config.may_skip(args):
                raise CommandError(
                    f"the configuration has mistakes{_found(args)}:\n{error}", exits.CONFIG
                ) from None
            _skip(args, f"has mistakes (`camtopod check {args.config}` lists them)")
        except OSError as error:
            if not implicit_config.may_skip(args):
                raise InputError(_unreadable(args, error)) from None
            _skip(args, f"cannot be read ({error.strerror})")
    if args.config is not None:
        _name_once(args)
        if above is None:  # otherwise the supervisor warns, once for all cameras
            for sentence in secret_files.find_exposed(loaded.secrets(args.config)):
                log.warning("%s", sentence)

    # Apply the command line, then read the one camera's source.
    loaded = with_options(args, loaded)
    if getattr(args, "camera", None):
        try:
            loaded = loaded.for_camera(args.camera, getattr(args, "source", None))
        except OSError as error:
            raise InputError(
                f"cannot read the source of camera {args.camera}: "
                f"{error.filename}: {error.strerror}"
            ) from None
    return loaded


def _unreadable(args: argparse.Namespace, error: OSError) -> str:
    return f"cannot read {args.config}: {error.strerror}{_found(args)}"


def _found(args: argparse.Namespace) -> str:
    """Return a note that the file was found, not given with --config; "" if it was given."""
    if not getattr(args, "config_found", False):
        return ""
    return f" ({implicit_config.shown(args.config)} is read as there is no --config; none: no file)"


def _skip(args: argparse.Namespace, why: str) -> None:
    """Warn about the configuration that was found, and continue without it."""
    where = implicit_config.shown(args.config)
    _say(args, logging.WARNING, f"{where} {why}: it is not used, every setting has its default")
    args.config = None
    args.config_found = False


def _name_once(args: argparse.Namespace) -> None:
    """Log the path of the configuration that was found, the first time that it is read."""
    if getattr(args, "config_found", False) and not getattr(args, "config_named", False):
        args.config_named = True
        _say(args, logging.INFO, f"configuration: {implicit_config.shown(args.config)}")


def _say(args: argparse.Namespace, level: int, message: str) -> None:
    """Log a message, or print it if the command does not log."""
    if getattr(args, "logs", False):
        log.log(level, "%s", message)
    else:
        print(visible(f"camtopod: {redact(message)}"), file=sys.stderr)


def configuration_text(args: argparse.Namespace) -> str:
    """Return the content of the configuration file, as `configuration` reads it; "" if none."""
    above = getattr(args, "config_fd", None)
    if above is not None:
        return Path(f"/proc/self/fd/{above}").read_text(encoding="utf-8")
    return "" if args.config is None else str(args.config.read_text(encoding="utf-8"))


def with_options(args: argparse.Namespace, loaded: settings.Config) -> settings.Config:
    """Apply ``--site``, ``--connect`` and ``--state`` to ``loaded``. Raises `CommandError`."""
    if args.site is not None:
        if not re.match(CAMERA_PATTERN, args.site):
            raise CommandError(
                f"--site {args.site!r}: use 1 to 64 of the characters A-Z a-z 0-9 _ . -",
                exits.USAGE,
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
    """Log formatter: one line a record, without secrets, times in UTC.

    A traceback adds further, indented lines. In the journal, which has times of its own, text has
    none, and no level of ordinary messages.
    """

    converter = staticmethod(time.gmtime)

    def __init__(self, form: str) -> None:
        super().__init__()
        self._form = form
        self._stamped = not _to_journal()

    def format(self, record: logging.LogRecord) -> str:
        """Return the line in the form "text", "logfmt" or "json"."""
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
        line = visible(f"{level}: {message}")
        if not self._stamped:  # the journal has its own times
            return (visible(message) if level == "info" else line) + visible_lines(trace)
        return f"{stamp[:-5]}Z {line}{visible_lines(trace)}"


def _to_journal() -> bool:
    """Return True if standard error is the journal, as of systemd.exec(5)."""
    with contextlib.suppress(OSError):
        mine = os.fstat(2)
        return os.environ.get("JOURNAL_STREAM") == f"{mine.st_dev}:{mine.st_ino}"
    return False


def start_logging(args: argparse.Namespace) -> None:
    """Send the messages of all modules to standard error, in the format of ``--log-format``.

    Messages below ``--log-level`` are left out.
    """
    handler = logging.StreamHandler()
    handler.setFormatter(_Formatter(args.log_format))
    level = logging.getLevelNamesMapping()[getattr(args, "log_level", "info").upper()]
    logging.basicConfig(level=level, handlers=[handler], force=True)
    args.logs = True


class SignalRequests(NamedTuple):
    """Requests that have arrived as signals."""

    stop: threading.Event
    """Set by SIGTERM or SIGINT, or when the terminal is closed."""
    reload: threading.Event
    """Set by SIGHUP; clear it before reloading."""


@contextlib.contextmanager
def signals(reloads: bool = True) -> Iterator[SignalRequests]:
    """Return the requests of SIGTERM, SIGINT and, with ``reloads``, SIGHUP while the block runs.

    A thread sets the events; the C level of the interpreter wakes it through a pipe. Setting an
    event in a Python handler could deadlock with the wait it interrupts, and no handler runs while
    the main thread is inside a library.
    """
    requests = SignalRequests(threading.Event(), threading.Event())
    numbers = [signal.SIGTERM, signal.SIGINT] + ([signal.SIGHUP] if reloads else [])
    at_a_terminal = os.isatty(0)
    reading, writing = os.pipe()
    os.set_blocking(writing, False)

    def obey() -> None:
        while number := os.read(reading, 1):
            if number[0] == signal.SIGHUP and not (at_a_terminal and not os.isatty(0)):
                requests.reload.set()
            elif number[0] in numbers:  # others have handlers of their own
                requests.stop.set()

    # Start the thread; install the pipe and empty handlers, and restore the former ones at the end.
    with contextlib.ExitStack() as stack:
        stack.callback(os.close, reading)
        thread = threading.Thread(target=obey, name="signals", daemon=True)
        thread.start()
        stack.callback(thread.join)
        stack.callback(os.close, writing)
        stack.callback(
            signal.set_wakeup_fd, signal.set_wakeup_fd(writing, warn_on_full_buffer=False)
        )
        for number in numbers:
            stack.callback(signal.signal, number, signal.signal(number, lambda *_: None))
        yield requests


@contextlib.contextmanager
def until_signal() -> Iterator[threading.Event]:
    """Return an event that SIGTERM or SIGINT sets while the block runs."""
    with signals(reloads=False) as requests:
        yield requests.stop


class ForcedExit:
    """Exit status of a process that `ends_within` ends because its block did not end in time."""

    def __init__(self) -> None:
        self.status = exits.DONE


@contextlib.contextmanager
def ends_within(
    stop: threading.Event, seconds: float, parent: int | None = None
) -> Iterator[ForcedExit]:
    """Give the block ``seconds`` to end once ``stop`` is set; then end the process.

    Data that must not be lost is on disk by then. ``stop`` is also set when the process ``parent``
    is no longer this one's parent.
    """
    done = threading.Event()
    forced_exit = ForcedExit()

    def watch() -> None:
        while not stop.wait(_PARENT_LOOK_SECONDS):
            if parent is not None and os.getppid() != parent:
                stop.set()
        if not done.wait(seconds):
            log.warning(
                "not everything closed within %g s; the process ends anyway, stored data is safe",
                seconds,
            )
            os._exit(forced_exit.status)

    threading.Thread(target=watch, name="leaving", daemon=True).start()
    try:
        yield forced_exit
    finally:
        done.set()
        stop.set()


@contextlib.contextmanager
def reporting_to_systemd(progress: Progress, status: str) -> Iterator[None]:
    """Report ``status`` to systemd, and feed its watchdog while the block makes progress."""
    with systemd.watchdog(progress.stalled, lambda: False):
        systemd.notify("READY=1", systemd.status(status))
        try:
            yield
        finally:
            systemd.notify("STOPPING=1")
