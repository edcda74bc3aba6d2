"""Weak links: the evidence they lack, and forecasts of their publication."""

from __future__ import annotations

import numpy as np
import pytest

from camtopod.learn.learner import Learner
from camtopod.learn.links.link_table import LinkTable
from camtopod.learn.links.publishing import LinkShortfall, PublishingRule
from camtopod.learn.links.significance import q_values, ratio_needed
from camtopod.learn.links.transit_time import TransitFigures
from camtopod.learn.settings import Settings
from camtopod.records import Topology
from camtopod.sim.simulation import SimSettings, simulate
from camtopod.topology import weak_links

SETTINGS = Settings()
HOUR = 3600.0


def table(*rows: tuple[int, int, float, float, float]) -> LinkTable:
    """Return pairs (source, target, transitions, evidence in nats, probability)."""
    source, target, total, ratio, probability = (
        np.array(column) for column in zip(*rows, strict=True)
    )
    n, nothing = len(rows), np.zeros(len(rows))
    transit = TransitFigures(
        *[np.zeros((n, 3)) if name == "quantiles" else nothing for name in TransitFigures._fields]
    )
    transit = transit._replace(total=total)
    return LinkTable(
        source,
        target,
        probability,
        ratio,
        np.ones(n),
        transit,
        nothing,
        np.zeros((n, 0)),
        np.zeros(n),
        np.ones(n),
    )


def of(
    *rows: tuple[int, int, float, float, float], held_out: float | None = None, published: int = 0
) -> LinkShortfall:
    between = table(
        (7, 7, 1.0, 0.0, 1.0), *[] if held_out is None else [(*rows[0][:3], held_out, 0.5)]
    )
    return PublishingRule(SETTINGS).shortfall(table(*rows), between, published, 10, HOUR)


@pytest.mark.parametrize("rank", [1, 2, 5])
def test_the_evidence_needed_is_that_at_which_the_rule_is_met(rank: int) -> None:
    needed = ratio_needed(rank, 400, 0.01)
    clearer = [40.0] * (rank - 1)
    assert q_values(np.array([*clearer, needed + 1e-9]), 400)[-1] <= 0.01
    assert q_values(np.array([*clearer, needed - 1e-3]), 400)[-1] > 0.01


def test_a_passage_brings_as_much_as_those_so_far() -> None:
    """Ten passages have brought 20 nats, 3 of them for both kinds of evidence.

    The rest comes at half of 2 nats a passage.
    """
    found = of((0, 1, 10.0, 20.0, 0.5), held_out=3.0)
    assert found.passages == pytest.approx([np.log(100 / 0.01) - 3.0])
    assert found.seconds == pytest.approx(found.passages * HOUR / 10.0)


@pytest.mark.parametrize(
    "row", [(0, 1, 10.0, 20.0, 0.02), (0, 1, 10.0, 0.0, 0.5), (0, 1, 10.0, -1.0, 0.5)]
)
def test_where_waiting_does_not_help_nothing_is_said(
    row: tuple[int, int, float, float, float],
) -> None:
    found = of(row)
    assert np.isnan(found.passages).all()
    assert np.isnan(found.seconds).all()


def test_what_is_forecast_is_published_about_then() -> None:
    """Half of the forecasts are right within a factor of 2, and most come true."""
    learner, versions = Learner(Settings(refit_share=0.3)), list[Topology]()
    for event in simulate(SimSettings(cameras=6, hours=2.0, seed=5, objects_per_second=0.05))[0]:
        learner.receive(event)
        versions += learner.updates()
    published: dict[tuple[str, str], float] = {}
    forecast: dict[tuple[str, str], tuple[float, float]] = {}
    for version in versions:
        for link in version.links:
            published.setdefault((link.from_, link.to), version.as_of)
        for link in weak_links(version):
            if link.lacks is not None and link.q_value < 0.05 and link.transitions > 5:
                forecast.setdefault((link.from_, link.to), (version.as_of, link.lacks.seconds))
    due = {key: said for key, said in forecast.items() if sum(said) <= versions[-1].as_of}
    came = [key for key in due if key in published]
    ratio = [(published[key] - due[key][0]) / due[key][1] for key in came]
    assert len(due) >= 12
    assert len(came) >= 0.8 * len(due)
    assert 0.5 <= np.median(ratio) <= 2.0
