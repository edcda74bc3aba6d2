"""Order within each stream: every event once and in order, despite network and spool."""

from __future__ import annotations

from hypothesis import given, settings, strategies as st

from camtopod.serve.ingest.sequencing import JUMP_MAX, Streams

KEY = ("lobby", "b1")


def streams(
    held: int = 100,
    streams_max: int = 10,
    stored: dict[tuple[str, str], int] | None = None,
    boots_max: int = 4,
) -> Streams[int]:
    return Streams(stored or {}, held, streams_max, boots_max)


def test_in_order_is_ready_at_once_and_a_repetition_is_a_duplicate() -> None:
    order = streams()
    assert order.add(KEY, 1, 1, 0.0) == ("ready", [1])
    assert order.add(KEY, 2, 2, 0.0) == ("ready", [2])
    assert order.add(KEY, 2, 2, 0.0) == ("duplicate", [])
    assert order.add(KEY, 1, 1, 0.0) == ("duplicate", [])
    assert order.next_to_pull("lobby") == ("b1", 3)


def test_a_stream_may_count_from_zero() -> None:
    order = streams()
    assert order.add(KEY, 0, 0, 0.0) == ("ready", [0])
    assert order.add(KEY, 1, 1, 0.0) == ("ready", [1])


def test_after_a_restart_it_goes_on_behind_what_is_stored() -> None:
    order = streams(stored={KEY: 41})
    assert order.add(KEY, 41, 41, 0.0) == ("duplicate", [])
    assert order.add(KEY, 43, 43, 0.0) == ("held", [])
    assert order.add(KEY, 42, 42, 0.0) == ("ready", [42, 43])
    assert order.gaps == set()


def test_a_gap_is_waited_for_while_a_spool_may_fill_it() -> None:
    order = streams()
    order.add(KEY, 1, 1, 0.0)
    assert order.add(KEY, 3, 3, 1.0) == ("held", [])
    assert order.gaps == {"lobby"}
    assert order.give_up_gaps(1000.0, 5.0, has_spool={"lobby"}) == []
    order.note_answer(KEY, 2, [3], more=False)
    assert order.give_up_gaps(5.9, 5.0, has_spool={"lobby"}) == []
    assert order.give_up_gaps(6.0, 5.0, has_spool={"lobby"}) == [3]
    assert order.lost == 1
    assert order.add(KEY, 2, 2, 7.0) == ("duplicate", [])


def test_without_a_spool_a_gap_is_given_up_after_a_while() -> None:
    order = streams()
    order.add(KEY, 1, 1, 0.0)
    order.add(KEY, 4, 4, 0.0)
    order.add(KEY, 5, 5, 1.0)
    assert order.give_up_gaps(4.9, 5.0, has_spool=set()) == []
    assert order.give_up_gaps(5.0, 5.0, has_spool=set()) == [4, 5]
    assert order.lost == 2


def test_an_answer_to_another_question_does_not_end_the_waiting() -> None:
    order = streams(stored={KEY: 4})
    order.add(KEY, 7, 7, 0.0)
    order.note_answer(KEY, 6, [7], more=False)  # asked before it was known what is missing
    assert order.give_up_gaps(100.0, 5.0, has_spool={"lobby"}) == []
    order.note_answer(KEY, 5, [7], more=False)
    assert order.give_up_gaps(100.0, 5.0, has_spool={"lobby"}) == [7]


def test_what_the_spool_no_longer_has_is_lost() -> None:
    order = streams(stored={KEY: 3})
    order.add(KEY, 6, 6, 0.0)
    assert order.skip_before(KEY, 6, 0.0) == [6]
    assert order.lost == 2
    assert order.skip_before(KEY, 2, 0.0) == []
    assert order.skip_before(("new", "b9"), 500, 0.0) == []
    assert order.lost == 2, "a stream never seen before has lost nothing here"
    assert order.add(("new", "b9"), 500, 500, 0.0) == ("ready", [500])


def test_limits() -> None:
    order = streams(held=2, streams_max=1)
    order.add(KEY, 1, 1, 0.0)
    assert [order.add(KEY, seq, seq, 0.0)[0] for seq in (3, 4, 5)] == ["held", "held", "dropped"]
    assert order.add(("other", "b1"), 1, 1, 0.0) == ("refused", [])
    assert order.skip_before(("other", "b1"), 7, 0.0) == []
    assert len(order) == 1


@given(st.permutations(range(1, 12)), st.lists(st.integers(1, 11), max_size=10))
@settings(max_examples=200, deadline=None)
def test_any_order_with_repetitions_comes_out_once_in_order(
    order: list[int], again: list[int]
) -> None:
    one = streams()
    out: list[int] = []
    for seq in [*order, *again]:
        out += one.add(KEY, seq, seq, 0.0)[1]
    assert out == list(range(1, 12))
    assert one.lost == 0


@given(st.data())
@settings(max_examples=200, deadline=None)
def test_losses_with_pulls_lose_nothing(data: st.DataObject) -> None:
    """Some messages get lost, some are repeated; the spool answers now and then."""
    one = streams(held=3)
    total = 20
    out: list[int] = []
    spooled = 0
    while spooled < total:
        spooled += 1
        if data.draw(st.booleans()):
            out += one.add(KEY, spooled, spooled, 0.0)[1]
        if data.draw(st.integers(0, 3)) == 0:
            _, start = one.next_to_pull("lobby") or ("", 0)
            for seq in range(max(start, 1), spooled + 1):
                out += one.add(KEY, seq, seq, 0.0)[1]
    _, start = one.next_to_pull("lobby") or ("", 0)
    for seq in range(max(start, 1), spooled + 1):
        out += one.add(KEY, seq, seq, 0.0)[1]
    assert out == list(range(1, total + 1))


def test_what_a_spool_twice_does_not_have_is_nobody_s() -> None:
    """An invented seq would make all true ones below it duplicates."""
    order = streams(stored={KEY: 4})
    order.add(KEY, 50, 50, 0.0)
    order.note_answer(KEY, 5, [], more=False)
    assert order.give_up_gaps(100.0, 5.0, has_spool={"lobby"}) == []
    order.add(KEY, 6, 6, 1.0)  # put before the next answer: the spool has it
    order.note_answer(KEY, 5, [], more=False)
    assert order.unknown == 1
    assert order.add(KEY, 5, 5, 2.0) == ("ready", [5, 6])
    assert order.gaps == set()
    order.add(KEY, 60, 60, 3.0)
    for _ in range(2):
        order.note_answer(KEY, 7, [], more=False)
    assert order.gaps == set()


def test_a_spool_that_does_not_know_the_boot_says_nothing_about_what_is_held() -> None:
    order = streams(stored={KEY: 4})
    order.add(KEY, 7, 7, 0.0)
    for _ in range(2):
        order.note_answer(KEY, 5, [], more=False, knows=False)
    assert order.give_up_gaps(100.0, 5.0, has_spool={"lobby"}) == [7]


def test_a_gap_is_skipped_to_where_the_spool_goes_on() -> None:
    order = streams(held=1, stored={KEY: 4})
    order.add(KEY, 7, 7, 0.0)
    assert order.add(KEY, 6, 6, 0.0) == ("dropped", [])
    order.note_answer(KEY, 5, [6, 7], more=False)
    assert order.give_up_gaps(100.0, 5.0, has_spool={"lobby"}) == []
    assert order.next_to_pull("lobby") == ("b1", 6)
    order.note_answer(KEY, 2, [2, 3], more=True)  # not as far as the gap
    assert order.give_up_gaps(200.0, 5.0, has_spool={"lobby"}) == []


def test_what_was_said_of_one_gap_does_not_hold_for_the_next() -> None:
    order = streams(stored={KEY: 4})
    order.add(KEY, 7, 7, 0.0)
    order.note_answer(KEY, 5, [7], more=False)
    assert order.add(KEY, 5, 5, 0.0) == ("ready", [5])
    assert order.add(KEY, 6, 6, 0.0) == ("ready", [6, 7])
    order.add(KEY, 9, 9, 0.0)
    assert order.give_up_gaps(100.0, 5.0, has_spool={"lobby"}) == []


def test_a_seq_too_far_ahead_is_no_gap() -> None:
    order = streams(stored={KEY: 4})
    assert order.add(KEY, 2**62, 0, 0.0) == ("jump", [])
    assert order.add(KEY, 5 + JUMP_MAX, 0, 0.0) == ("held", [])
    assert streams().add(KEY, 2**62, 0, 0.0) == ("held", []), (
        "a stream never seen may begin anywhere"
    )


def test_of_many_boots_those_heard_last_are_followed() -> None:
    """Years of nightly reboots, and a camera that invents boots."""
    order = streams(boots_max=3)
    for night in range(1000):
        assert order.add(("lobby", f"b{night}"), 1, night, 0.0) == ("ready", [night])
        assert order.add(("hall", "b1"), night, night, 0.0)[0] == "ready"
    assert len(order) == 4
    assert order.next_to_pull("lobby") == ("b999", 2)
    assert len(order.take_forgotten()) == 997
    assert order.take_forgotten() == []
    for boot in ("b997", "b998", "b999"):
        assert order.add(("lobby", boot), 9, 9, 0.0)[0] == "held"
    assert order.add(("lobby", "new"), 1, 1, 0.0) == ("refused", []), "a gap is not forgotten"
    assert order.add(("hall", "b2"), 1, 1, 0.0)[0] == "ready"


def test_what_is_held_is_counted_by_camera() -> None:
    order = streams(held=2)
    assert [order.add(("lobby", f"b{n}"), 5, n, 0.0)[0] for n in range(3)] == [
        "held",
        "held",
        "dropped",
    ]
    assert order.add(("hall", "b1"), 5, 5, 0.0)[0] == "held"
    order.skip_before(("lobby", "b0"), 5, 0.0)
    assert order.add(("lobby", "b3"), 5, 5, 0.0)[0] == "held"


def test_of_very_many_cameras_those_heard_last_are_followed() -> None:
    """Names invented long ago keep no camera out."""
    order = streams(streams_max=3, stored={(f"name{n}", "b1"): 7 for n in range(10)})
    assert order.next_to_pull("name9") == ("b1", 8)
    assert order.next_to_pull("name0") is None
    assert order.add(KEY, 1, 1, 0.0) == ("ready", [1])
    assert len(order) == 3
    assert ("name7", "b1") in order.take_forgotten()
    assert order.add(("name8", "b1"), 9, 9, 0.0)[0] == "held"
    assert order.add(("x", "b1"), 1, 1, 0.0) == ("ready", [1])
    assert order.add(("y", "b1"), 1, 1, 0.0) == ("ready", [1])
    assert order.next_to_pull("name8") == ("b1", 8), "a gap is not forgotten"
