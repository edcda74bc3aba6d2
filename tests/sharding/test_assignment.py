"""Assignment: every camera has one district, every district one shard, and both are stable."""

from __future__ import annotations

import tracemalloc

import pytest
from hypothesis import given
from hypothesis import strategies as st

from camtopod.sharding import assignment as dealing_module
from camtopod.sharding.assignment import Assignment, Sharding, districts_of

CAMERAS = st.from_regex(r"[A-Za-z0-9_.-]{1,64}", fullmatch=True)


@given(
    st.integers(1, 40).flatmap(
        lambda districts: st.tuples(st.just(districts), st.integers(1, districts))
    )
)
def test_every_district_is_in_one_shard(numbers: tuple[int, int]) -> None:
    districts, shards = numbers
    dealt = [
        district for shard in range(shards) for district in districts_of(shard, shards, districts)
    ]
    assert sorted(dealt) == list(range(districts))
    assert all(districts_of(shard, shards, districts) for shard in range(shards))


@pytest.mark.parametrize(("shard", "shards"), [(2, 2), (-1, 2), (0, 17), (0, 0)])
def test_there_is_no_such_shard(shard: int, shards: int) -> None:
    with pytest.raises(ValueError, match="shard"):
        districts_of(shard, shards, 16)


def test_a_camera_stays_in_its_district() -> None:
    """Other hashes would reassign every site, and each district would start from nothing."""
    dealing = Assignment(Sharding(guest_turns=4))
    assert [dealing.district(f"cam{k:02d}") for k in range(8)] == [14, 3, 14, 5, 6, 1, 13, 2]
    turns = [[turn for turn in range(4) if dealing.is_guest(f"cam{k:02d}", turn)] for k in range(8)]
    assert turns == [[1], [1], [0], [3], [3], [3], [2], [1]]


def test_names_that_are_made_up_fill_no_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Any client may ask for a prediction of any camera."""
    monkeypatch.setattr(dealing_module, "REMEMBERED_MAX", 100)
    dealing = Assignment(Sharding())
    tracemalloc.start()
    try:
        for number in range(1_000):
            dealing.district(f"cam{number}")
            dealing.is_guest(f"cam{number}", 1)
        before, _ = tracemalloc.get_traced_memory()
        for number in range(20_000):
            dealing.district(f"made-up-{number}")
            dealing.is_guest(f"made-up-{number}", 1)
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert after - before < 100_000


def test_cameras_are_dealt_about_evenly() -> None:
    dealing = Assignment(Sharding(districts=4))
    dealt = [dealing.district(f"hall-{number}.cam") for number in range(2000)]
    sizes = [dealt.count(district) for district in range(4)]
    assert sum(sizes) == 2000
    assert min(sizes) > 440


def test_what_fits_a_pattern_is_together() -> None:
    dealing = Assignment(Sharding(districts=3, together=("floor1-*", "*-door", "yard", "floor2-*")))
    assert dealing.district("floor1-a") == dealing.district("floor1-door") == 0
    assert dealing.district("cellar-door") == 1
    assert dealing.district("yard") == 2
    assert dealing.district("floor2-x") == 0
    assert dealing.district("elsewhere") == Assignment(Sharding(districts=3)).district("elsewhere")


@given(CAMERAS, st.integers(1, 20), st.integers(0, 10**6))
def test_everybody_is_a_guest_in_one_turn_of_each_round(
    camera: str, turns: int, first: int
) -> None:
    dealing = Assignment(Sharding(guest_turns=turns))
    assert sum(dealing.is_guest(camera, turn) for turn in range(first, first + turns)) == 1
