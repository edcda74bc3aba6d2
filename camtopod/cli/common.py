"""What several commands share: configuration with the common options, logging, ending on a signal."""

from __future__ import annotations

import argparse
import contextlib
import json
import logging
import re
import signal
import threading
import time
from collections.abc import Iterator

import msgspec

from camtopod import config
from camtopod.cli import exits
from camtopod.cli.exits import CommandError, InputError
from camtopod.records import CAMERA_PATTERN
from camtopod.redact import redact


def configuration(args: argparse.Namespace) -> config.Config:
    """The configuration with ``--site``, ``--connect``, ``--state`` on top. Raises `CommandError`."""
    loaded = config.Config()
    if args.config is not None:
        try:
            loaded = config.load(args.config)
        except config.ConfigError as error:
            raise CommandError(f"the configuration is wrong:\n{error}", exits.CONFIG) from None
        except OSError as error:
            raise InputError(f"cannot read {args.config}: {error.strerror}") from None
    if args.site is not None:
        if not re.match(CAMERA_PATTERN, args.site):
            raise CommandError(f"--site {args.site!r}: 1 to 64 of the characters A-Z a-z 0-9 _ . -", exits.USAGE)
        loaded = msgspec.structs.replace(loaded, site=config.SiteSettings(args.site))
    if args.connect:
        for endpoint in args.connect:
            if not config.is_endpoint(endpoint):
                raise CommandError(f"--connect {endpoint!r}: write it like {config.DEFAULT_ENDPOINT}", exits.USAGE)
        bus = msgspec.structs.replace(loaded.bus, connect=tuple(args.connect), listen=())
        loaded = msgspec.structs.replace(loaded, bus=bus)
    if getattr(args, "state", None):
        loaded = msgspec.structs.replace(loaded, state=config.StateSettings(args.state))
    return loaded


class _Formatter(logging.Formatter):
    """One line a record, secrets taken out. Times are UTC."""

    converter = staticmethod(time.gmtime)

    def __init__(self, form: str) -> None:
        super().__init__()
        self._form = form

    def format(self, record: logging.LogRecord) -> str:
        stamp = f"{self.formatTime(record, '%Y-%m-%dT%H:%M:%S')}.{int(record.msecs):03d}Z"
        message = redact(record.getMessage())
        if record.exc_info:
            message += "\n" + redact(self.formatException(record.exc_info))
        level = record.levelname.lower()
        name = record.name.removeprefix("camtopod.")
        if self._form == "json":
            return json.dumps({"t": stamp, "level": level, "from": name, "message": message}, ensure_ascii=False)
        if self._form == "logfmt":
            return f"t={stamp} level={level} from={name} message={json.dumps(message, ensure_ascii=False)}"
        return message if level == "info" else f"{level}: {message}"


def start_logging(args: argparse.Namespace) -> None:
    """Messages of all modules to standard error in the form asked for."""
    handler = logging.StreamHandler()
    handler.setFormatter(_Formatter(args.log_format))
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)


@contextlib.contextmanager
def until_signal() -> Iterator[threading.Event]:
    """An event that is set by SIGTERM or SIGINT while the block runs."""
    stop = threading.Event()
    previous = {number: signal.signal(number, lambda *_: stop.set()) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        yield stop
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
