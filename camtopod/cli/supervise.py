"""All cameras of a configuration, a process each: one that fails is started again and harms no other."""

from __future__ import annotations

import argparse
import logging
import os
import random
import subprocess
import sys
import time
from collections.abc import Callable

from msgspec import Struct

from camtopod.cli import exits
from camtopod.cli.common import until_signal
from camtopod.config import Config

log = logging.getLogger(__name__)

BACKOFF_MIN_SECONDS = 1.0
BACKOFF_MAX_SECONDS = 60.0
STEADY_SECONDS = 60.0
"""A process that ran this long is started again without waiting longer than the first time."""
STOP_SECONDS = 4.5
_LOOK_SECONDS = 0.1
_HOPELESS = (exits.USAGE, exits.CONFIG)
"""With these statuses starting again changes nothing."""


class Child(Struct):
    """One camera's process. ``again_at``: when to start (again), on the monotonic clock."""

    camera: str
    process: subprocess.Popen[bytes] | None = None
    started: float = 0.0
    again_at: float | None = 0.0
    backoff: float = BACKOFF_MIN_SECONDS
    status: int = 0


def backoff_after(backoff: float, ran: float, chance: Callable[[], float] = random.random) -> tuple[float, float]:
    """(seconds to wait now, backoff for the next time) after a process that ran for ``ran`` seconds."""
    if ran >= STEADY_SECONDS:
        backoff = BACKOFF_MIN_SECONDS
    return backoff * (0.5 + chance()), min(2 * backoff, BACKOFF_MAX_SECONDS)


def supervise(args: argparse.Namespace, config: Config) -> int:
    """Run `camtopod grab` for every camera until all have ended or a signal comes; the worst status."""
    children = [Child(camera) for camera in config.cameras]
    with until_signal() as stop:
        try:
            while not stop.is_set() and any(c.again_at is not None or c.process for c in children):
                for child in children:
                    _look_after(child, args)
                stop.wait(_LOOK_SECONDS)
        finally:
            _end(children)
    return exits.DONE if stop.is_set() else max(child.status for child in children)


def _look_after(child: Child, args: argparse.Namespace) -> None:
    now = time.monotonic()
    if child.process is None:
        if child.again_at is not None and now >= child.again_at:
            child.process = subprocess.Popen(command(child.camera, args), stdin=subprocess.DEVNULL)
            child.started, child.again_at = now, None
        return
    status = child.process.poll()
    if status is None:
        return
    child.process, child.status = None, abs(status)
    if status == exits.DONE:
        log.info("camera %s has ended", child.camera)
    elif status in _HOPELESS:
        log.error("camera %s ended with status %d and is not started again", child.camera, status)
    else:
        wait, child.backoff = backoff_after(child.backoff, now - child.started)
        child.again_at = now + wait
        log.warning("camera %s ended with status %d; again in %.1f s", child.camera, status, wait)


def command(camera: str, args: argparse.Namespace) -> list[str]:
    """The command line of one camera's process: no source in it, so no password either."""
    line = [sys.executable, "-m", "camtopod", "--config", str(args.config), "--log-format", args.log_format]
    if args.site is not None:
        line += ["--site", args.site]
    for endpoint in args.connect:
        line += ["--connect", endpoint]
    line += ["grab", "--camera", camera, "--with-parent", str(os.getpid())]
    for option in ("state", "start", "speed"):
        if getattr(args, option) is not None:
            line += [f"--{option}", str(getattr(args, option))]
    return line + (["--realtime"] if args.realtime else [])


def _end(children: list[Child]) -> None:
    running = [child.process for child in children if child.process is not None]
    for process in running:
        process.terminate()
    deadline = time.monotonic() + STOP_SECONDS
    for process in running:
        try:
            process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
