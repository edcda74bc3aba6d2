"""The baselines of `bench` on small cases with known answers."""

from __future__ import annotations

import numpy as np
import pytest

from bench.baselines.anonymous import anonymous
from bench.baselines.area_occupancy import AreaOccupancy
from bench.baselines.correlation import correlation
from bench.baselines.crossings import Crossings, candidates
from bench.baselines.findings import Findings, Ranked, at, tune
from bench.baselines.hawkes import hawkes
from bench.baselines.information import information
from bench.baselines.oracle import oracle_predictions
from bench.baselines.process_mining import mined_links
from bench.baselines.transfer import transfer
from bench.baselines.zoning import methods
from bench.support.recordings import Passage
from camtopod.records import Event
from camtopod.sim.truth import TRUTH_SCHEMA, Truth

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


def test_a_threshold_is_chosen_for_the_best_mean() -> None:
    ranked = Ranked(3, [5.0, 4.0, 3.0, 2.0], [2, 2, 0, 2], [0.1, 0.1, -1.0, 0.1])

    tuned = tune([ranked])

    assert tuned.threshold == 2.0
    assert tuned.f1[0] == pytest.approx(6 / 7), "3 of 4 right and all found"
    assert at([ranked], 4.0).f1[0] == pytest.approx(4 / 5), "2 of 2 right and 2 of 3 found"


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
    assert [(c.camera, c.probability) for c in here.next] == [("b", pytest.approx(3.5 / 5.0))]
    assert elsewhere.leave == here.leave  # nothing was ever seen to leave b: as all together


def test_the_rule_of_home_automation_counts_who_is_next_within_a_minute() -> None:
    events = []
    for k in range(30):
        t = 1e6 + 1000.0 * k
        for camera, later in (("a", 0.0), ("b", 20.0), ("c", 200.0)):
            events += [
                Event(camera, "entry", t + later, track=k),
                Event(camera, "exit", t + later + 5.0, track=k),
            ]
    every = {(x, y) for x in "abc" for y in "abc" if x != y}
    rule, apart = AreaOccupancy(every), AreaOccupancy(every - {("a", "b")})
    rule.learn(events, until=1e6 + 30_000.0)
    apart.learn(events, until=1e6 + 30_000.0)

    last = 1e6 + 29_000.0 + 5.0
    assert rule.guess("a", last, ["a", "b", "c"])["b"] > 0.99
    assert rule.guess("b", last + 20.0, ["a", "b", "c"]) == {"a": 0.5, "c": 0.5}  # too late
    assert apart.guess("a", last, ["a", "b", "c"]) == {"b": 0.5, "c": 0.5}


def test_the_rule_takes_the_area_before_into_account() -> None:
    events = []
    for k in range(120):
        t = 1e6 + 2000.0 * k
        first, last = ("a", "d") if k % 2 else ("b", "e")
        for camera, later in ((first, 0.0), ("c", 20.0), (last, 40.0)):
            events += [
                Event(camera, "entry", t + later, track=k),
                Event(camera, "exit", t + later + 5.0, track=k),
            ]
    rule = AreaOccupancy({("a", "c"), ("b", "c"), ("c", "d"), ("c", "e")})

    rule.learn(events, until=1e6 + 1e6)

    after_a = rule.guess("c", 1e6 + 2000.0 * 119 + 25.0, ["a", "b", "c", "d", "e"])
    after_b = rule.guess("c", 1e6 + 2000.0 * 118 + 25.0, ["a", "b", "c", "d", "e"])
    assert after_a["d"] > 0.95
    assert after_b["e"] > 0.95


@pytest.mark.campaign
def test_the_correlation_miner_finds_a_corridor() -> None:
    """It needs the extra ``[bench]``, which the other tests do without."""
    pytest.importorskip("pm4py")
    rng = np.random.default_rng(1)
    passages = []
    for k in range(200):
        t = 1000.0 * k
        passages.append(Passage(f"a{k}", "a", t, t + 5.0))
        t += 25.0 + rng.normal(0.0, 1.0)
        passages.append(Passage(f"b{k}", "b", t, t + 5.0))

    links = mined_links(passages)

    assert links["a", "b"] == pytest.approx(20.0, abs=1.0)
