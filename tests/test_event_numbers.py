"""The numbers of a camera's events: each counts once, in any order."""

from __future__ import annotations

import random

from camtopod.event_numbers import BOOTS_MAX, RANGES_MAX, EventNumbers


def test_numbers_are_remembered_in_any_order() -> None:
    for seed in range(50):
        chance = random.Random(seed)
        numbers, seqs = EventNumbers(), set()
        for _ in range(200):
            seq = chance.randrange(60)
            assert numbers.add("b", seq) is (seq not in seqs)
            seqs.add(seq)


def test_the_oldest_numbers_are_forgotten() -> None:
    numbers = EventNumbers()
    for number in range(RANGES_MAX + 1):
        assert numbers.add("b", 2 * number)
    assert numbers.add("b", 0)
    assert not numbers.add("b", 2 * RANGES_MAX)

    for number in range(BOOTS_MAX):
        numbers.add(f"b{number}", 1)
    assert numbers.add("b", 2 * RANGES_MAX)
    assert not numbers.add(f"b{BOOTS_MAX - 1}", 1)
