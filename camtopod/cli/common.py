"""Functions shared by several commands: configuration with the common options, logging, signals."""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

from msgspec.structs import replace

from camtopod import codec, files
from camtopod.cli import exits
from camtopod.cli.exits import CommandError, InputError
from camtopod.config import (
    Config,
    ConfigError,
    Districts,
    StateSettings,
    config_file,
    districts_file,
    secret_files,
)
from camtopod.records import Topology
from camtopod.redact import redact
from camtopod.serve.runtime import Progress, systemd
from camtopod.visible import visible, visible_lines
from camtopod.words import counted as counted

log = logging.getLogger(__name__)

PARTS = {"run": "daemon", "web": "page", "bridge": "bridge"}
"""Command -> what it is called in the log of `up`."""


def configuration(args: argparse.Namespace) -> Config:
    """Return the configuration with ``--site``, ``--connect``, ``--state`` applied.

    Raises `CommandError`.
    """
    config = Config()
    if args.config is not None:
        try:
            config = config_file.load(args.config)
        except ConfigError as error:
            raise CommandError(f"the configuration has mistakes:\n{error}", exits.CONFIG) from None
        except OSError as error:
            raise InputError(
                f"cannot read {args.config}: {error.strerror}; --config none does without it"
            ) from None
        if getattr(args, "config_found", False):
            if getattr(args, "logs", False):
                log.info("configuration: %s", args.config)
            else:
                say(visible(f"camtopod: configuration: {args.config}"))
        if getattr(args, "with_parent", None) is None:  # otherwise the supervisor warns
            for sentence in secret_files.find_exposed(config.secrets(args.config)):
                log.warning("%s", sentence)

    # Apply the command line, then read the one camera's source.
    config = with_options(args, config)
    if getattr(args, "camera", None):
        try:
            config = config.for_camera(args.camera, getattr(args, "source", None))
        except OSError as error:
            raise InputError(
                f"cannot read the source of camera {args.camera}: "
                f"{error.filename}: {error.strerror}"
            ) from None
    return config


def say(message: str) -> None:
    """Print a message to standard error, without secrets."""
    print(redact(message), file=sys.stderr, flush=True)


def with_options(args: argparse.Namespace, config: Config) -> Config:
    """Apply ``--site``, ``--connect`` and ``--state`` to ``config``. Raises `CommandError`."""
    try:
        config = config.joining(args.site, args.connect or ())
    except ValueError as error:
        raise CommandError(f"--{error}", exits.USAGE) from None
    if getattr(args, "state", None):
        config = replace(config, state=StateSettings(args.state))
    return config


def topology_of(path: str) -> Topology:
    """Return a topology from a JSON file ('-': standard input).

    Raises `OSError`, `InputError`.
    """
    raw = sys.stdin.buffer.read() if path == "-" else Path(path).read_bytes()
    try:
        return codec.decode_topology(raw)
    except codec.Rejected as error:
        raise InputError(f"{path} is not a topology: {error}") from None


def districts_of(path: Path, raw: bytes | None = None) -> Districts:
    """Return the districts of a file. Raises `OSError`, `CommandError`.

    raw: content of the file, if it was read before.
    """
    try:
        return districts_file.load(path, raw)
    except ConfigError as error:
        raise CommandError(f"the districts have mistakes:\n{error}", exits.CONFIG) from None


def camera_id(text: str) -> str:
    """Parse a camera's id; for argparse."""
    try:
        codec.require_camera(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return text


@contextlib.contextmanager
def writing(path: str | Path) -> Iterator[None]:
    """Turn an OSError of the block, which writes ``path``, into a `CommandError`."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        if error.errno is None:  # of camtopod itself
            raise
        place = error.filename or path
        raise CommandError(f"cannot write {place}: {error.strerror}") from None


@contextlib.contextmanager
def open_output(
    path: str | Path, mode: int | None = None, live: bool = False
) -> Iterator[BinaryIO]:
    """Open a file for writing bytes, as `files.writing`; standard output is flushed and left open.

    live: what is written is in the file at once; without end, it would never be whole.

    Raises `CommandError`.
    """
    if is_standard_output(path):
        yield sys.stdout.buffer
        sys.stdout.buffer.flush()
        return
    with writing(path), open(path, "wb") if live else files.writing(path, mode) as file:
        yield file


def is_standard_output(path: str | Path) -> bool:
    """Return True for ``-``, and for a name of what standard output is connected with."""
    with contextlib.suppress(OSError):
        return str(path) == "-" or os.path.samestat(os.stat(path), os.fstat(1))
    return False


class _Formatter(logging.Formatter):
    """Log formatter: one line a record, without secrets, times in UTC.

    A traceback adds further, indented lines. In the journal, which has times of its own, text has
    none, and no level of ordinary messages.
    """

    converter = staticmethod(time.gmtime)

    def __init__(self, form: str, part: str) -> None:
        super().__init__()
        self._form = form
        self._part = f"{part}: " if part else ""
        self._has_stamps = not _to_journal()

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
            text = json.dumps(message + trace, ensure_ascii=False)
            return visible(f"t={stamp} level={level} from={name} message={text}")
        message = self._part + message
        line = visible(f"{level}: {message}")
        if not self._has_stamps:  # the journal has its own times
            return (visible(message) if level == "info" else line) + visible_lines(trace)
        return f"{stamp[:-5]}Z {line}{visible_lines(trace)}"


def _to_journal() -> bool:
    """Return True if standard error is the journal, as of systemd.exec(5)."""
    with contextlib.suppress(OSError):
        stderr_stat = os.fstat(2)
        return os.environ.get("JOURNAL_STREAM") == f"{stderr_stat.st_dev}:{stderr_stat.st_ino}"
    return False


def start_logging(args: argparse.Namespace) -> None:
    """Send the messages of all modules to standard error, in the format of ``--log-format``.

    Messages below ``--log-level`` are left out. In text, a part of `up` begins with its name; the
    other formats name the module.
    """
    handler = logging.StreamHandler()
    part = PARTS.get(args.command, "") if args.with_parent is not None else ""
    handler.setFormatter(_Formatter(args.log_format, part))
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
    numbers = [signal.SIGTERM, signal.SIGINT]
    if reloads:
        numbers.append(signal.SIGHUP)
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


@contextlib.contextmanager
def ends_within(stop: threading.Event, seconds: float, parent: int | None = None) -> Iterator[None]:
    """Give the block ``seconds`` to end once ``stop`` is set; then end the process.

    Data that must not be lost is on disk by then. ``stop`` is also set when the process ``parent``
    is no longer this one's parent.
    """
    end = threading.Event()

    def watch() -> None:
        while not stop.wait(0.5):
            if parent is not None and os.getppid() != parent:
                stop.set()
        if not end.wait(seconds):
            log.warning(
                "not everything closed within %g s; the process ends anyway, stored data is safe",
                seconds,
            )
            os._exit(exits.DONE)

    threading.Thread(target=watch, name="leaving", daemon=True).start()
    try:
        yield
    finally:
        end.set()
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
