"""Pass a recording to a learner, and show how far it is."""

from __future__ import annotations

from typing import BinaryIO

from camtopod.cli.events.event_lines import LineReader
from camtopod.cli.events.recording import Times, recorded
from camtopod.cli.terminal import ProgressLine
from camtopod.codec import to_json
from camtopod.learn.learner import STEPS, Learner


def feed(
    learner: Learner,
    reader: LineReader,
    paths: list[str],
    times: Times,
    updates: BinaryIO | None = None,
) -> None:
    """Pass every line of a recording to the learner, write each version, show progress."""
    with ProgressLine(lines=True) as progress:

        def say_step(step: str) -> None:
            progress.show("step %d of %d: %s", STEPS.index(step) + 1, len(STEPS), step)

        learner.on_step = say_step
        for line in recorded(reader, paths, times):
            verdict = learner.receive(line.event)
            if verdict == "duplicate":
                reader.repeat(line)
            elif verdict == "refused":
                reader.reject_event(
                    verdict, f"{line.file}:{line.number}: more cameras than can be learned"
                )
            if progress.due:
                progress.show("%d lines, %.0f %%", reader.lines_read, 100 * (reader.share() or 0.0))
            _write(learner, updates)
        learner.flush()
        _write(learner, updates)


def _write(learner: Learner, updates: BinaryIO | None) -> None:
    """Take new versions from the learner, and write them if asked to."""
    for topology in learner.updates():
        if updates is not None:
            updates.write(to_json(topology) + b"\n")
