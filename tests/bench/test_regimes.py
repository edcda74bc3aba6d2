"""The regimes of the bench have the properties that their names say."""

from __future__ import annotations

import numpy as np
import pytest

from bench.regimes import REGIMES, main, told_top1
from camtopod.records import Event
from camtopod.sim.truth import TRUTH_SCHEMA, Truth

ROWS = {
    *(
        "zones-10",
        "zones-30",
        "sparse",
        "medium",
        "dense",
        "rhythm",
        "rhythm-dense",
        "faulty",
        "no-links",
        "short",
    ),
    *("overlapped", "clocks", "rhythm-sparse", "rhythm-medium", "windows", "clocks-uneven"),
}
TWINS = {"hall", "crowd", "walkway", "road"}


def test_names_are_the_keys_and_the_rows_are_there() -> None:
    assert all(name == regime.name for name, regime in REGIMES.items())
    assert REGIMES.keys() > ROWS | TWINS


@pytest.mark.parametrize("name", sorted(REGIMES))
def test_every_regime_is_made_and_its_seed_decides(name: str) -> None:
    events, truth = REGIMES[name].make(1, 0.1)
    assert REGIMES[name].make(1, 0.1) == (events, truth)
    assert REGIMES[name].make(2, 0.1)[0] != events
    assert len(events) == len(truth.identity)
    assert len(events) > 20
    assert len(truth.cameras) == {"road": 20, "walkway": 6, "hall": 7, "crowd": 7}.get(name, 12)


def test_the_rows_have_the_sizes_asked_for() -> None:
    sizes_of = {
        "sparse": 50_000,
        "rhythm-sparse": 50_000,
        "dense": 50_000,
        "no-links": 50_000,
        "short": 9_000,
    }
    for name, size in sizes_of.items():
        sizes = [len(REGIMES[name].make(seed, 0.1)[0]) for seed in range(6)]
        assert np.mean(sizes) == pytest.approx(size / 10, rel=0.25)


def test_the_told_chain_counts() -> None:
    """People walk a, b, c or c, b, a: the present camera tells half, the previous one all."""
    events, identity, passage = [], [], []
    for who in range(40):
        for number, camera in enumerate("abc" if who % 2 else "cba"):
            for kind in ("entry", "exit"):
                events.append(
                    Event(camera, "entry" if kind == "entry" else "exit", 100.0 * who + 10 * number)
                )
                identity.append(who)
                passage.append(number)
    truth = Truth(
        TRUTH_SCHEMA, ["a", "b", "c"], [], [], [], {}, identity, passage, [-1] * len(events)
    )
    told = told_top1(events, truth)
    assert told["camera and previous"] == 1.0
    assert told["camera"] == told["zone"] == 0.75


def test_command_lists_and_describes(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert listed == list(REGIMES)
    assert main(["walkway", "no-links", "--scale", "0.05", "--seed", "4"]) == 0
    out = capsys.readouterr().out
    assert "walkway: " in out
    assert "0 links (0 overlapped)" in out
    with pytest.raises(SystemExit):
        main(["nowhere"])
