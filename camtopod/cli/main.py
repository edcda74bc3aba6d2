"""The console script: finds the command, imports only its module, turns expected errors into exit
statuses.

A command is a module ``camtopod.cli.NAME`` with two functions: ``add_parser(subparsers)`` calls
``subparsers.add_parser(NAME, ...)`` once and adds the command's own arguments (and returns the
parsers of its own commands, if it has any); ``run(args) -> int`` does the work and returns the exit
status. The common options are added here, before and after the command's name, and arrive as
``args.config`` (path or None), ``args.site`` (str or None), ``args.connect`` (list of endpoints,
maybe empty) and ``args.log_format``. `camtopod.cli.common` has what several commands share.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import importlib
import json
import logging
import os
import signal
import sys
import threading
import traceback
import types
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, NoReturn, TextIO, cast

from camtopod import __version__
from camtopod.cli import exits
from camtopod.cli.terminal import standard_streams
from camtopod.redact import redact
from camtopod.visible import visible, visible_lines

COMMANDS: dict[str, tuple[str, str]] = {
    "demo": (
        "camtopod.cli.commands.demo",
        "the whole system on made-up cameras, nothing to configure",
    ),
    "init": ("camtopod.cli.commands.init", "looks at cameras and writes a configuration with them"),
    "grab": (
        "camtopod.cli.commands.grab",
        "one camera (or a configuration's cameras) to entry and exit events",
    ),
    "run": (
        "camtopod.cli.commands.run",
        "the daemon: learns the topology from events on the bus and predicts",
    ),
    "learn": ("camtopod.cli.commands.learn", "the same learner over recorded event lines"),
    "predict": (
        "camtopod.cli.commands.predict",
        "for each exit of recorded events, where the object appears next",
    ),
    "simulate": ("camtopod.cli.commands.simulate", "a made-up camera network with known truth"),
    "watch": (
        "camtopod.cli.commands.watch",
        "live view of cameras, topology and predictions in the terminal",
    ),
    "web": (
        "camtopod.cli.commands.web",
        "the page: map, cameras, links, versions and health in a browser",
    ),
    "export": ("camtopod.cli.commands.export", "a topology as a picture or in an exchange format"),
    "report": ("camtopod.cli.commands.report", "the page of one topology as a file"),
    "ingest": ("camtopod.cli.commands.ingest", "other programs' events onto the bus"),
    "bridge": (
        "camtopod.cli.commands.bridge",
        "cameras, alarms and predictions in Home Assistant, by MQTT",
    ),
    "keys": ("camtopod.cli.commands.keys", "a private authority and certificates for the bus"),
    "check": ("camtopod.cli.commands.check", "every mistake in a configuration, in one pass"),
    "doctor": ("camtopod.cli.commands.doctor", "what a bug report needs, without secrets"),
    "completion": (
        "camtopod.cli.commands.completion",
        "makes the shell complete commands and options",
    ),
}
"""Command -> (module, one line for --help)."""

LOG_FORMATS = ("text", "logfmt", "json")
_LINEAR_ALGEBRA_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Set to 1 before numpy is loaded: with another number of threads the same events give other last
bits.
"""
_KEEP_ON = ("run", "grab")
"""They read their configuration anew when told so by SIGHUP, and never end by it."""
_UNTIL_TOLD = (*_KEEP_ON, "web", "bridge", "watch", "ingest")
"""They run until they are told to end, whether or not their messages are read."""
_WITH_VALUE = ("--config", "--site", "--connect", "--log-format")


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status. Never lets an expected error out as a traceback."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    for name in _LINEAR_ALGEBRA_THREADS:
        os.environ.setdefault(name, "1")
    form = "text"
    if _command_in(arguments) in _KEEP_ON:
        signal.signal(
            signal.SIGHUP, signal.SIG_IGN
        )  # until they listen to it: there is nothing yet to read anew
        signal.pthread_sigmask(
            signal.SIG_UNBLOCK, [signal.SIGHUP]
        )  # it is blocked in a camera's process till here
    try:
        try:
            args, run = _parse(arguments)
            form = args.log_format
            status = run(args)
        finally:
            sys.stdout.flush()
    except (
        BrokenPipeError
    ):  # the reader (say, head) has gone: say nothing more to it, not even at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return exits.FAILED
    except KeyboardInterrupt:
        return _fail("interrupted", exits.FAILED, form)
    except exits.CommandError as error:
        return _fail(str(error), error.status, form)
    except OSError as error:
        return _fail(*_os_error(error), form)
    except MemoryError:
        return _fail("there is not enough memory for this", exits.FAILED, form)
    return int(status)


def console() -> NoReturn:
    """The process: `main`, and then its end, at once.

    The interpreter's own end waits for threads, and aborts the process (status -6, "exception not
    rethrown") when one of zenoh's or OpenCV's comes back to it meanwhile. Whatever matters is
    closed by then, or safe on disk.
    """
    standard_streams.open_missing()
    if _command_in(sys.argv[1:]) in _UNTIL_TOLD:
        sys.stderr = cast(TextIO, standard_streams.Unwaited(2))
    sys.excepthook = _crash
    threading.excepthook = _crash_of_a_thread
    try:
        status = main()
    except SystemExit as error:  # argparse: --help, --version, usage
        status = error.code if isinstance(error.code, int) else exits.FAILED
    _end(status)


def _end(status: int) -> NoReturn:
    logging.shutdown()
    standard_streams.settle()
    with contextlib.suppress(OSError):  # nobody is there to read it
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(status)


def _crash(
    _: type[BaseException], error: BaseException, __: types.TracebackType | None
) -> NoReturn:
    """What nobody expected ends the process with its traceback."""
    _tell(error)
    _end(exits.FAILED)


def _crash_of_a_thread(crash: threading.ExceptHookArgs) -> None:
    if crash.exc_value is not None and crash.thread is not None:
        print(f"in thread {crash.thread.name}:", file=sys.stderr)
        _tell(crash.exc_value)


def _tell(error: BaseException) -> None:
    """The traceback, which may hold a source and its password, to standard error."""
    print(
        visible_lines(redact("".join(traceback.format_exception(error))).rstrip("\n")),
        file=sys.stderr,
    )


class _Parser(argparse.ArgumentParser):
    """A command line that is wrong is quoted without the passwords in it."""

    def error(self, message: str) -> NoReturn:
        super().error(visible(redact(message)))


def _parse(arguments: list[str]) -> tuple[argparse.Namespace, Any]:
    name = _command_in(arguments)
    parser, modules = parser_of([name] if name in COMMANDS else [])
    if name is not None and not modules:
        parser.error(f"no command {name!r}; one of {', '.join(COMMANDS)}")
    args = parser.parse_args(arguments)
    args.connect = args.connect or []
    return args, modules[args.command].run


def parser_of(whole: Collection[str]) -> tuple[argparse.ArgumentParser, dict[str, Any]]:
    """The parser, which knows the options of the commands in ``whole`` and of the others the names;
    the modules of those in ``whole``.
    """
    parser = _Parser(prog="camtopod", description=_DESCRIPTION)
    parser.add_argument("--version", action="version", version=f"camtopod {__version__}")
    _add_common(parser, top=True)
    subparsers = parser.add_subparsers(
        dest="command", metavar="COMMAND", title="commands", required=True
    )
    modules = {}
    for command, (path, summary) in COMMANDS.items():
        if command in whole:
            modules[command] = _import(path, command)
            inner = modules[command].add_parser(subparsers) or []
            for its in (subparsers.choices[command], *inner):
                _add_common(its, top=False)
        else:
            subparsers.add_parser(command, help=summary)
    return parser, modules


def _command_in(arguments: list[str]) -> str | None:
    """The first argument that is neither an option nor a common option's value."""
    skip = False
    for argument in arguments:
        if skip:
            skip = False
        elif argument in _WITH_VALUE:
            skip = True
        elif not argument.startswith("-"):
            return argument
    return None


def _import(path: str, command: str) -> Any:
    try:
        return importlib.import_module(path)
    except ModuleNotFoundError as error:
        if error.name == path:
            raise exits.CommandError(f"{command}: not in this version of camtopod") from None
        raise exits.CommandError(
            f"{command} needs the package {error.name!r}, which is not installed; see README, 'Packages'"
        ) from None


def _add_common(parser: argparse.ArgumentParser, top: bool) -> None:
    """The common options; after the command's name they default to what stood before it."""
    group = parser.add_argument_group("common options")
    default: Any = None if top else argparse.SUPPRESS
    group.add_argument(
        "--config", type=Path, metavar="FILE", default=default, help="configuration, a TOML file"
    )
    group.add_argument(
        "--site", metavar="NAME", default=default, help="name of the site, second part of every key"
    )
    group.add_argument(
        "--connect",
        metavar="ENDPOINT",
        action="append",
        default=default,
        help="zenoh endpoint to dial, for example tcp/192.168.1.5:7447; may be repeated",
    )
    group.add_argument(
        "--log-format",
        choices=LOG_FORMATS,
        default="text" if top else argparse.SUPPRESS,
        help="form of the messages on standard error (default: text)",
    )


def _os_error(error: OSError) -> tuple[str, int]:
    """An error nobody nearer translated: with a file name it is an input that cannot be read."""
    if error.filename is not None:
        return f"cannot read {error.filename}: {error.strerror}", exits.INPUT
    if error.errno == errno.EBADF:
        return "standard input or output is closed", exits.FAILED
    status = exits.INPUT if type(error).__module__.startswith("camtopod.vision") else exits.FAILED
    return str(error), status


def _fail(message: str, status: int, form: str) -> int:
    message = redact(message)
    if form == "json":
        line = visible(json.dumps({"level": "error", "message": message}, ensure_ascii=False))
    elif form == "logfmt":
        line = visible(f"level=error message={json.dumps(message, ensure_ascii=False)}")
    else:
        line = visible_lines(f"camtopod: {message}")
    print(line, file=sys.stderr)
    return status


_DESCRIPTION = (
    "Learns from anonymous entry and exit events how the cameras of a site hang together, and predicts where "
    "an object that leaves one camera appears next."
)
