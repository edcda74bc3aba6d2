"""Scores of pairs of zones by a baseline; their accuracy at the threshold that suits it best."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from msgspec import Struct

from bench.baselines.crossings import Crossings
from camtopod.arrays import Floats
from camtopod.sim.scoring import TRANSIT_FLOOR_SECONDS
from camtopod.sim.truth import TrueLink, Truth

FALSE_KEPT = 3
"""Pairs kept of each network, as a multiple of its true links; at least `KEPT_MIN`."""
KEPT_MIN = 100
"""Least number of pairs that are kept of each network."""


class Findings(Struct):
    """Scores of pairs of zones (zones, zones), higher is surer, and transit times, seconds (or
    nan).
    """

    score: Floats
    transit: Floats


class Ranked(Struct):
    """The best pairs of one network by falling score, rounded: input for choosing a threshold."""

    walked: int
    """True links that at least one object took."""
    score: list[float]
    kind: list[int]
    """2: a true link that was walked; 1: a true link that was never walked; 0: no link."""
    error: list[float]
    """Relative error of the transit time of true links; -1 for others."""


class Tuned(Struct):
    """Figures of each network at one threshold."""

    threshold: float
    f1: Floats
    """F1 of the links, (networks,)."""
    precision: Floats
    recall: Floats
    error: Floats
    """Median relative error of the transit times, (networks,); nan without links."""


def rank(findings: Findings, traffic: Crossings, truth: Truth, all_pairs: bool = False) -> Ranked:
    """Compare findings with the ground truth; with ``all_pairs`` none is dropped.

    A ground truth without zones has camera pairs only: then each camera is a zone, and the
    direction with the higher score counts.
    """
    if not truth.zones:
        return _rank_pairs(findings, truth)

    # Zone of the baseline for each true zone, and the true links between them.
    index = {name: k for k, name in enumerate(traffic.zones)}
    by_camera = (
        {traffic.camera[k]: k for k in range(len(traffic.zones))}
        if len(traffic.zones) < len(truth.zones)
        else {}
    )
    cameras = {name: k for k, name in enumerate(truth.cameras)}
    place = {z.id: by_camera[cameras[z.camera]] if by_camera else index[z.id] for z in truth.zones}
    links: dict[tuple[int, int], TrueLink] = {}
    for link in sorted(truth.links, key=lambda link: link.transitions):
        if link.relation != "visible":
            links[place[link.from_], place[link.to]] = link
    walked = sum(link.transitions > 0 for link in links.values())

    # The best pairs by score.
    score = np.where(traffic.between & np.isfinite(findings.score), findings.score, -np.inf).ravel()
    count = len(score) if all_pairs else max(KEPT_MIN, FALSE_KEPT * len(links))
    order = np.argsort(-score, kind="stable")[:count]
    order = order[np.isfinite(score[order])]

    # Rate each.
    result = Ranked(walked, [], [], [])
    for pair in order:
        u, v = divmod(int(pair), len(traffic.zones))
        true = links.get((u, v))
        result.score.append(float(f"{score[pair]:.6g}"))
        result.kind.append(0 if true is None else 2 if true.transitions else 1)
        result.error.append(
            -1.0 if true is None else round(_error(float(findings.transit[u, v]), true), 4)
        )
    return result


def _rank_pairs(findings: Findings, truth: Truth) -> Ranked:
    true = {pair.cameras for pair in truth.pairs}
    score = np.where(np.isfinite(findings.score), findings.score, -np.inf)
    score = np.maximum(score, score.T)
    names = truth.cameras
    pairs = [
        (score[u, v], tuple(sorted((names[u], names[v]))))
        for u, v in zip(*np.triu_indices(len(names), 1), strict=True)
    ]
    pairs = sorted((pair for pair in pairs if np.isfinite(pair[0])), key=lambda pair: -pair[0])
    scores = [float(f"{surest:.6g}") for surest, _ in pairs]
    return Ranked(
        len(true), scores, [2 * (cameras in true) for _, cameras in pairs], [-1.0] * len(pairs)
    )


def _error(seconds: float, true: TrueLink) -> float:
    """Return the relative error to the true mode or median, whichever is nearer (-1: unknown)."""
    if not np.isfinite(seconds):
        return -1.0
    figures = (true.transit.mode, true.transit.q50)
    return min(
        abs(seconds - figure) / max(abs(figure), TRANSIT_FLOOR_SECONDS) for figure in figures
    )


def at(networks: Sequence[Ranked], threshold: float) -> Tuned:
    """Return the figures if every pair scored at least ``threshold`` is a link."""
    figures = [_at(network, threshold) for network in networks]
    f1, precision, recall, error = (np.array(column) for column in zip(*figures, strict=True))
    return Tuned(threshold, f1, precision, recall, error)


def tune(networks: Sequence[Ranked]) -> Tuned:
    """Return the figures at the threshold with the best mean F1 over the networks.

    It is above all scores if there is nothing to find.
    """
    scores = np.unique(
        np.concatenate([np.array(network.score) for network in networks] or [np.zeros(0)])
    )
    curves = [_curve(network, scores) for network in networks]
    if not len(scores) or not curves:
        return at(networks, np.inf)
    mean = np.mean(curves, axis=0)
    best = int(np.argmax(mean))
    if mean[best] <= float(np.mean([_at(network, np.inf)[0] for network in networks])):
        return at(networks, np.inf)
    return at(networks, float(scores[best]))


def _curve(network: Ranked, thresholds: Floats) -> Floats:
    """Return F1 at each of the rising thresholds."""
    score, kind = -np.array(network.score), np.array(network.kind)
    count = np.searchsorted(score, -thresholds, side="right")
    hits = np.concatenate(([0], np.cumsum(kind == 2)))[count]
    right = np.concatenate(([0], np.cumsum(kind > 0)))[count]
    precision = np.where(count > 0, right / np.maximum(count, 1), 1.0)
    recall = hits / network.walked if network.walked else np.ones(len(count))
    return 2 * precision * recall / np.maximum(precision + recall, 1e-12)


def _at(network: Ranked, threshold: float) -> tuple[float, float, float, float]:
    selection = np.array(network.score) >= threshold
    kind = np.array(network.kind)[selection]
    precision = float((kind > 0).mean()) if len(kind) else 1.0
    recall = float((kind == 2).sum()) / network.walked if network.walked else 1.0
    error = np.array(network.error)[selection]
    error = error[error >= 0]
    f1 = 2 * precision * recall / (precision + recall) if precision + recall else 0.0
    return f1, precision, recall, float(np.median(error)) if len(error) else float("nan")
