"""Execute an operator's command for the events to come, and store it among them."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable

from msgspec.structs import replace

from camtopod.admin import Command, Forget, Rename, Reset
from camtopod.records import Topology
from camtopod.serve.ingest.intake import Intake
from camtopod.serve.ingest.names import CommandRefused

log = logging.getLogger(__name__)

STORED_SECONDS_MAX = 20.0
"""Longest wait until an operator's command is stored."""


def execute(
    intake: Intake, command: Command, topology: Topology | None, reset: Callable[[], Reset]
) -> str:
    """Execute a command; return its effect as a sentence, once it is stored. Any thread.

    topology: the newest version.
    reset: returns the whole command of a reset.

    Raises `CommandRefused` and `sqlite3.Error`.
    """
    stored = threading.Event()
    with intake.turn:
        if isinstance(command, Reset):
            command = reset()
        cameras = intake.cameras
        known = {*intake.numbers.cameras, *cameras.status(set())}
        if topology is not None:
            known.update(camera.id for camera in topology.cameras)
        entry, effect = intake.names.carry_out(command, known)
        match command:
            case Forget(camera):
                cameras.forget(camera)
            case Rename(old, new):
                cameras.rename(old, new)
            case Reset():
                cameras.forget_all()
                intake.event_clock.newest = -math.inf
        intake.queue.put([replace(entry, stored=stored)])

    if not stored.wait(STORED_SECONDS_MAX):
        raise CommandRefused(
            f"it is not stored after {STORED_SECONDS_MAX:g} s, as the disk does not answer; the"
            " status of the daemon will show whether it was carried out"
        )
    log.warning("%s", effect)
    return effect
