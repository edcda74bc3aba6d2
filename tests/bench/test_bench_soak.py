"""`bench soak`: its messages about the days."""

from __future__ import annotations

from collections import Counter

import pytest

from bench.soak import (
    BESIDE_BYTES,
    GROWTH_MAX,
    Day,
    bound_violations,
    growth_violations,
    main,
    miscounted,
)

MEGABYTE = 2**20


def days(resident: list[int], disk: int = 10) -> list[Day]:
    """Return days with these sizes of memory, megabytes, and constant sizes on disk."""
    return [
        Day(number, size * MEGABYTE, disk * MEGABYTE, disk * MEGABYTE, number, 1.0, 1.0)
        for number, size in enumerate(resident, start=1)
    ]


def on_the_disk(journal: list[int]) -> list[Day]:
    return [
        Day(number, 1, size * MEGABYTE, 1, number, 1.0, 1.0)
        for number, size in enumerate(journal, start=1)
    ]


@pytest.mark.parametrize(
    ("what", "sizes", "said"),
    [
        ("flat", [50, 100, 101, 99, 104, 100, 100], []),
        ("it fills on the first day and is free again", [500, 100, 100, 100, 100, 100, 100], []),
        ("it leaks", [50, 100, 101, 102, 103, 104, 106], ["resident has grown by more than 5%"]),
        ("a hump", [50, 100, 100, 120, 100, 100, 100], ["resident has grown by more than 5%"]),
        (
            "the second day is the one",
            [50, 100, 106, 106, 106, 106, 106],
            ["resident has grown by more than 5%"],
        ),
        ("no later day", [50, 100], [f"{one} days are needed" for one in ("", "", "")]),
    ],
)
def test_memory_is_held_against_the_second_day(
    what: str, sizes: list[int], said: list[str]
) -> None:
    found = list(growth_violations(days(sizes)))
    assert len(found) == len(said), what
    assert all(end in one for one, end in zip(found, said, strict=True))


def test_the_disk_is_held_against_the_fifth_day() -> None:
    assert list(growth_violations(on_the_disk([10, 20, 30, 40, 100, 104, 105]))) == []
    assert list(growth_violations(on_the_disk([10, 20, 30, 40, 100, 106, 100]))) == [
        "journal has grown by more than 5%"
    ]
    assert GROWTH_MAX == 0.05


def test_the_disk_is_held_against_its_bound_on_every_day() -> None:
    bounds = {"journal": 10 * MEGABYTE}
    beside = BESIDE_BYTES["journal"] // MEGABYTE
    assert list(bound_violations(on_the_disk([1, 9, 10, 10 + beside]), bounds)) == []
    [said] = bound_violations(on_the_disk([1, 9, 11 + beside, 10]), bounds)
    assert (
        said
        == f"journal has {(11 + beside) * MEGABYTE} bytes on day 3; its bound is {10 * MEGABYTE}"
    )
    [said] = bound_violations(on_the_disk([1, 7, 7, 7]), bounds)
    assert said == "journal has never come near its bound, so the bound is not tested"


def test_one_lost_and_one_doubled_do_not_cancel_out() -> None:
    stored = Counter({("a", 1): 1, ("a", 2): 1, ("b", 1): 1})
    assert list(miscounted({"a": 2, "b": 1}, stored)) == []
    stored = Counter({("a", 1): 2, ("b", 1): 1})
    assert list(miscounted({"a": 2, "b": 1}, stored)) == [
        "1 of 3 events are lost, the first ('a', 2)",
        "1 of 3 events are stored more than once, the first ('a', 1)",
    ]
    stored = Counter({("a", 1): 1, ("a", 3): 1})
    assert list(miscounted({"a": 2}, stored)) == [
        "1 of 2 events are lost, the first ('a', 2)",
        "1 of 2 events are stored and never sent, the first ('a', 3)",
    ]


def test_a_day_in_small(capfd: pytest.CaptureFixture[str]) -> None:
    """A short run completes and reports that days and events are too few to judge."""
    assert main(["--days", "1", "--cameras", "3", "--events", "120"]) == 1
    said = capfd.readouterr().out.splitlines()[-5:]
    assert [line for line in said if "are needed" in line or "never come near" in line] == said
