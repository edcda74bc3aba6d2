"""Find cameras that two programs publish at the same time."""

from __future__ import annotations

from camtopod.learn.changes import News
from camtopod.learn.snapshot import LearnerState
from camtopod.publishers import RETURNS_MIN, CameraBoots
from camtopod.records import Event


def find_doubled_cameras(state: LearnerState, batch: list[tuple[int, Event]]) -> None:
    """Add the cameras that new events show to have two publishers to ``state.doubled``.

    Each pair of programs is reported once.

    batch (microseconds, event): new events in order of time.
    """
    for _, event in batch:
        if event.boot is None:
            continue
        publisher = state.publishers.setdefault(event.camera, CameraBoots(event.boot))
        if publisher.note_boot(event.boot) and publisher.returns == RETURNS_MIN:
            state.doubled.append(event.camera)


def doubled_news(state: LearnerState) -> list[News]:
    """Return the alarms for the cameras found since the last version, ``state.doubled``."""
    doubled_publishers = [(name, state.publishers[name]) for name in state.doubled]
    return [
        (
            "camera_doubled",
            name,
            "two programs publish it at the same time,"
            f" boots {publisher.before} and {publisher.boot}",
        )
        for name, publisher in doubled_publishers
    ]
