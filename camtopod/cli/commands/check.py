"""`camtopod check`: list all mistakes in a configuration, or the settings of each camera; with
--probe, open its cameras and the bus.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from camtopod.cli import exits
from camtopod.cli.common import counted, with_options
from camtopod.cli.exits import CommandError, InputError
from camtopod.config import (
    Config,
    ConfigError,
    config_file,
    detector_line,
    districts_file,
    key_lines,
    owners_of,
    secret_files,
    without_source,
)
from camtopod.serve.bus import access
from camtopod.visible import visible
from camtopod.vision.settings import VisionSettings


def add_parser(add: Any) -> None:
    """Add `check`."""
    parser = add(
        description="Checks a configuration and lists all mistakes in one pass. If there are none, "
        "it says for each camera which settings of vision are not the defaults. Of districts, it "
        "prints the tables of the cameras that deliver to several.",
        epilog="example: camtopod check camtopod.toml --probe",
    )
    parser.add_argument(
        "file",
        nargs="?",
        type=Path,
        metavar="CONFIG",
        help="the configuration file, or one of districts (default: that of --config, else the one "
        "that is found)",
    )
    parser.add_argument(
        "--example",
        action="store_true",
        help="print an example configuration with every setting, its default and its unit",
    )
    parser.add_argument(
        "--probe",
        action="store_true",
        help="also open each of its cameras, and the bus; with [web] pictures, renew the cameras' "
        "pictures in that folder, which takes 6 to 30 seconds",
    )


def run(args: argparse.Namespace) -> int:
    """Check the configuration.

    Mistakes go to standard error as ``file:line: what``, as do warnings of files and a bus that are
    open to others.
    """
    if args.example:
        from camtopod.cli.generated import example

        sys.stdout.write(example())
        return exits.DONE

    # Load the configuration, or list its mistakes.
    path = args.file or args.config
    if path is None:
        raise CommandError(
            "no configuration given, and none found: camtopod check CONFIG", exits.USAGE
        )
    try:
        raw = path.read_bytes()
        if districts_file.is_districts(raw):
            districts = districts_file.load(path, raw)
            for table in districts_file.camera_tables(districts):
                print(f"{table}\n")
            cameras = counted(len(owners_of(districts)), "camera")
            count = counted(len(districts), "district")
            print(f"{path}: no mistakes; {count}, {cameras}", file=sys.stderr)
            return exits.DONE
        config = with_options(args, config_file.load(path, raw))
    except ConfigError as error:
        print(error, file=sys.stderr)
        return exits.CONFIG
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from None

    # Models and sources that cannot be used.
    problems = [*_source_problems(path, config, raw.decode())]
    problems += _model_problems(path, config, raw.decode())
    if problems:
        print("\n".join(map(visible, problems)), file=sys.stderr)
        return exits.CONFIG

    # Warn of files and a bus that are open to others.
    warnings = secret_files.find_exposed(config.secrets(path))
    open_to = access.openness_warning(config)
    if open_to and not (config.listens and all(map(access.is_local, config.listens))):
        warnings.append(open_to)  # on one machine, `run` says it
    for warning in warnings:
        print(f"{path}: warning: {warning}", file=sys.stderr)

    # Say what holds for each camera.
    for line in _camera_lines(path, config, raw.decode()):
        print(visible(line), file=sys.stderr)
    print(
        f"{path}: no mistakes; site {config.site.name}, {counted(len(config.cameras), 'camera')}",
        file=sys.stderr,
    )
    if not args.probe:
        return exits.DONE
    from camtopod.cli.cameras.probe import check_site

    return check_site(path, config)


def _source_problems(path: Path, config: Config, text: str) -> Iterator[str]:
    """Yield a sentence, with file and line, for each source that no program could read.

    text: content of the configuration file ``path``.
    """
    from camtopod.vision.source import why_no_stream

    lines = key_lines(text)
    for name, camera in config.cameras.items():
        if reason := why_no_stream(camera.source or ""):
            line = lines.get(("cameras", name, "source"), 1)
            yield f"{path}:{line}: cameras.{name}.source: {reason}"


def _model_problems(path: Path, config: Config, text: str) -> Iterator[str]:
    """Yield a sentence, with file and line, for each model of a detector that cannot be used.

    text: content of the configuration file ``path``.
    """
    from camtopod.cli.cameras.probe import try_detector

    detectors = {config.detector: ""}
    for camera_name, camera in config.cameras.items():
        detectors.setdefault(camera.detector, camera_name)
    for detector, camera_name in detectors.items():
        if detector.model and (report := try_detector(detector)).problem:
            line, name = detector_line(text, camera_name, report.key)
            yield f"{path}:{line}: {name}: {report.problem}"


def _camera_lines(path: Path, config: Config, text: str) -> Iterator[str]:
    """Yield a line for each camera without a source or with settings other than the defaults.

    text: content of the configuration file ``path``.
    """
    for problem in without_source(config, text, path):
        place, _, lack = problem.partition(": ")
        yield f"{place}: warning: {lack}"

    lines = key_lines(text)
    defaults = VisionSettings()
    for name, camera in config.cameras.items():
        words = []
        for key in VisionSettings.__struct_fields__:
            value = getattr(camera, key)
            if isinstance(value, tuple) and value:
                words.append(f"{key}: {len(value)}")
            elif value != getattr(defaults, key):
                words.append(f"{key} = {json.dumps(value)}")
        if camera.detector.model:
            labels = ", ".join(map(str, camera.detector.labels))
            words.append(f"detector {Path(camera.detector.model).name} ({labels})")
        elif config.detector.model:
            words.append("detector = false")
        if camera.sites:
            words.append(f"delivers to {', '.join(camera.sites)}")
        if words:
            yield f"{path}:{lines.get(('cameras', name), 1)}: cameras.{name}: {', '.join(words)}"
