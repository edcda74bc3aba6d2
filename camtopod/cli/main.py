"""Console script: find the command, import only its module, turn expected errors into exit
statuses.

A command is a module, ``camtopod.cli.commands.NAME`` or in one of `FOLDERS`, with two functions.
``add_parser(add)`` calls ``add(...)``, which makes the command's parser, once, and adds the
command's own arguments; it returns the parsers of its own subcommands, if it has any. ``run(args)``
does the work and returns the exit status, or None for 0.

The common options are added here, before and after the command's name, and arrive as
``args.config`` (path or None; without --config the first of `PLACES`), ``args.site`` (str or
None), ``args.connect`` (list of endpoints, maybe empty), ``args.log_format`` and
``args.log_level``. Commands of `OF_SITES` take several sites: then ``args.sites`` has them, and
``args.site`` is None. `camtopod.cli.common` has functions that several commands share.
"""

from __future__ import annotations

import argparse
import contextlib
import faulthandler
import functools
import importlib
import json
import logging
import os
import resource
import signal
import sys
import textwrap
import threading
import traceback
import types
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, NoReturn

from camtopod import __version__
from camtopod.cli import completion, exits
from camtopod.redact import redact
from camtopod.visible import visible, visible_lines

COMMANDS = {
    "demo": "run the whole system on simulated cameras, without any configuration",
    "init": "probe cameras and write a configuration",
    "grab": "turn the video of one camera, or of all configured ones, into entry and exit events",
    "up": "run the daemon, the grabbers and the page of one machine",
    "run": "run the daemon: learn the topology from events on the bus and predict",
    "learn": "learn the topology from recorded event lines",
    "predict": "predict for each recorded exit where the object appears next",
    "districts": "cut a city into districts, each of which is a site",
    "merge": "make one topology of those of a city's districts",
    "score": "score a topology by the identities of a recording",
    "simulate": "simulate a camera network: event lines and their ground truth",
    "watch": "show cameras, topology and predictions live in the terminal",
    "web": "serve a web page: map, cameras, links, versions and health",
    "export": "convert a topology to a picture or an exchange format",
    "plot": "draw a figure of a topology for a paper",
    "report": "write the web page of one topology to a file",
    "ingest": "publish events from other programs",
    "bridge": "show cameras, alarms and predictions in Home Assistant, through MQTT",
    "forget": "remove a camera and all that was learned of it",
    "rename": "rename a camera and keep everything learned about it",
    "reset": "begin the site anew: forget everything that was learned",
    "keys": "create a private certificate authority and certificates for the bus",
    "schema": "print the JSON Schema of a message or of the configuration",
    "check": "check a configuration and list all mistakes",
    "doctor": "collect diagnostics for a bug report, without secrets",
}
"""Command -> one-line summary for --help."""

FOLDERS = {"operator": ("forget", "rename", "reset"), "city": ("districts", "merge")}
"""Commands that are not in `camtopod.cli.commands`, by their folder."""
PLACES = (Path("camtopod.toml"), Path("/etc/camtopod/camtopod.toml"))
"""Files that are read without --config; the first one that exists."""
LOG_FORMATS = ("text", "logfmt", "json")
"""Values of --log-format."""
LOG_LEVELS = ("debug", "info", "warning", "error")
"""Values of --log-level: the least important messages that are shown."""
FILES_MAX = 65_536
"""Number of open files asked for; each program on the bus and each open web page takes one."""
_LINEAR_ALGEBRA_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Environment variables set to 1 before NumPy is loaded.

With another number of threads the same events give results that differ in the last bits.
"""
_STATUS_OF_ERROR = {
    "SourceError": exits.INPUT,
    "BusError": exits.BUS,
    "StateError": exits.STATE,
    "InUse": exits.STATE,
}
"""Class of an OSError of camtopod -> exit status; the classes' own modules take long to import."""
OF_SITES = ("watch", "web")
"""Commands that show several sites as one."""
_COMMON: dict[str, dict[str, Any]] = {
    "--config": {
        "metavar": "FILE",
        "help": "configuration, a TOML file; none: read no file (default: ./camtopod.toml, else "
        "/etc/camtopod/camtopod.toml, if there is one)",
    },
    "--site": {
        "metavar": "NAME",
        "action": "append",
        "help": "name of the site, the second part of every key on the bus; web and watch show "
        "several as one map, each with --site",
    },
    "--connect": {
        "metavar": "ENDPOINT",
        "action": "append",
        "help": "zenoh endpoint to connect to, for example tcp/192.168.1.5:7447; may be repeated",
    },
    "--log-format": {
        "choices": LOG_FORMATS,
        "default": "text",
        "help": "format of the messages on standard error (default: text)",
    },
    "--log-level": {
        "choices": LOG_LEVELS,
        "default": "info",
        "help": "least important messages to show (default: info)",
    },
    "--with-parent": {"metavar": "PID", "type": int, "help": argparse.SUPPRESS},
}
"""The common options; all have a value. The last one is for processes of `up` and `grab`."""

_FILES = ("events", "file", "source", "topology", "topologies", "updates", "districts", "table")
"""Arguments with the name of a file."""
_OUTPUTS = {"learn": ("topology", "updates"), "simulate": ("events", "truth", "identities")}
"""Command -> those that it writes, if others than ``--out`` and ``--show``."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status; an expected error never ends in a traceback."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    for name in _LINEAR_ALGEBRA_THREADS:
        os.environ.setdefault(name, "1")
    form = "text"
    if _command_in(arguments) in ("up", "run", "grab"):
        # SIGHUP ends neither; it is ignored until they have a handler. SIGTTOU would stop the parts
        # at their first message, in a terminal with `stty tostop`.
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        signal.signal(signal.SIGTTOU, signal.SIG_IGN)

    try:
        try:
            args, run = _parse(arguments)
            form = args.log_format
            status = run(args)
        finally:
            sys.stdout.flush()
    except BrokenPipeError:
        # The reader (head, for example) has gone: write nothing more, not even at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
        return exits.FAILED
    except KeyboardInterrupt:
        return _fail("interrupted", exits.FAILED, form)
    except exits.CommandError as error:
        return _fail(str(error), error.status, form)
    except ModuleNotFoundError as error:
        name = _command_in(arguments) or "this"
        message = f"{name} needs the package {error.name!r}, which is not installed"
        extras = "city, detector, keys, metrics, mqtt, plot, tables, terminal, web"
        hint = f"`pip install 'camtopod[EXTRA]'` installs it, with one of the extras {extras}"
        return _fail(f"{message}; {hint}", exits.FAILED, form)
    except OSError as error:
        if error.filename is not None:  # of an input, and no command translated it
            return _fail(f"cannot read {error.filename}: {error.strerror}", exits.INPUT, form)
        return _fail(str(error), _STATUS_OF_ERROR.get(type(error).__name__, exits.FAILED), form)
    return int(status or exits.DONE)


def console() -> NoReturn:
    """Run `main` as a process of its own, and end the process at once.

    The interpreter's own shutdown waits for threads, and aborts (status -6, "exception not
    rethrown") if a thread of zenoh or OpenCV re-enters it meanwhile. By then everything that
    matters is closed or on disk.
    """
    _open_missing()
    faulthandler.enable(file=2)  # a watchdog ends a hung process with SIGABRT
    _, files = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(files, FILES_MAX), files))
    sys.excepthook = _crash
    threading.excepthook = _crash_of_a_thread
    try:
        status = main()
    except SystemExit as error:  # argparse: --help, --version, usage
        status = error.code if isinstance(error.code, int) else exits.FAILED
    _end(status)


def _open_missing() -> None:
    """Open /dev/null for each standard stream that is closed, before a file takes its place."""
    for number, (name, mode) in enumerate({"stdin": "r", "stdout": "w", "stderr": "w"}.items()):
        if getattr(sys, name) is None:
            os.dup2(os.open(os.devnull, os.O_RDWR), number)
            os.set_inheritable(number, True)
            setattr(sys, name, os.fdopen(number, mode, closefd=False))


def _end(status: int) -> NoReturn:
    """Flush the log and the standard streams, and end the process with ``status``."""
    logging.shutdown()
    with contextlib.suppress(OSError):  # no reader is left
        sys.stdout.flush()
        sys.stderr.flush()
    os._exit(status)


def _crash(
    _: type[BaseException], error: BaseException, __: types.TracebackType | None
) -> NoReturn:
    """Excepthook: print the traceback of an unexpected error and end the process."""
    _tell(error)
    _end(exits.FAILED)


def _crash_of_a_thread(crash: threading.ExceptHookArgs) -> None:
    """Excepthook of threads: print the traceback with the thread's name; the process goes on."""
    if crash.exc_value is not None and crash.thread is not None:
        print(f"in thread {crash.thread.name}:", file=sys.stderr)
        _tell(crash.exc_value)


def _tell(error: BaseException) -> None:
    """Print a traceback to standard error, without passwords that it may contain."""
    print(
        visible_lines(redact("".join(traceback.format_exception(error))).rstrip("\n")),
        file=sys.stderr,
    )


class _Parser(argparse.ArgumentParser):
    """Argument parser that removes passwords from a quoted wrong command line."""

    def error(self, message: str) -> NoReturn:
        super().error(visible(redact(message)))


class _PrintCompletion(argparse.Action):
    """Action of ``--print-completion``: print the script and end."""

    def __call__(self, parser: object, namespace: object, shell: object, *_: object) -> NoReturn:
        """Print the script for ``shell``."""
        full_parser, _modules = parser_of(COMMANDS)
        print(completion.script(full_parser, str(shell)))
        raise SystemExit(exits.DONE)


def _parse(arguments: list[str]) -> tuple[argparse.Namespace, Any]:
    """Return the parsed arguments and the command's `run`."""
    if not arguments:
        print(_FIRST_STEPS, file=sys.stderr)
        raise SystemExit(exits.USAGE)
    name = _command_in(arguments)
    parser, modules = parser_of([name] if name in COMMANDS else [])
    if name is not None and not modules:
        parser.error(f"no command {name!r}; one of {', '.join(COMMANDS)}")
    args, unknown = parser.parse_known_args(arguments)
    if unknown:
        args.parser.error(f"unrecognized arguments: {' '.join(unknown)}")
    if len(set(args.site or ())) > 1 and args.command not in OF_SITES:
        args.parser.error(f"{args.command} is for one site: only one --site")
    _require_apart(args)
    del args.parser
    args.connect = args.connect or []
    args.sites = list(dict.fromkeys(args.site or ()))
    args.site = args.sites[0] if len(args.sites) == 1 else None
    args.config_found = args.config is None
    if args.config is None:
        args.config = next(filter(Path.exists, PLACES), None)
    elif args.config == "none":
        args.config = None
    else:
        args.config = Path(args.config)
    return args, modules[args.command].run


def _require_apart(args: argparse.Namespace) -> None:
    """Refuse a file that would be written over an input, or over another output."""
    outputs = _OUTPUTS.get(args.command, ("out", "show"))
    values = {name: getattr(args, name, None) for name in (*_FILES, *outputs)}
    paths = {
        name: [str(path) for path in (value if isinstance(value, list) else [value]) if path]
        for name, value in values.items()
    }
    for name in outputs:
        other_paths = [
            os.path.realpath(path) for key in paths.keys() - {name} for path in paths[key]
        ]
        for path in {*paths[name]} - {"-"}:
            if os.path.realpath(path) in other_paths and (
                os.path.isfile(path) or not os.path.exists(path)
            ):
                args.parser.error(
                    f"{path} would be overwritten: give each output a name of its own"
                )


def parser_of(whole: Collection[str]) -> tuple[argparse.ArgumentParser, dict[str, Any]]:
    """Return the parser, and the modules of the commands in ``whole``.

    The parser has the options of the commands in ``whole``, and only the names of the others.
    """
    parser = _Parser(prog="camtopod", description=_DESCRIPTION)
    parser.add_argument("--version", action="version", version=f"camtopod {__version__}")
    parser.add_argument(
        "--print-completion",
        metavar="SHELL",
        choices=completion.SHELLS,
        action=_PrintCompletion,
        help="print a script that completes commands and options in SHELL "
        f"({', '.join(completion.SHELLS)}), and end",
    )
    _add_common(parser, top=True)
    subparsers = parser.add_subparsers(
        dest="command", metavar="COMMAND", title="commands", required=True
    )
    modules = {}
    for command, summary in COMMANDS.items():
        add = functools.partial(subparsers.add_parser, command, help=summary)
        if command in whole:
            modules[command] = importlib.import_module(_module(command))
            inner = modules[command].add_parser(add) or []
            for command_parser in (subparsers.choices[command], *inner):
                _add_common(command_parser, top=False)
                command_parser.set_defaults(parser=command_parser)
        else:
            add()
    return parser, modules


def _module(command: str) -> str:
    """Return the name of the command's module."""
    folders = [folder for folder, names in FOLDERS.items() if command in names]
    return f"camtopod.cli.{[*folders, 'commands'][0]}.{command}"


def _command_in(arguments: list[str]) -> str | None:
    """Return the first argument that is neither an option nor the value of a common option."""
    remainder = iter(arguments)
    for argument in remainder:
        if argument in _COMMON or argument == "--print-completion":
            next(remainder, None)
        elif not argument.startswith("-"):
            return argument
    return None


def _add_common(parser: argparse.ArgumentParser, top: bool) -> None:
    """Add the common options; after the command's name they default to the values before it."""
    group = parser.add_argument_group("common options")
    for option, keywords in _COMMON.items():
        group.add_argument(
            option, **(keywords if top else {**keywords, "default": argparse.SUPPRESS})
        )


def _fail(message: str, status: int, form: str) -> int:
    """Print an error in the chosen log format and return ``status``."""
    message = redact(message)
    text = json.dumps(message, ensure_ascii=False)
    lines = {
        "json": visible(f'{{"level": "error", "message": {text}}}'),
        "logfmt": visible(f"level=error message={text}"),
        "text": visible_lines(f"camtopod: {message}"),
    }
    print(lines[form], file=sys.stderr)
    return status


_DESCRIPTION = (
    "Learns the topology of a camera network from anonymous entry and exit events, and predicts "
    "in which camera an object that leaves a view appears next."
)
_FIRST_STEPS = f"""\
{textwrap.fill(_DESCRIPTION, 80)}

Begin with one of these:
    camtopod demo                      the whole system on simulated cameras, nothing to configure
    camtopod init lobby=rtsp://...     probe your cameras and write camtopod.toml
    camtopod up                        daemon, grabbers and page for them, in one terminal

camtopod --help lists all commands, camtopod COMMAND --help the options of one."""
"""Answer to a command line without anything."""
