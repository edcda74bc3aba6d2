"""Execute an operator's command for the events to come, and store it among them."""

from __future__ import annotations

import contextlib
import logging
import math
import time
from collections.abc import Callable, Iterator

from camtopod.admin import Command, Forget, Rename, Reset
from camtopod.records import Topology
from camtopod.serve.ingest.intake import Intake
from camtopod.serve.ingest.names import CommandRefused

log = logging.getLogger(__name__)

STORED_SECONDS_MAX = 5.0
"""Longest wait until an operator's command can be stored; events are heard meanwhile, and wait."""


def execute(
    intake: Intake,
    command: Command,
    topology: Topology | None,
    reset: Callable[[], Reset],
    on_epoch: Callable[[str], None],
) -> str:
    """Execute a command; return its effect as a sentence, once it is stored. Any thread.

    It is in force when it is stored, and not before.

    topology: the newest version.
    reset: returns the whole command of a reset.
    on_epoch: notes the epoch that a reset has begun.

    Raises `CommandRefused` and `sqlite3.Error`; then nothing has changed.
    """
    with _storing(intake):
        if isinstance(command, Reset):
            command = reset()
        cameras = intake.cameras
        senders = {*intake.numbers.cameras, *cameras.status(), *cameras.heard()}
        if topology is not None:
            senders.update(camera.id for camera in topology.cameras)

        # Store it after the events received before.
        deadline = time.monotonic() + STORED_SECONDS_MAX
        while intake.queue.waiting:
            if intake.writer.reason or time.monotonic() > deadline:
                reason = intake.writer.reason or "the disk does not answer"
                raise CommandRefused(f"{reason}; nothing has changed, try again later")
            time.sleep(0.005)
        number = intake.writer.next_number
        names, item, effect = intake.names.prepare(command, senders, number)
        intake.writer.store_command(item.entry, item.meta)

        # Put it in force.
        with intake.turn:
            intake.names.state = names
            match command:
                case Forget():
                    for name in names.forgotten:  # with its older names
                        cameras.forget(name)
                case Rename(old, new):
                    cameras.rename(old, new)
                case Reset():
                    cameras.forget_all()
                    intake.event_clock.newest = -math.inf
                    intake.backlogs.waited_cameras = frozenset()
                    on_epoch(command.epoch)
            intake.note_stored([item])
    log.warning("%s", effect)
    return effect


@contextlib.contextmanager
def _storing(intake: Intake) -> Iterator[None]:
    """Let the intake hear publications, and nothing else, while the block runs."""
    with intake.commands:
        with intake.turn:
            intake.is_storing_command = True
        try:
            yield
        finally:
            with intake.turn:
                intake.is_storing_command = False
