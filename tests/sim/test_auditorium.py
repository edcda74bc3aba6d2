"""The recording that comes with the package."""

from __future__ import annotations

import csv

import camtopod
from camtopod.sim import AUDITORIUM


def test_every_passage_of_the_recording_has_an_identity() -> None:
    events = camtopod.load_events(AUDITORIUM / "events.jsonl")
    with (AUDITORIUM / "identities.csv").open(newline="") as rows:
        identity = {row["track"]: row["identity"] for row in csv.DictReader(rows)}
    assert {event.track for event in events} == set(identity)
    assert (len(events), len(set(identity.values()))) == (216, 21)
