"""Simulated scenes: events and ground truth fit each other."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path

import pytest

from bench import scene
from camtopod import codec
from camtopod.codec import event_from_json
from camtopod.records import Event
from camtopod.sim.truth import CLUTTER, Truth


@pytest.mark.parametrize(
    ("name", "cameras"), [("hall", 7), ("crowd", 7), ("walkway", 6), ("road", 20)]
)
def test_a_recording_is_consistent(name: str, cameras: int, tmp_path: Path) -> None:
    lines, told = tmp_path / "events.jsonl", tmp_path / "truth.json"

    assert scene.main([name, "--events", str(lines), "--truth", str(told), "--seconds", "400"]) == 0

    events = [event_from_json(line) for line in lines.read_text().splitlines()]
    truth = codec.read(Truth, told.read_bytes())
    assert len(events) == len(truth.identity) == len(truth.passage) == len(truth.zone) > 20
    assert [event.t for event in events] == sorted(event.t for event in events)
    assert len(truth.cameras) == cameras
    assert {event.camera for event in events} <= set(truth.cameras)
    passages = defaultdict[tuple[int, int], list[Event]](list)
    for event, who, passage, zone in zip(
        events, truth.identity, truth.passage, truth.zone, strict=True
    ):
        assert zone < 0 or (who >= 0 and truth.zones[zone].camera == event.camera)
        if who != CLUTTER:
            passages[who, passage].append(event)
    for one in passages.values():
        assert len({(event.camera, event.track) for event in one}) == 1
        assert sorted(event.kind for event in one) == ["entry", "exit"]
