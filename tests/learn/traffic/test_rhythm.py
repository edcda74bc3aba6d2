"""Rates of arrivals with the rhythm of their zone, against the definition and made-up platoons."""

from __future__ import annotations

import naive
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from camtopod.arrays import Floats
from camtopod.learn.traffic import local_rates
from camtopod.learn.traffic.rhythm import (
    ACTIVITY_SECONDS,
    PAST_AGES,
    PAST_SECONDS,
    _around,
    _own_past,
    _past_by_age,
    activity_rates,
    rhythm_rates,
)

RNG = np.random.default_rng(5)


def rates(*zones: Floats) -> tuple[Floats, Floats, Floats]:
    """Return the zone, the even rate and the rate with rhythm of all arrivals, by time."""
    t = np.concatenate(zones)
    zone = np.repeat(np.arange(len(zones)), [len(one) for one in zones]).astype(np.int32)
    order = np.argsort(t, kind="stable")
    even = local_rates(t[order], zone[order], len(zones))
    return zone[order], even, rhythm_rates(t[order], zone[order], even, len(zones))


@settings(max_examples=30)
@given(st.integers(0, 10**6), st.integers(0, 40))
def test_past_and_surroundings_equal_their_slow_twins(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0.0, 300.0, n).round())
    zone = rng.integers(0, 3, n).astype(np.int32)
    zones = int(zone.max(initial=0)) + 1
    around = naive.around(t, zone, ACTIVITY_SECONDS)
    assert _around(t, zone, zones) == pytest.approx(around, abs=1e-12)
    assert _own_past(t, zone, zones) == pytest.approx(
        naive.own_past(t, zone, PAST_SECONDS), abs=1e-12
    )
    slow = np.reshape(naive.past_by_age(t, zone, PAST_AGES), (len(PAST_AGES) - 1, n))
    assert _past_by_age(t, zone, zones) == pytest.approx(slow, abs=1e-12)


def test_arrivals_at_any_time_have_no_rhythm() -> None:
    _, even, rate = rates(np.sort(RNG.uniform(0.0, 7200.0, 700)), np.array([17.0]))
    assert (rate == even).all()
    _, even, rate = rates(np.zeros(0))
    assert len(rate) == 0


@pytest.mark.parametrize("period", [52.0, 90.0, 140.0])
def test_a_signal_is_a_rhythm_of_its_zone_alone(period: float) -> None:
    green = np.sort(period * RNG.integers(0, 40, 300) + RNG.uniform(0.0, 0.2 * period, 300))
    zone, even, rate = rates(green, np.sort(RNG.uniform(0.0, green[-1], 300)))
    assert (rate[zone == 1] == even[zone == 1]).all()
    ratio = (rate / even)[zone == 0]
    assert np.log(ratio).mean() > 0.4


def test_a_platoon_explains_all_but_its_beginning() -> None:
    begins = np.cumsum(RNG.exponential(600.0, 40))
    platoon = np.sort((begins[:, None] + RNG.uniform(0.0, 20.0, (40, 8))).ravel())
    _, even, rate = rates(platoon)
    first = np.diff(platoon, prepend=-np.inf) > 100.0
    assert (rate[first] < even[first]).mean() > 0.9
    assert np.median(rate[~first] / even[~first]) > 3.0


def test_a_batch_at_all_cameras_explains_itself_and_other_arrivals_do_not() -> None:
    """Batches fill the first three cameras; the fourth has arrivals at any time."""
    batches = np.cumsum(RNG.exponential(300.0, 30))
    t = [(batches[:, None] + RNG.uniform(0.0, 60.0, (30, 8))).ravel() for _ in range(3)]
    t.append(RNG.uniform(0.0, batches[-1], 240))
    zone = np.repeat(np.arange(4), 240).astype(np.int32)
    order = np.argsort(np.concatenate(t), kind="stable")
    came, zone = np.concatenate(t)[order], zone[order]
    even = local_rates(came, zone, 4)
    ratio = activity_rates(came, zone, zone, even) / even
    assert ratio.min() == 1.0
    assert np.median(ratio[zone < 3]) > 2.0
    assert np.median(ratio[zone == 3]) < 1.1
    assert len(activity_rates(came[:0], zone[:0], zone[:0], even[:0])) == 0


def test_behind_a_light_that_drifts_a_platoon_tells_of_the_next() -> None:
    """Its cycle has no fixed length, so that no phase is kept; other arrivals have no such past."""
    green = np.cumsum(RNG.uniform(70.0, 100.0, 120))
    t = [(green[:, None] + RNG.uniform(0.0, 15.0, (120, 5))).ravel()]
    t.append(RNG.uniform(0.0, green[-1], 600))
    zone = np.repeat(np.arange(2), 600).astype(np.int32)
    order = np.argsort(np.concatenate(t), kind="stable")
    came, zone = np.concatenate(t)[order], zone[order]
    even = local_rates(came, zone, 2)
    gain = np.log(activity_rates(came, zone, zone, even) / even)
    assert gain[zone == 0].mean() > 0.3
    assert gain[zone == 1].mean() < 0.05
