"""Reproduce the thesis's own figures, tables 5.1 to 5.4 and figure 4.4.

python -m bench thesis [SEEDS]
"""

from __future__ import annotations

import time
import warnings

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv

from bench.support import thesis_tables as thesis
from bench.support.figures import line_of
from bench.support.overlap_rows import overlap_rows
from camtopod.arrays import Floats
from camtopod.learn.zones.cells import cell_sums, fixed_point
from camtopod.learn.zones.daspec import bandwidth, data_spectroscopy
from camtopod.learn.zones.zone_map import find_zones

HDBSCAN_SHARE_MIN = 0.02
"""Least share of a camera's events in a zone of HDBSCAN."""


def main(argv: list[str]) -> int:
    """Print all figures; return 0 if they are as printed in the thesis."""
    seeds = int(argv[0]) if argv else 20
    good = [table_5_1(), table_5_3(), table_5_4(), figure_4_4(seeds)]
    return 0 if all(good) else 1


def table_5_1() -> bool:
    """Cluster table 5.1; return True if there are two zones, as printed."""
    table = np.array(thesis.TABLE_5_1)
    points, zones = table[:, :2], table[:, 2]
    grid = np.zeros((30, 24), dtype=np.int64)
    np.add.at(grid, tuple(points.T), 1)
    width = bandwidth(grid)
    spectrum = data_spectroscopy(grid, width)
    cells = np.ravel_multi_index(tuple(points.T), grid.shape)
    labels = spectrum.labels[np.searchsorted(spectrum.cells, cells)]
    pairs = set(zip(labels.tolist(), zones.tolist(), strict=True))
    good = spectrum.groups == 2 and len(pairs) == 2
    authors = authors_bandwidth(points.astype(np.float64))
    print(
        f"table 5.1: bandwidth {width:.2f} grid steps: {spectrum.groups} zones, as printed: {good}"
    )
    split = data_spectroscopy(grid, authors).groups
    print(f"           the authors' bandwidth rule gives {authors:.2f} and {split} zones")
    return good


def authors_bandwidth(points: Floats) -> float:
    """Return the authors' bandwidth ``Q95_i(Q05_j |x_i - x_j|) / sqrt(chi2_{0.95, d})``.

    points (n, d): positions, in the unit of the result.

    For points that repeat on a grid it is too small (0.63 for those of table 5.1, zero if most
    repeat), and with clutter far too large.
    """
    distances = np.sqrt(((points[:, None, :] - points[None, :, :]) ** 2).sum(axis=2))
    near = np.quantile(distances, 0.05, axis=1)
    return float(np.quantile(near, 0.95) / np.sqrt(2 * gammaincinv(points.shape[1] / 2, 0.95)))


def table_5_3() -> bool:
    """Compute table 5.3 from table 5.2; return True if it is as printed."""
    rows = overlap_rows(thesis.TABLE_5_2, thesis.TABLE_5_2_CAMERAS, 0.200)
    computed = [
        (
            r.camera_ab,
            r.camera_c,
            r.a + 1,
            r.b + 1,
            r.c + 1,
            r.transit_ac,
            r.transit_cb,
            r.transit_ab,
        )
        for r in rows
    ]
    print(
        f"table 5.3 from table 5.2 with T = 0.200: {len(rows)} rows, "
        f"as printed: {computed == thesis.TABLE_5_3}"
    )
    for row, overlap in zip(computed, rows, strict=True):
        print("          ", *row, f"  |AB - (AC + CB)| = {overlap.error:.3f}")
    return computed == thesis.TABLE_5_3


def table_5_4() -> bool:
    """Check each row of table 5.4; return True if all but the last hold.

    The last row contradicts its own text.
    """
    print("table 5.4 with T = 0.450:")
    holds = []
    for row in thesis.TABLE_5_4:
        rows = overlap_rows(thesis.table_5_4_transit(row), thesis.TABLE_5_4_CAMERAS, 0.450)
        holds.append(
            row[:5] in [(r.camera_ab, r.camera_c, r.a + 1, r.b + 1, r.c + 1) for r in rows]
        )
        error = abs(row[7] - (row[5] + row[6]))
        print(
            "          ",
            *row,
            f"  |AB - (AC + CB)| = {error:.3f}",
            "holds" if holds[-1] else "contradicts its text",
        )
    print(f"           {sum(holds)} of {len(holds)} rows hold")
    return holds == [True] * 8 + [False]


def figure_4_4(seeds: int) -> bool:
    """Find the zones of simulations after figure 4.4; return True if all are right."""
    print(f"figure 4.4: 5 cameras, 13 zones, 3,000 agents at differing speeds, {seeds} seeds;")
    print("           share of networks with all 13 zones, and of cameras with the right number")
    good = True
    for clutter in (0.0, 0.1):
        shares: dict[str, list[list[bool]]] = {}
        seconds = 0.0
        for seed in range(seeds):
            right: dict[str, list[bool]] = {}
            for place, truth in zip(*thesis.figure_4_4(seed, clutter), strict=True):
                sums = cell_sums(*fixed_point(place.T))
                start = time.perf_counter()
                zone_count = len(find_zones(sums).zones)
                seconds += time.perf_counter() - start
                k = int(truth.max()) + 1
                right.setdefault("camtopod", []).append(zone_count == k)
                plain = data_spectroscopy(sums[0], bandwidth(sums[0])).groups
                right.setdefault("plain DaSpec", []).append(plain == k)
                right.setdefault("HDBSCAN", []).append(hdbscan_zones(place) == k)
                for name, value in k_means(place, truth).items():
                    right.setdefault(name, []).append(value)
            for name, values in right.items():
                shares.setdefault(name, []).append(values)
        print(f"  clutter {clutter:.0%} ({1e3 * seconds / seeds / 5:.1f} ms a camera)")
        for name, networks in shares.items():
            whole = np.mean([all(values) for values in networks])
            print(f"    {name:34s} networks {whole:.2f}, cameras {np.mean(networks):.2f}")
            print(line_of(f"clutter {clutter:.0%}, {name}", float(whole) * seeds))
        good &= all(all(values) for values in shares["camtopod"])
    return good


def hdbscan_zones(place: Floats) -> int:
    """Return the number of zones that HDBSCAN finds, each of 2 % of the events or more."""
    from sklearn.cluster import HDBSCAN

    least = max(int(HDBSCAN_SHARE_MIN * len(place)), 2)
    labels = HDBSCAN(min_cluster_size=least, copy=True).fit_predict(place)
    return int(labels.max()) + 1


def k_means(place: Floats, truth: NDArray[np.intp]) -> dict[str, bool]:
    """Return whether k-means finds the zones of a camera, in two variants.

    With k chosen by silhouette: whether k is right. With the true k: whether its clusters are the
    zones (95 % of each in one cluster, no two in the same).
    """
    from sklearn.cluster import KMeans
    from sklearn.metrics import silhouette_score

    rng = np.random.default_rng(0)
    indices = rng.choice(len(place), min(400, len(place)), replace=False)
    sample, truth = place[indices], truth[indices]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        labels = {k: KMeans(k, n_init=1, random_state=0).fit_predict(sample) for k in range(2, 8)}
        picked = max(labels, key=lambda k: silhouette_score(sample, labels[k]))
    k = int(truth.max()) + 1
    pure = all(
        np.bincount(labels[k][truth == zone]).max() >= 0.95 * (truth == zone).sum()
        for zone in range(k)
    )
    distinct = len({int(np.bincount(labels[k][truth == zone]).argmax()) for zone in range(k)}) == k
    return {
        "k-means, k by silhouette": picked == k,
        "k-means told k: clusters are zones": pure and distinct,
    }
