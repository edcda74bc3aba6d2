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
    detector_line,
    secret_files,
    settings,
    toml_lines,
    without_source,
)
from camtopod.serve.bus import access
from camtopod.visible import visible
from camtopod.vision.detector.onnx_header import HeaderError, input_size


def add_parser(subparsers: Any) -> None:
    """Add `check`."""
    parser = subparsers.add_parser(
        "check",
        help="check a configuration and list all mistakes",
        description="Checks a configuration and lists all mistakes in one pass. If there are none, "
        "it says for each camera which settings of vision are not the defaults.",
        epilog="example: camtopod check camtopod.toml --probe",
    )
    parser.add_argument(
        "file",
        nargs="?",
        type=Path,
        metavar="CONFIG",
        help="the configuration file (default: that of --config, else the one that is found)",
    )
    parser.add_argument(
        "--example",
        action="store_true",
        help="print an example configuration with every setting, its default and its unit",
    )
    parser.add_argument(
        "--probe", action="store_true", help="also open each of its cameras, and the bus"
    )
    parser.add_argument(
        "--pictures",
        metavar="DIR",
        type=Path,
        help="with --probe: store a picture of each camera as DIR/NAME.jpg, replacing an older "
        "one; `camtopod web` and `report` draw zones on it. It shows the scene without the people "
        "who walk through it, and takes 6 to 30 seconds. It is stored only there and not sent",
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
    if args.pictures is not None and not args.probe:
        raise CommandError(
            "--pictures needs --probe, which opens the cameras: give both", exits.USAGE
        )
    path = args.file or args.config
    if path is None:
        raise CommandError(
            "no configuration given, and none found: camtopod check CONFIG", exits.USAGE
        )
    try:
        raw = path.read_bytes()
        loaded = with_options(args, settings.load(path, raw))
    except settings.ConfigError as error:
        print(error, file=sys.stderr)
        return exits.CONFIG
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}") from None

    # Models that cannot be read.
    problems = list(_model_problems(path, loaded, raw.decode()))
    if problems:
        print("\n".join(map(visible, problems)), file=sys.stderr)
        return exits.CONFIG

    # Warn of files and a bus that are open to others.
    warnings = secret_files.find_exposed(loaded.secrets(path))
    for warning in filter(None, [*warnings, access.openness_warning(loaded)]):
        print(f"{path}: warning: {warning}", file=sys.stderr)

    # Say what holds for each camera.
    for line in _camera_lines(path, loaded, raw.decode()):
        print(visible(line), file=sys.stderr)
    print(
        f"{path}: no mistakes; site {loaded.site.name}, {counted(len(loaded.cameras), 'camera')}",
        file=sys.stderr,
    )
    if not args.probe:
        return exits.DONE
    from camtopod.cli.cameras.probe import check_site

    return check_site(path, loaded, args.pictures)


def _model_problems(path: Path, config: Config, text: str) -> Iterator[str]:
    """Yield a sentence, with file and line, for each model of a detector that cannot be read.

    text: content of the configuration file ``path``.
    """
    detectors = {name: camera.detector for name, camera in config.cameras.items()}
    named = set()
    for camera, detector in {"": config.detector, **detectors}.items():
        if not detector.model:
            continue
        try:
            input_size(detector.model)
        except HeaderError as error:
            line, name = detector_line(text, camera, "model")
            if line not in named:
                named.add(line)
                yield f"{path}:{line}: {name}: {error}"


def _camera_lines(path: Path, config: Config, text: str) -> Iterator[str]:
    """Yield a line for each camera without a source or with settings other than the defaults.

    text: content of the configuration file ``path``.
    """
    for problem in without_source(config, text, path):
        where, _, what = problem.partition(": ")
        yield f"{where}: warning: {what}"

    lines = toml_lines.key_lines(text)
    plain = 0
    for camera in config.cameras:
        own = ", ".join(map(_setting, config.own_vision(camera).items()))
        common = ", ".join(map(_setting, config.common_vision(camera).items()))
        where = f"{path}:{lines.get(('cameras', camera), 1)}: cameras.{camera}"
        parts = [own, common and f"of [vision]: {common}", *_detector_words(config, camera)]
        if text := "; ".join(filter(None, parts)):
            yield f"{where}: {text}"
        else:
            plain += 1
    if plain:
        yield f"{path}: {counted(plain, 'camera')} with default settings of vision"


def _detector_words(config: Config, camera: str) -> list[str]:
    """Return the detector of a camera in words; nothing if there is none and could be none."""
    detector = config.cameras[camera].detector
    if not detector.model:
        return ["detector = false"] if config.detector.model else []
    labels = ", ".join(map(str, detector.labels))
    return [f"detector {Path(detector.model).name} ({labels})"]


def _setting(item: tuple[str, Any]) -> str:
    """Return a setting in words; of areas only how many there are, and how large."""
    key, value = item
    if key == "ignore" and value:
        from camtopod.vision.detect import ignored_share

        return f"ignore {counted(len(value), 'area')} ({ignored_share(value):.0%} of the picture)"
    if key == "doors" and value:
        return counted(len(value), "door")
    return f"{key} = {json.dumps(value)}"
