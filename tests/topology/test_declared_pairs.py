"""Declared pairs of cameras as odds."""

from __future__ import annotations

import pytest

from camtopod.records import Declared
from camtopod.topology import declared_odds, favours
from camtopod.topology.declared_pairs import NEIGHBOURS_ODDS


def test_odds_of_declared_pairs_hold_in_both_directions_and_unknown_ones_are_1() -> None:
    declared = Declared([("a", "b")], [("b", "c"), ("a", "gone")])
    odds = declared_odds(declared, ["a", "b", "c"])
    assert odds is not None
    more, less = NEIGHBOURS_ODDS, 1.0 / NEIGHBOURS_ODDS
    assert odds.tolist() == [[1.0, more, 1.0], [more, 1.0, less], [1.0, less, 1.0]]
    assert favours(odds).max() == 1.0
    assert favours(odds)[1, 2] == pytest.approx(less)


def test_nothing_declared_has_no_odds() -> None:
    assert declared_odds(None, ["a", "b"]) is None
    assert declared_odds(Declared(nobody_leaves=True), ["a", "b"]) is None
