"""The baselines of `bench` on small cases with known answers."""

from __future__ import annotations

import math

import msgspec
import numpy as np
import pytest

from bench.baselines.anonymous import anonymous, fit
from bench.baselines.closest import LITERAL, closest
from bench.baselines.correlation import correlation
from bench.baselines.crossings import NARROW, WIDE, Crossings, candidates, crossings, lag_counts
from bench.baselines.findings import Findings, Ranked, at, rank, tune
from bench.baselines.hawkes import hawkes
from bench.baselines.information import information
from bench.baselines.told import oracle_predictions, oracle_score, transit_error
from bench.baselines.transfer import by_delay, transfer
from bench.baselines.zoning import methods
from bench.support.measure import by_range
from camtopod.records import Event, Pair, Transit
from camtopod.sim.scoring import score_predictions
from camtopod.sim.truth import CLUTTER, TRUTH_SCHEMA, TrueLink, TrueZone, Truth

SECONDS = 20_000.0
FIRST, SECOND = 12.0, 30.0
"""Transit times a -> b -> c of `chain`, seconds."""


def chain(share: float = 0.8) -> Crossings:
    """Simulate transitions a -> b -> c beside independent traffic at d.

    A share of the objects that leave a comes to b, leaves there at once and comes to c. Zones a, b,
    c, d are of four cameras.
    """
    rng = np.random.default_rng(5)
    a = np.sort(rng.uniform(0, SECONDS, 400))
    b = a[rng.random(400) < share] + FIRST
    b = b + rng.normal(0, 1, len(b))
    c = b + SECOND + rng.normal(0, 1, len(b))
    d = np.sort(rng.uniform(0, SECONDS, 800))
    left = np.concatenate([a, b + 0.5, d[:400]])
    left_zone = np.repeat([0, 1, 3], [len(a), len(b), 400])
    came = np.concatenate([b, c, d[400:], rng.uniform(0, SECONDS, 200)])
    came_zone = np.concatenate(
        [np.repeat([1, 2, 3], [len(b), len(c), 400]), rng.integers(1, 4, 200)]
    )
    p, q = np.argsort(left), np.argsort(came)
    return Crossings(
        ["a", "b", "c", "d"], np.arange(4), left[p], left_zone[p], came[q], came_zone[q]
    )


CHAIN = chain()
FOUND = candidates(CHAIN)


def two_zones(left: list[float], left_zone: list[int], came: list[float]) -> Crossings:
    """Return two zones of two cameras with all arrivals at the second."""
    zones = np.ones(len(came), np.int64)
    return Crossings(
        ["a", "b"], np.array([0, 1]), np.array(left), np.array(left_zone), np.array(came), zones
    )


def test_candidates_are_all_pairs_of_two_cameras_within_the_lags() -> None:
    seen = two_zones([0.0, 50.0], [0, 1], [31.0])
    found = candidates(seen)
    assert [*found.lag] == [31.0]
    assert [*found.pair] == [0 * 2 + 1]
    naive = [
        (i, j)
        for j in range(len(CHAIN.came))
        for i in range(len(CHAIN.left))
        if NARROW.low <= CHAIN.came[j] - CHAIN.left[i] <= NARROW.high
        and CHAIN.left_zone[i] != CHAIN.came_zone[j]
    ]
    assert [*zip(FOUND.departure.tolist(), FOUND.arrival.tolist(), strict=True)] == naive
    few = candidates(CHAIN, 100)
    assert 0 < len(few.arrival) <= 100
    assert few.arrival[-1] == FOUND.arrival[-1]


def test_lag_counts_by_hand() -> None:
    seen = two_zones([0.0, 1.0], [0, 0], [10.5])
    counts, centres = lag_counts(seen, candidates(seen), 2.0)
    assert counts.sum() == 2
    assert counts[0, 1, 14] == counts[0, 1, 15] == 1  # 9.5 s in [8, 10), 10.5 s in [10, 12)
    assert centres[15] == 11.0


def best(findings: dict[str, Findings], variant: str) -> list[tuple[int, int]]:
    """Return the two pairs of zones with the highest score."""
    score = np.where(CHAIN.between, findings[variant].score, -np.inf)
    return sorted(divmod(int(k), 4) for k in np.argsort(-score, axis=None)[:2])


@pytest.mark.parametrize(
    ("findings", "variant"),
    [
        (anonymous(CHAIN), "probability"),
        (anonymous(CHAIN), "over noise"),
        (hawkes(CHAIN, FOUND), "per departure"),
        (hawkes(CHAIN, FOUND), "likelihood"),
    ],
)
def test_joint_methods_find_the_links_and_not_the_indirect_one(
    findings: dict[str, Findings], variant: str
) -> None:
    assert best(findings, variant) == [(0, 1), (1, 2)]
    transit = findings[variant].transit
    assert transit[0, 1] == pytest.approx(FIRST, abs=4)
    assert transit[1, 2] == pytest.approx(SECOND, abs=5)


@pytest.mark.parametrize(
    ("findings", "variant"),
    [
        (correlation(CHAIN, FOUND), "2 s bins"),
        (information(CHAIN, FOUND), "in total"),
        (transfer(CHAIN), "peak, 4 s bins"),
    ],
)
def test_pairwise_methods_find_the_links_and_their_times(
    findings: dict[str, Findings], variant: str
) -> None:
    result = findings[variant]
    unrelated = [
        result.score[u, v]
        for u, v in ((0, 3), (3, 1), (2, 3), (3, 2))
        if np.isfinite(result.score[u, v])
    ]
    assert min(result.score[0, 1], result.score[1, 2]) > 1.5 * max(unrelated)
    assert result.transit[0, 1] == pytest.approx(FIRST, abs=2.5)
    assert result.transit[1, 2] == pytest.approx(SECOND, abs=2.5)


def test_a_long_way_is_found_in_the_wide_range_only() -> None:
    """The transit time is 150 s, or -60 s: b's view is entered a minute before a's is left."""
    for seconds in (150.0, -60.0):
        rng = np.random.default_rng(7)
        left = np.sort(rng.uniform(0, SECONDS, 300))
        came = np.sort(
            np.concatenate(
                [left[:240] + seconds + rng.normal(0, 1, 240), rng.uniform(0, SECONDS, 60)]
            )
        )
        seen = two_zones(left.tolist(), [0] * 300, came.tolist())
        found = [candidates(seen, lags=lags) for lags in (NARROW, WIDE)]
        for method in (correlation, information, hawkes, transfer, anonymous):
            times = {
                variant: result.transit[0, 1]
                for variant, result in by_range(method, seen, found).items()
            }
            wide = [time for variant, time in times.items() if variant.endswith("-120..180 s")]
            narrow = [time for variant, time in times.items() if variant.endswith("-20..120 s")]
            assert len(wide) == len(narrow) > 0
            assert wide == pytest.approx([seconds] * len(wide), abs=15)
            assert all(abs(time - seconds) > 15 for time in narrow)


def test_the_thesis_test_as_printed_accepts_everything() -> None:
    findings = closest(CHAIN)
    possible = np.isfinite(findings[LITERAL].score)
    assert possible.sum() == 7  # nobody leaves c, nobody comes to a
    assert (findings[LITERAL].score[possible] >= -1).all()
    fair = findings["closest, null model"]
    assert fair.score[0, 1] > fair.score[3, 1]
    assert fair.transit[0, 1] == pytest.approx(FIRST, abs=3)


def test_transfer_entropy_equals_the_naive_sum() -> None:
    seen = two_zones([1.0, 9.0, 21.0, 33.0, 50.0], [0] * 5, [3.0, 5.0, 11.0, 23.0, 35.0, 70.0])
    entropy, delays = by_delay(seen, 2.0)
    bins = int((70.0 - 1.0) / 2.0) + 2
    x, y = np.zeros(bins, int), np.zeros(bins, int)
    x[((seen.left - 1.0) / 2.0).astype(int)] = 1
    y[((seen.came - 1.0) / 2.0).astype(int)] = 1
    for delay in (1, 2, 5):
        triples = [
            (y[t], y[t - 1] if t else 0, x[t - delay] if t >= delay else 0) for t in range(bins)
        ]
        bits = 0.0
        for now, before, cause in set(triples):
            joint = triples.count((now, before, cause))
            given = sum(b == before and c == cause for _, b, c in triples)
            alone = sum(n == now and b == before for n, b, _ in triples) / sum(
                b == before for _, b, _ in triples
            )
            bits += joint / bins * math.log2(joint / given / alone)
        assert entropy[[*delays].index(2.0 * delay), 0, 1] == pytest.approx(bits, abs=1e-12)


def test_least_squares_recover_a_chain_of_counts() -> None:
    rng = np.random.default_rng(1)
    left = rng.poisson(2.0, (4000, 2)).astype(float)
    came = rng.poisson(1.0, (4000, 2)).astype(float)
    came[3:, 1] += rng.binomial(left[:-3, 0].astype(int), 0.5)
    rate = fit(
        left - left.mean(0),
        came - came.mean(0),
        np.arange(6),
        np.array([[False, True], [True, False]]),
    )
    share = rate.sum(axis=0)
    assert rate.argmax(axis=0)[0, 1] == 3
    assert share[0, 1] == pytest.approx(
        0.25, abs=0.05
    )  # half of it: the ridge doubles the diagonal
    assert share[1, 0] < 0.05
    assert share[0, 0] == 0


def network(threshold: list[float], kind: list[int], walked: int) -> Ranked:
    return Ranked(walked, threshold, kind, [0.1 * (k > 0) - (k == 0) for k in kind])


def test_thresholds_are_chosen_for_the_best_mean() -> None:
    one = network([5.0, 4.0, 3.0, 2.0], [2, 2, 0, 2], 3)
    tuned = tune([one])
    assert (
        tuned.threshold == 2.0
    )  # 3 of 4 right and all found: 6/7; at 4.0, 2 of 2 right and 2 of 3 found: 4/5
    assert tuned.f1[0] == pytest.approx(6 / 7)
    assert at([one], 4.0).f1[0] == pytest.approx(4 / 5)
    assert at([one], 4.0).error[0] == pytest.approx(0.1)
    nobody = at([one], 9.0)
    assert (nobody.precision[0], nobody.recall[0], nobody.f1[0]) == (1, 0, 0)
    other = network([4.5, 3.5, 3.4], [2, 0, 0], 1)
    assert tune([one, other]).threshold == 4.0
    control = network([4.5, 3.5], [0, 0], 0)
    assert tune([control]).threshold == math.inf
    assert tune([control]).f1[0] == 1


def small_truth(placed: bool = True) -> Truth:
    place = (0.2, 0.8) if placed else (None, None)
    zones = [TrueZone(f"{c}/{k}", c, place[0], place[1]) for c in "ab" for k in (1, 2)]
    transit = Transit(10, 11, 1, 9, 10.5, 12)
    links = [
        TrueLink("a/1", "b/1", "unseen", 0.5, 3, transit),
        TrueLink("a/2", "b/2", "unseen", 0.5, 0, transit),
        TrueLink("a/1", "a/2", "visible", 0.5, 3, transit),
    ]
    return Truth(
        TRUTH_SCHEMA, ["a", "b"], zones, links, [], {}, [1, 1, -1, 2], [0, 0, -1, 0], [0, 0, -1, 3]
    )


EVENTS = [
    Event("a", "entry", 1.0),
    Event("a", "exit", 2.0),
    Event("b", "exit", 2.5),
    Event("b", "entry", 3.0),
]


def test_crossings_leave_out_clutter_and_know_the_true_zones() -> None:
    seen = crossings(EVENTS, small_truth())
    assert seen.zones == ["a/1", "a/2", "b/1", "b/2"]
    assert (seen.left.tolist(), seen.left_zone.tolist()) == ([2.0], [0])
    assert (seen.came.tolist(), seen.came_zone.tolist()) == ([1.0, 3.0], [0, 3])
    whole = crossings(EVENTS, small_truth(placed=False))
    assert whole.camera.tolist() == [0, 1]
    assert whole.came_zone.tolist() == [0, 1]


def test_ranks_tell_walked_links_from_those_nobody_walked() -> None:
    score, transit = np.zeros((4, 4)), np.full((4, 4), 12.0)
    score[0, 2], score[1, 3], score[0, 3], score[0, 1] = 9.0, 8.0, 7.0, 99.0
    ranked = rank(Findings(score, transit), crossings(EVENTS, small_truth()), small_truth())
    assert ranked.walked == 1
    assert ranked.kind[:3] == [2, 1, 0]  # the pair within one camera is out of the question
    assert ranked.error[0] == pytest.approx(
        1.5 / 10.5, abs=1e-4
    )  # the median is nearer than the mode
    whole = small_truth(placed=False)
    of_cameras = Findings(np.array([[50.0, 1.0], [2.0, 50.0]]), np.full((2, 2), 12.0))
    assert rank(of_cameras, crossings(EVENTS, whole), whole).kind == [0, 2]


def test_without_true_zones_a_camera_is_one_and_the_surer_direction_counts() -> None:
    truth = msgspec.structs.replace(
        small_truth(),
        cameras=["a", "b", "c"],
        zones=[],
        links=[],
        zone=[-1] * 4,
        pairs=[Pair(("a", "b"), "unseen_path")],
    )
    seen = crossings(EVENTS, truth)
    assert seen.zones == ["a", "b", "c"]
    assert (seen.left_zone.tolist(), seen.came_zone.tolist()) == (
        [0],
        [0, 1],
    )  # the third belongs to nobody
    score = np.array([[99.0, 1.0, np.nan], [5.0, 99.0, 4.0], [3.0, -np.inf, 99.0]])
    ranked = rank(Findings(score, np.zeros((3, 3))), seen, truth)
    assert (ranked.walked, ranked.score, ranked.kind) == (1, [5.0, 4.0, 3.0], [2, 0, 0])
    assert math.isnan(at([ranked], 5.0).error[0])
    assert at([ranked], 5.0).f1[0] == 1


@pytest.mark.parametrize("method", ["k-means", "HDBSCAN", "mean shift", "plain DaSpec"])
def test_clusterings_find_three_doors(method: str) -> None:
    rng = np.random.default_rng(2)
    doors = np.array([[0.2, 0.2], [0.8, 0.3], [0.5, 0.8]])
    positions = np.repeat(doors, 150, axis=0) + 0.02 * rng.standard_normal((450, 2))
    centres = [cluster(positions) for cluster in methods()[method].values()]
    right = [c for c in centres if len(c) == 3]
    assert right
    distance = np.linalg.norm(right[0][:, None] - doors[None], axis=2)
    assert distance.min(axis=0).max() < 0.03


def told_case() -> tuple[list[Event], Truth]:
    """Return three people that go from a to b, one that leaves at a, and later exits to predict."""
    events, who, number = [], [], []
    for person, goes in enumerate((True, True, True, False)):
        t = 100.0 * person
        way = [("a", "exit", t, 0), *([("b", "entry", t + 5, 1)] if goes else [])]
        events += [Event(camera, kind, at_) for camera, kind, at_, _ in way]
        who += [person] * len(way)
        number += [n for *_, n in way]
    events += [Event("a", "exit", 900.0), Event("b", "exit", 901.0)]
    return events, Truth(
        TRUTH_SCHEMA, ["a", "b"], [], [], [], {}, [*who, 8, 9], [*number, 0, 0], [-1] * len(events)
    )


def test_the_told_chain_counts_with_a_part_of_a_count_for_everything() -> None:
    events, truth = told_case()
    cut = len(events) - 2
    here, elsewhere = oracle_predictions(
        events, truth, cut, [event.camera for event in events], 0.5
    )
    assert here.leave == pytest.approx((1 + 0.5) / (4 + 1.0))
    assert [(c.camera, c.probability) for c in here.next_] == [("b", pytest.approx(3.5 / 5.0))]
    assert elsewhere.leave == here.leave  # nothing was ever seen to leave b: as all together


def test_the_told_chain_is_smoothed_as_suits_it_best() -> None:
    """Among 20 states with one exit each, the next exits repeat or contradict the known ones.

    The smallest pseudo-count is best in the first case, the largest in the second.
    """
    for same, best in ((True, 0.02), (False, 0.5)):
        events, who, number = [], [], []
        for person in range(40):
            there = person if same or person < 20 else person + 7
            events += [
                Event("a", "exit", 100.0 * person),
                Event(f"b{there % 20}", "entry", 100.0 * person + 5),
            ]
            who, number = [*who, person, person], [*number, 0, 1]
        truth = Truth(TRUTH_SCHEMA, ["a"], [], [], [], {}, who, number, [-1] * len(events))
        states = [person % 20 for person in who]
        expected = score_predictions(
            oracle_predictions(events, truth, 40, states, best), events[40:], tail_of(truth, 40)
        )
        assert oracle_score(events, truth, 40, states) == expected


def tail_of(truth: Truth, cut: int) -> Truth:
    return msgspec.structs.replace(
        truth, identity=truth.identity[cut:], passage=truth.passage[cut:], zone=truth.zone[cut:]
    )


def test_the_told_transit_error_is_that_of_the_recorded_median() -> None:
    events, who, number, zone = [], [], [], []
    for person, seconds in enumerate((10.0, 12.0, 20.0)):
        t = 100.0 * person
        events += [Event("a", "exit", t), Event("b", "entry", t + seconds)]
        who, number, zone = [*who, person, person], [*number, 0, 1], [*zone, 0, 2]
    events.append(Event("b", "entry", 999.0))
    truth = msgspec.structs.replace(
        small_truth(), identity=[*who, CLUTTER], passage=[*number, CLUTTER], zone=[*zone, CLUTTER]
    )
    assert transit_error(events, truth) == pytest.approx((12 - 10.5) / 10.5)
    assert math.isnan(transit_error(events, msgspec.structs.replace(truth, links=[])))
