"""What `camtopod watch` shows of a version: alarms and how good the predictions are."""

from __future__ import annotations

import msgspec

from camtopod.cli.watch import ALARMS_SHOWN, Board
from camtopod.records import TOPOLOGY_SCHEMA, Alarm, SelfScore, Topology

NOTHING = Topology(TOPOLOGY_SCHEMA, "hq", "01J", 9, 1_700_003_600.0, 0, "sha256:0", [], [], [], [])
SCORE = SelfScore(200, 3, 1.25, 0.81, 0.93, 1.75, 0.55)


def shown(topology: Topology | None) -> str:
    return "\n".join(Board().draw(topology, "hq", 1_700_007_200.0))


def topology(alarms: int, score: SelfScore | None) -> Topology:
    """A version with so many alarms, an hour old each."""
    listed = [
        Alarm(k, 1_700_003_600.0, "link_closed", f"lobby/{k}->hall/2", "share 0.60 until 5, 0.00 since")
        for k in range(alarms)
    ]
    return msgspec.structs.replace(NOTHING, alarms=listed or None, score=score)


def test_the_newest_alarms_are_shown_newest_first() -> None:
    text = shown(topology(ALARMS_SHOWN + 2, None))
    assert "60 min ago, version 6: link_closed lobby/6->hall/2, share 0.60 until 5, 0.00 since" in text
    assert text.index("lobby/6->") < text.index("lobby/2->")
    assert "lobby/1->" not in text


def test_the_score_is_shown_beside_its_baseline() -> None:
    text = shown(topology(0, SCORE))
    assert "next camera right 0.81 (the usual one 0.55), among three 0.93, log loss 1.25 (1.75)" in text
    assert "200 exits since version 3" in text


def test_without_either_nothing_is_said() -> None:
    assert "ALARMS" not in shown(topology(0, None)) + shown(None)
    assert "next camera right" not in shown(topology(0, None)) + shown(None)
