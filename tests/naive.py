"""Slow and obvious versions of fast functions, each by its definition. Arrays in, arrays out."""

import functools
import itertools
from functools import cache

import numpy as np
import scipy.signal
import scipy.special
from model_rows import rows_of

# --- daspec, zones (weighted grid cells against points) ---


def data_spectroscopy(points, bandwidth):
    """Cluster n points (n, 2) by DaSpec with the dense n x n kernel.

    Returns the kept eigenvalues and eigenvectors, and the label of each point.
    """
    n = len(points)
    squared = ((points[:, None, :] - points[None, :, :]) ** 2).sum(axis=2)
    values, vectors = np.linalg.eigh(np.exp(-squared / (2 * bandwidth**2)) / n)
    kept = []
    for j in reversed(range(n)):
        v = vectors[:, j]
        eps = np.abs(v).max() / n
        if values[j] > 0.5 / n and ((v > -eps).all() or (v < eps).all()):
            kept.append(j)
    labels = [int(np.argmax([abs(vectors[i, j]) for j in kept])) for i in range(n)]
    return values[kept], vectors[:, kept], np.array(labels)


def bandwidth_of_points(points):
    """Compute `camtopod.learn.zones.daspec.bandwidth` over points (n, 2) in grid steps."""
    wanted = max(0.05 * len(points), 5)
    radii = []
    for x in points:
        distances = sorted(np.hypot(*(points - x).T))
        radii.append(
            next((d for i, d in enumerate(distances, 1) if i >= wanted - 1e-9), distances[-1])
        )
    radii.sort()
    q95 = next(r for i, r in enumerate(radii, 1) if i / len(points) >= 0.95 - 1e-9)
    return max(q95 / np.sqrt(5.991464547107979), 0.75)


def log_marginal_likelihood(groups, freedom, scale):
    """Return the log marginal likelihood (...) of groups (6, ...) of events as one zone each.

    A Gaussian with a flat prior of its mean and an inverse Wishart prior of its covariance.
    """
    n, sx, sy = groups[:3]
    xx, xy, yy = groups[3:] - np.array((sx * sx, sx * sy, sy * sy)) / n
    n = np.maximum(n, 1.0)
    posterior = (freedom + n - 1) / 2
    return (
        scipy.special.multigammaln(posterior, 2)
        - scipy.special.multigammaln(freedom / 2, 2)
        + freedom * np.log(scale)
        - (n - 1) * np.log(np.pi)
        - np.log(n)
        - posterior * np.log((scale + xx) * (scale + yy) - xy * xy)
    )


def log_share(n, prior):
    """Return the term (...) of a zone with n events in the log prior of a partition."""
    return scipy.special.gammaln(n + prior) - scipy.special.gammaln(prior)


def clutter_rates(count, constants):
    """Compute `camtopod.learn.zones.clutter.clutter_rates` cell by cell, always in all rounds."""
    width, denser, alike, rounds = constants
    rows, columns = count.shape
    mean = float(np.mean(count))
    for _ in range(rounds):
        below = float(np.mean([n for n in count.ravel() if n <= mean + 3 * np.sqrt(mean) + 1]))
        if abs(below - mean) < 1e-6:
            break
        mean = below
    rate = np.full(count.shape, denser * mean)
    for _ in range(rounds):
        kept = count <= denser * rate + 3 * np.sqrt(rate) + 1
        around = rate.copy()
        for r in range(rows):
            for c in range(columns):
                far = (np.arange(rows)[:, None] - r) ** 2 + (np.arange(columns) - c) ** 2
                near = np.exp(-far / (2 * width**2)) * kept
                around[r, c] = ((near * count).sum() + alike) / (near.sum() + alike / mean)
        rate = np.minimum(rate, around)
    return rate


def dense_cells(count, rate, chance, contrast, width):
    """Compute `camtopod.learn.zones.clutter.dense_cells` cell by cell."""
    rows, columns = count.shape
    dense = np.zeros(count.shape)
    for r in range(rows):
        for c in range(columns):
            far = (np.arange(rows)[:, None] - r) ** 2 + (np.arange(columns) - c) ** 2
            near = np.exp(-far / (2 * width**2))
            scale = near.sum() / (near**2).sum()
            seen, expected = (near * count).sum() * scale, (near * rate).sum() * scale
            by_chance = scipy.special.gammainc(max(seen, 1e-9), expected)
            above = count[r, c] > max(rate[r, c] + 2 * np.sqrt(rate[r, c]), contrast * rate[r, c])
            if above and by_chance < chance:
                dense[r, c] = max(count[r, c] - rate[r, c], 0.5)
    return dense


def valley(positions, low, high, steps):
    """Compute `camtopod.learn.zones.separation.valley` over points on a line.

    Tries every pair of flanks and every valley.
    """
    grid = np.linspace(low, high, steps)
    best = 0.0
    for b in range(steps):
        for c in range(b + 1, steps):
            left = max((_valley_ratio(positions, grid, b, c, a, b) for a in range(b)), default=0.0)
            right = max(
                (_valley_ratio(positions, grid, b, c, c, d) for d in range(c + 1, steps)),
                default=0.0,
            )
            best = max(best, min(left, right))
    return best


def _valley_ratio(positions, grid, b, c, f, g):
    inside = max(((positions > grid[b]) & (positions <= grid[c])).sum(), 1e-9)
    flank = max(((positions > grid[f]) & (positions <= grid[g])).sum(), 1e-9)
    rate, flank_rate = inside / (c - b), flank / (g - f)
    if rate >= flank_rate:
        return 0.0
    together = (inside + flank) / (c - b + g - f)
    return inside * np.log(rate / together) + flank * np.log(flank_rate / together)


def way_contrast(sums, n, mean, cov, rates, constants):
    """Return the density of a group by that of the densest way through it (`zones/ways`)."""
    nats, few, least_way, rounder, long, bend, kernel, denser, directions, back, reach = constants
    xx, xy, yy = cov
    for at, variance in zip(mean, (xx - xy**2 / yy, yy - xy**2 / xx), strict=True):
        if at - reach * variance**0.5 < 0 or at + reach * variance**0.5 > 1:
            return np.inf
    more = rounder * (xx + yy)
    root = np.linalg.cholesky([[xx + more, xy], [xy, yy + more]])
    root = root * min(1, long / max(xx, yy) ** 0.5)

    def away(cell, place):
        return np.hypot(*(np.linalg.solve(root, cell[1:3] / cell[0] - mean) - place))

    def density(place):
        return sum(cell[0] * np.exp(-((away(cell, place) / kernel) ** 2) / 2) for cell in sums.T)

    @cache
    def at_place(direction, step):
        angle = 2 * np.pi * direction / directions
        return density(step / 2 * np.array((np.cos(angle), np.sin(angle))))

    @cache
    def way_out(direction, step):
        here = at_place(direction % directions, step)
        if step == 8 or (here > denser * centre):
            return here
        on = [way_out((direction + turn) % directions, step + 1) for turn in (-1, 0, 1)]
        return min(here, max(bend * on[0], on[1], bend * on[2]))

    centre = density(np.zeros(2))
    way = [way_out(direction, 1) for direction in range(directions)]
    through = max(
        min(way[a], way[b])
        for a in range(directions)
        for b in range(directions)
        if (a - b) % directions in back
    )
    rows, columns = rates.shape
    area = 2 * np.pi * kernel**2 * np.sqrt(np.linalg.det(root @ root.T)) * rates.size
    row, column = min(int(mean[1] * rows), rows - 1), min(int(mean[0] * columns), columns - 1)
    through = max(through - area * rates[row, column] / 2, 0) + least_way * sums[0].sum()
    told = n * np.log(centre / through) - n + n * through / centre if centre > through else 0.0
    part = min(told / nats, 1.0) if n < few * sums[0].sum() else 1.0
    return part * centre * (1 - 1 / n**0.5) / through


def gaussian_density(points, mean, cov):
    """Return the density of eq. 2.5 with the correct normaliser."""
    d = points - mean
    squared = np.einsum("ni,ij,nj->n", d, np.linalg.inv(cov), d)
    return np.exp(-squared / 2) / (2 * np.pi * np.sqrt(np.linalg.det(cov)))


# --- learner: window, lags, rates, candidates, joint fit, transit times, significance ---


def mates(events):
    """Return for each event the index of the entry that began the passage which it
    ends, or None.
    """
    result = []
    for i, event in enumerate(events):
        found = None
        if event.kind == "exit" and event.track is not None:
            for j in range(i):
                if (events[j].camera, events[j].track) == (event.camera, event.track):
                    found = j if events[j].kind == "entry" else None
        result.append(found)
    return result


def lag_bin(lag, lag_min, lag_max, scale, step):
    """Return the bin of one lag, counted from the bin of ``lag_min``; -1 if it is out of range."""
    if lag < lag_min or lag > lag_max:
        return -1
    first, last = (int(np.floor(np.arcsinh(end / scale) / step)) for end in (lag_min, lag_max))
    k = first
    while k < last and scale * np.sinh(step * (k + 1)) <= lag:
        k += 1
    return k - first


def own_past(t, zone, seconds):
    """Compute `camtopod.learn.traffic.rhythm._own_past`, comparing all arrivals."""
    return [
        sum(np.exp(-(t[k] - t[j]) / seconds) / seconds for j in range(k) if zone[j] == zone[k])
        for k in range(len(t))
    ]


def past_by_age(t, zone, ages):
    """Compute `camtopod.learn.traffic.rhythm._past_by_age`, comparing all arrivals."""
    return [
        [
            sum(zone[j] == zone[k] and low < t[k] - t[j] <= high for j in range(len(t)))
            / (high - low)
            for k in range(len(t))
        ]
        for low, high in itertools.pairwise(ages)
    ]


def around(t, group, seconds):
    """Compute `camtopod.learn.traffic.rhythm._around`, comparing all arrivals."""
    n = len(t)
    others = [[j for j in range(n) if j != k and group[j] == group[k]] for k in range(n)]
    return [
        sum(np.exp(-abs(t[k] - t[j]) / seconds) / (2 * seconds) for j in others[k])
        for k in range(n)
    ]


def local_rates(t, zone, half_window, prior):
    """Compute `camtopod.learn.traffic.background_rate.local_rates`, comparing all arrivals."""
    rates = []
    for i in range(len(t)):
        same = [j for j in range(len(t)) if zone[j] == zone[i]]
        others = sum(j != i and abs(t[j] - t[i]) <= half_window for j in same)
        span = min(t[i] + half_window, t[-1]) - max(t[i] - half_window, t[0])
        mean = len(same) / max(t[-1] - t[0], 1.0)
        rates.append((others + prior) / (span + prior / mean))
    return np.array(rates)


def chance_rates(left_t, left_zone, came_t, came_zone, zones, width):
    """Compute `camtopod.learn.traffic.background_rate.chance_rates`.

    It is the mean, over the departures of u, of the rate of arrivals at v in the three time bins
    around each.
    """
    first = min(min(left_t), min(came_t))
    last_bin = int((max(max(left_t), max(came_t)) - first) // width)
    result = np.zeros((zones, zones))
    for u in range(zones):
        own = [t for t, zone in zip(left_t, left_zone, strict=True) if zone == u]
        for v in range(zones):
            for t in own:
                here = int((t - first) // width)
                around = [k for k in (here - 1, here, here + 1) if 0 <= k <= last_bin]
                near = sum(
                    zone == v and int((s - first) // width) in around
                    for s, zone in zip(came_t, came_zone, strict=True)
                )
                result[u, v] += near / (width * len(around)) / len(own)
    return result


def candidates(departures, arrivals, lag_min, lag_max):
    """Return (departure, arrival) of every candidate, by arrival, then by departure.

    Of passages that begin together the one that ends first comes first.
    """
    found = []
    for a in range(len(arrivals.t)):
        ends = [d for d in range(len(departures.t)) if departures.own[d] == a]
        for d in range(len(departures.t)):
            lag = arrivals.t[a] - departures.t[d]
            begun = arrivals.t[a] > departures.since[d]
            together = arrivals.t[a] == departures.since[d] and all(d < end for end in ends)
            inside = departures.camera[d] != arrivals.camera[a] and (begun or together)
            if lag_min <= lag <= lag_max and (lag > 0 or inside):
                found.append((d, a))
    return found


def coexisting(camera, entered, left, shift):
    """Return pairs (exit, passage) of different cameras.

    The passage is under way ``shift`` seconds after the exit; see
    `camtopod.learn.next_camera.overlapping_views`.
    """
    every = range(len(left))
    return {
        (i, k)
        for i in every
        for k in every
        if camera[i] != camera[k] and entered[k] <= left[i] + shift < left[k]
    }


def exposures(departures, bins, zones, until):
    """Compute the exposures of the joint fit, departure by departure and bin by bin."""
    exposed = np.zeros((zones, bins.size))
    for t, zone, since in zip(departures.t, departures.zone, departures.since, strict=True):
        for k in range(bins.size):
            if bins.edges[k + 1] <= 0:
                exposed[zone, k] += min(
                    max(bins.edges[k + 1] + t - since, 0.0) / bins.widths[k], 1.0
                )
            else:
                exposed[zone, k] += until - t >= bins.edges[k + 1]
    return exposed


@functools.cache
def smoothing_kernel(size, sd_bins):
    """Return a matrix whose column j is a normal density around bin j.

    Columns are cut off at the ends and sum to 1.
    """
    result = np.zeros((size, size))
    for j in range(size):
        column = [np.exp(-((i - j) ** 2) / (2 * sd_bins**2)) for i in range(size)]
        for i in range(size):
            result[i, j] = column[i] / sum(column)
    return result


def smoothed(row, steps):
    """Compute `camtopod.topology.lag_bins.smooth` of one row: counts, share kept in the own bin."""
    sd_bins = next(sd for least, sd in steps if sum(row) >= least)
    kernel = smoothing_kernel(len(row), sd_bins)
    spread = np.zeros(len(row))
    for j, mass in enumerate(row):
        for i in range(len(row)):
            spread[i] += kernel[i, j] * mass
    middle = len(row) // 2
    return spread, kernel[middle, middle]


def joint_fit(
    departures,
    arrivals,
    pairs,
    hazard,
    bins,
    exposure,
    zones,
    outside,
    sparsity,
    iterations,
    constants,
):
    """Run iterations of the joint fit with plain EM, without pooling and slowness.

        pairs: (departure, arrival) of each candidate.
        hazard: (u, v) -> (bins,).
        constants: least share that leaves the site, least share from outside, smoothing steps.

    Returns the responsibilities, the counts and new hazards by pair of zones, and the shares from
    outside.
    """
    leave_floor, outside_floor, smoothing = constants
    lag = [arrivals.t[a] - departures.t[d] for d, a in pairs]
    cell = [lag_bin(x, bins.lag_min, bins.lag_max, bins.scale, bins.step) for x in lag]
    zone_pair = [(int(departures.zone[d]), int(arrivals.zone[a])) for d, a in pairs]
    outside = [outside] * zones
    message, responsibility = [1.0] * len(pairs), [0.0] * len(pairs)
    own = {z: np.zeros(bins.size) for z in hazard}
    for _ in range(iterations):
        # Weight of each candidate, without its own part of the hazard.
        others = [
            max(1 - r * own[z][k], 0.0)
            for r, z, k in zip(responsibility, zone_pair, cell, strict=True)
        ]
        weight = [hazard[z][k] * o for z, k, o in zip(zone_pair, cell, others, strict=True)]

        # Messages from departures to arrivals, then back; responsibilities.
        offer = []
        for c, (d, _) in enumerate(pairs):
            leave = max(
                1.0 - appears_again(departures.zone[d], hazard, bins, exposure), leave_floor
            )
            rivals = sum(
                weight[o] * message[o] for o, (e, _) in enumerate(pairs) if e == d and o != c
            )
            offer.append(weight[c] / (leave + rivals))
        message, responsibility = [], []
        for c, (_, a) in enumerate(pairs):
            background = outside[arrivals.zone[a]] * arrivals.rate[a]
            rivals = sum(offer[o] for o, (_, b) in enumerate(pairs) if b == a and o != c)
            message.append(1 / (background + rivals))
            responsibility.append(offer[c] / (background + rivals + offer[c]))

        # Transitions by lag, and the shares from outside.
        counts = {z: np.zeros(bins.size) for z in hazard}
        explained = np.zeros(zones)
        for c, (_, a) in enumerate(pairs):
            counts[zone_pair[c]][cell[c]] += responsibility[c]
            explained[arrivals.zone[a]] += responsibility[c]
        came = [max(sum(z == v for z in arrivals.zone), 1) for v in range(zones)]
        outside = [min(max(1 - explained[v] / came[v], outside_floor), 1.0) for v in range(zones)]

        # New hazards.
        fresh = {}
        for (u, v), row in counts.items():
            total = sum(row)
            kept = max(total - sparsity, 0.001 * total) / max(total, 1e-300)
            spread, stays = smoothed(kept * row, smoothing)
            own[u, v] = stays / np.maximum(spread, 1e-300)
            fresh[u, v] = np.array(
                [spread[k] / (max(exposure[u, k], 1.0) * bins.widths[k]) for k in range(bins.size)]
            )
        hazard = fresh
    return responsibility, counts, hazard, outside


def returning(rates):
    """Return what each pair of zones would have if it equalled the opposite direction.

    ``rates``: (u, v) -> (bins,) transitions per exposed departure. See `Prior.back`.
    """
    return {(u, v): rates.get((v, u), 0.0 * row) for (u, v), row in rates.items()}


def two_way(transitions, beforehand):
    """Compute the share of transitions that as many return from (`Prior.departures`).

    ``transitions``: (u, v) -> number.
    """
    both = sum(min(number, transitions.get((v, u), 0.0)) for (u, v), number in transitions.items())
    return (both + beforehand) / (sum(transitions.values()) + beforehand)


def appears_again(zone, hazard, bins, exposure):
    """Return the probability that an object leaving at the zone is seen again, as a
    sum of hazards.
    """
    again = 0.0
    for (source, _), row in hazard.items():
        for k in range(bins.size):
            share = (
                1.0
                if bins.edges[k + 1] > 0
                else exposure[source, k] / max(max(exposure[source]), 1.0)
            )
            again += (source == zone) * row[k] * bins.widths[k] * share
    return again


def weighted_quantile(lags, weights, q):
    """Return the first lag at which the share ``q`` of the weight is reached."""
    wanted, reached = q * sum(weights), 0.0
    for lag, weight in sorted(zip(lags, weights, strict=True)):
        reached += weight
        if weight > 0 and reached >= wanted - 1e-9:
            return lag
    return np.nan


def q_values(p, tests):
    """Return q-values by Benjamini and Hochberg: the smallest level at which each p is rejected."""
    result = []
    for own in p:
        levels = []
        for other in p:
            if other >= own:
                rank = sum(value <= other for value in p)
                levels.append(other * tests / rank)
        result.append(min(1.0, *levels))
    return np.array(result)


def slowness(source, target, stay, least, stay_min, slowness_max):
    """Return the log of each passage's dwell time over the median of its zones.

    It is nan for zones with few passages.
    """
    result = []
    for u, v, seconds in zip(source, target, stay, strict=True):
        own = [s for a, b, s in zip(source, target, stay, strict=True) if (a, b) == (u, v)]
        median = np.median(np.log(np.maximum(own, stay_min)))
        relative = np.log(max(seconds, stay_min)) - median
        result.append(
            max(-slowness_max, min(relative, slowness_max)) if len(own) >= least else np.nan
        )
    return np.array(result)


def chain(zones, links):
    """Return (from, to) -> share of the exits of a camera that are next seen at another."""
    moved = {}
    for a in {zone.camera for zone in zones}:
        exits = sum(zone.exits for zone in zones if zone.camera == a)
        for b in {zone.camera for zone in zones}:
            number = 0.0
            for link in links:
                ends = (
                    [zone for zone in zones if zone.id == link.from_],
                    [z for z in zones if z.id == link.to],
                )
                if link.relation != "visible" and (ends[0][0].camera, ends[1][0].camera) == (a, b):
                    number += link.probability * ends[0][0].exits
            if number and exits:
                moved[a, b] = min(number / exits, 1.0)
    return moved


# --- screening ---


def standing_out(departures, arrivals, source, target, bins, exposure, chance, wide):
    """Return how far lags from one zone to another exceed the null model, standard deviations.

    It is the largest excess over every two wide bins in a row, at least 0. Wide bins to which no
    departure is exposed do not count; within one camera, only those after the exit do. ``chance``:
    rate of arrivals, per second. ``wide``: lag bins in a wide bin; one of these begins at 0.
    """
    camera = dict(zip(departures.zone, departures.camera, strict=True))
    camera.update(zip(arrivals.zone, arrivals.camera, strict=True))
    at = [
        lag_bin(arrivals.t[a] - departures.t[d], bins.lag_min, bins.lag_max, bins.scale, bins.step)
        for d, a in candidates(departures, arrivals, bins.lag_min, bins.lag_max)
        if (departures.zone[d], arrivals.zone[a]) == (source, target)
    ]
    groups = {}
    for k in range(bins.size):
        groups.setdefault((k + bins.first) // wide, []).append(k)
    groups = {number: of for number, of in groups.items() if exposure[:, of].any()}
    most = 0.0
    for number in groups:
        both = groups[number] + groups.get(number + 1, [])
        if number + 1 not in groups:
            continue
        if number < 0 and camera.get(source) == camera.get(target):
            continue
        expected = sum(chance * exposure[source, k] * bins.widths[k] for k in both)
        most = max(most, (sum(k in both for k in at) - expected) / np.sqrt(expected + 1.0))
    return most


def likely(departures, arrivals, followed, bins, exposure, chance, first, start_floor, least):
    """Compute `camtopod.learn.association.weighing.likely`: (departure, arrival) -> probability.

    ``followed``: pairs of zones. ``first``: `excess` of a histogram.
    """
    pairs = [
        (d, a)
        for d, a in candidates(departures, arrivals, bins.lag_min, bins.lag_max)
        if (departures.zone[d], arrivals.zone[a]) in followed
    ]
    ends = [(int(departures.zone[d]), int(arrivals.zone[a])) for d, a in pairs]
    lags = [arrivals.t[a] - departures.t[d] for d, a in pairs]
    at = [lag_bin(lag, bins.lag_min, bins.lag_max, bins.scale, bins.step) for lag in lags]

    # Initial hazards, from the excess over the null model.
    hazard = {}
    for u, v in followed:
        seen = np.zeros(bins.size)
        for end, k in zip(ends, at, strict=True):
            seen[k] += end == (u, v)
        usual = chance(np.array([u]), np.array([v]))[0] * exposure[u] * bins.widths
        above = first(seen[None, :], usual[None, :])[0]
        hazard[u, v] = [
            max(above[k], start_floor * seen[k])
            / max(exposure[u, k] * bins.widths[k], bins.widths[k])
            for k in range(bins.size)
        ]

    # Share each arrival.
    weight = [hazard[end][k] for end, k in zip(ends, at, strict=True)]
    share = []
    for c, (_, a) in enumerate(pairs):
        rivals = sum(w for w, (_, b) in zip(weight, pairs, strict=True) if b == a)
        share.append(weight[c] / (arrivals.rate[a] + rivals))
    return {pair: own for pair, own in zip(pairs, share, strict=True) if own > least}


# --- posterior: contexts, entry kernels; prediction ---


def entered_at(departures, arrivals):
    """Return the zone of entry of each departure, -1 where unknown."""
    return [int(arrivals.zone[own]) if own >= 0 else -1 for own in departures.own]


def likeliest_before(departures, arrivals, pairs, responsibility, least):
    """Return the previous camera of each departure's object, and its probability.

    It sums the candidates of the arrival that began the passage.
    """
    result = []
    for own in departures.own:
        mass = {}
        for (d, a), r in zip(pairs, responsibility, strict=True):
            if own >= 0 and a == own and r > least:
                camera = int(departures.camera[d])
                mass[camera] = mass.get(camera, 0.0) + r
        best = max(mass, key=mass.get, default=-1)
        result.append((best, min(mass.get(best, 0.0), 1.0)))
    return result


def contexts(departures, arrivals, pairs, responsibility, share, gone, leave, back_off, least):
    """Compute `camtopod.learn.next_camera.contexts.Contexts` with explicit leave-one-out sums.

    Returns for each level (departures by context, transitions by context and target); shares; and
    the probabilities of leaving the site.
    """
    n, entry = len(departures.t), entered_at(departures, arrivals)
    sure = {}
    for zone in set(departures.zone.tolist()):
        own = [
            r for (d, _), r in zip(pairs, responsibility, strict=True) if departures.zone[d] == zone
        ]
        sure[zone] = sum(r * r for r in own) / max(sum(own), 1e-300)
    before = likeliest_before(departures, arrivals, pairs, responsibility, least)

    # Level by level: key of each departure, and how sure it is.
    levels = []
    for name in ("entry+block", "previous"):
        key, told = [], []
        for d in range(n):
            first, block, certain = -1, -1, 1.0
            if "entry" in name:
                first, certain = entry[d], float(entry[d] >= 0)
            if "block" in name:
                block, certain = int(departures.block[d]), certain * (departures.block[d] >= 0)
            if name == "previous":
                first, certain = before[d]
            key.append((int(departures.zone[d]), first, block))
            told.append(certain)
        mine = [sure[departures.zone[d]] * told[d] for d in range(n)]
        moved = [mine[d] * r for (d, _), r in zip(pairs, responsibility, strict=True)]

        # Back off each candidate's share, without the candidate itself.
        new_share = []
        for c, (d, a) in enumerate(pairs):
            above = sum(
                moved[o]
                for o, (e, b) in enumerate(pairs)
                if o != c and key[e] == key[d] and arrivals.zone[b] == arrivals.zone[a]
            )
            below = sum(mine[e] for e in range(n) if e != d and key[e] == key[d])
            here = (above + back_off * share[c]) / (below + back_off)
            new_share.append(told[d] * here + (1 - told[d]) * share[c])
        new_leave = []
        for d in range(n):
            others = [e for e in range(n) if e != d and key[e] == key[d]]
            stays = sum(mine[e] * gone[e] for e in others) + back_off * leave[d]
            here = stays / (sum(mine[e] for e in others) + back_off)
            new_leave.append(told[d] * here + (1 - told[d]) * leave[d])
        share, leave = new_share, new_leave

        # Counts of the level.
        departures_of, transitions_of = {}, {}
        for d in range(n):
            departures_of[key[d]] = departures_of.get(key[d], 0.0) + mine[d]
        for c, (d, a) in enumerate(pairs):
            cell = key[d], int(arrivals.zone[a])
            transitions_of[cell] = transitions_of.get(cell, 0.0) + moved[c]
        levels.append((departures_of, transitions_of))
    return levels, np.array(share), np.array(leave)


def entry_kernels(departures, arrivals, candidates, bins, zones):
    """Return the counts of entry kernels.

    They are, per zone of entry and lag bin, the passages still in view when the bin begins; and for
    each candidate that appears before the exit, ((zone of entry, zone of appearance), bin of the
    lag from the entry).
    """
    entry = entered_at(departures, arrivals)
    exposed = np.zeros((zones, bins.size))
    for d, zone in enumerate(entry):
        for k in range(bins.size):
            exposed[zone, k] += zone >= 0 and departures.t[d] - departures.since[d] >= bins.edges[k]
    early = {}
    for c, (d, a) in enumerate(zip(candidates.departure, candidates.arrival, strict=True)):
        if entry[d] >= 0 and arrivals.t[a] < departures.t[d]:
            lag = arrivals.t[a] - departures.since[d]
            k = lag_bin(lag, bins.lag_min, bins.lag_max, bins.scale, bins.step)
            if k >= 0:
                early[c] = (entry[d], int(arrivals.zone[a])), k
    return exposed, early


def multiplier(before, after, most):
    """Compute `camtopod.learn.next_camera.contexts.multipliers` of one pair of probabilities."""
    if after >= most * before:
        return 1.0 / most if after == 0 else most
    return max(after / before, 1.0 / most)


def surroundings(share, leave, steps, back_off, most, leave_floor):
    """Compute `camtopod.predict.contexts.ContextMultipliers.multipliers`, target by target.

    share: target -> share.
    steps: (departures, transitions by target, probability) of each context, in order.
    """
    now, stays_now = dict(share), leave
    for departures, moved, told in steps:
        for target in share:
            here = (moved.get(target, 0.0) + back_off * now[target]) / (departures + back_off)
            now[target] = told * here + (1 - told) * now[target]
        stays = max(departures - sum(moved.values()), 0.0)
        stays_now = (
            told * (stays + back_off * stays_now) / (departures + back_off) + (1 - told) * stays_now
        )
    return {target: multiplier(share[target], now[target], most) for target in share}, max(
        stays_now, leave_floor
    )


def predicted(topology, seen, asked, zone_of, constants, now=None):
    """Predict the exit ``asked`` after the events ``seen``, as
    `camtopod.predict.predictor.Predictor`.

    All events are at different times, with correct clocks. Returns {zone index: probability}, with
    None for leaving the site.

        constants: back-off, largest multiplier, least probability of leaving, prior of a dead camera,
            least probability, least rate, shortest dwell time, largest slowness.
        now: time of the question; the exit itself and later events may be among the events.
    """
    back_off, most, leave_floor, dead, least, rate_min, stay_min, slowest = constants
    model, zones = rows_of(topology), topology.zones
    index = {zone.id: k for k, zone in enumerate(zones)}
    scale, step = model.lag_scale, model.lag_step

    def at(lag):
        inside = model.lag_min <= lag <= model.lag_max
        return int(np.floor(np.arcsinh(lag / scale) / step)) if inside else None

    def edges(k):
        return scale * np.sinh(step * k), scale * np.sinh(step * (k + 1))

    def table(histogram):
        width = {
            histogram.first + i: edges(histogram.first + i) for i in range(len(histogram.mass))
        }
        return {
            k: mass / (high - low)
            for (k, (low, high)), mass in zip(width.items(), histogram.mass, strict=True)
        }

    onward = {
        index[row.zone]: {index[o.to]: (o.share, table(o.hazard)) for o in row.next_}
        for row in model.onward
    }
    leave = {index[row.zone]: row.leave for row in model.onward}
    kernels = {(index[row.zone], index[row.to]): table(row.hazard) for row in model.entered}
    stay = {index[row.zone]: row.stay for row in model.zones}
    outside = {index[row.zone]: row.arrival_rate + 1e-6 for row in model.zones}

    def alike(label, a):
        """Return the ratio of one object over two, for a passage's label and the arrival ``a``."""
        if not model.labels or not {label, a.label} <= {*model.labels.names}:
            return 1.0
        share = model.labels.shares[zones[zone_of(a)].id][model.labels.names.index(a.label)]
        return (
            1.0 - model.labels.persistence + (label == a.label) * model.labels.persistence / share
        )

    def label_of(event, p):
        return event.label or (None if p is None else seen[p].label)

    def rate(u, v, lag):
        return onward[u].get(v, (0, {}))[1].get(at(lag), 0.0)

    def rate_entered(u, v, elapsed):
        return kernels.get((u, v), {}).get(at(elapsed), 0.0)

    def begun(zone, k):
        middle = scale * np.sinh(step * (k + 0.5))
        share = 1.0 - np.interp(-middle, stay[zone], np.linspace(0, 1, 11)) if stay[zone] else 1.0
        return min(max(share, 0.02), 1.0) if edges(k)[1] <= 0 and stay[zone] else 1.0

    def rate_ahead(camera, v):
        own = [k for k in onward if zones[k].camera == camera and v in onward[k]]
        exits = max(sum(zone.exits for zone in zones if zone.camera == camera), 1)
        result = 0.0
        for u in own:
            row = onward[u][v][1]
            ahead = sum(
                h * (edges(k)[1] - edges(k)[0]) * begun(u, k)
                for k, h in row.items()
                if edges(k)[1] <= 0
            )
            result += zones[u].exits / exits * ahead / max(stay[u][5] if stay[u] else 10.0, 1.0)
        return result

    def passage_of(n, event):
        """Return the number of the entry that began a passage, which an exit ends at or before
        number n.
        """
        for j in range(n - 1, -1, -1):
            if event.track is not None and (seen[j].camera, seen[j].track) == (
                event.camera,
                event.track,
            ):
                return j if seen[j].kind == "entry" else None
        return None

    def under_way(j, known):
        """Return True if the passage begun by entry j is under way after the first known events."""
        same = [
            seen[i].camera == seen[j].camera and seen[i].track == seen[j].track
            for i in range(j + 1, known)
        ]
        return seen[j].kind == "entry" and seen[j].track is not None and not any(same)

    def causes(n, known, but=()):
        """Return by camera the rate at which known events could have caused arrival n.

        Known are the events before number ``known``, without the events ``but``.
        """
        a, v, found = seen[n], zone_of(seen[n]), {}
        for x in range(known):
            p = passage_of(x, seen[x])
            if seen[x].kind == "exit" and x not in but and (p is None or seen[p].t <= a.t):
                more = rate(zone_of(seen[x]), v, a.t - seen[x].t)
                if a.t < seen[x].t and p is not None:
                    more += rate_entered(zone_of(seen[p]), v, a.t - seen[p].t)
                more *= alike(label_of(seen[x], p), a)
                found[seen[x].camera] = found.get(seen[x].camera, 0.0) + more
        for j in range(n):
            if j not in but and under_way(j, known) and seen[j].camera != a.camera:
                more = rate_ahead(seen[j].camera, v) + rate_entered(
                    zone_of(seen[j]), v, a.t - seen[j].t
                )
                more *= alike(seen[j].label, a)
                found[seen[j].camera] = found.get(seen[j].camera, 0.0) + more
        return found

    u, p = zone_of(asked), passage_of(sum(event.t < asked.t for event in seen), asked)
    own = [p, *(n for n, event in enumerate(seen) if event == asked)]
    since = -np.inf if p is None else seen[p].t
    slower = 1.0
    if p is not None and model.pace is not None:
        for way in model.pace.ways:
            if (index[way.entry], index[way.exit]) == (zone_of(seen[p]), u):
                slow = min(
                    max(np.log(max(asked.t - since, stay_min) / way.stay), -slowest), slowest
                )
                slower = np.exp(model.pace.scaling * slow * (1 + model.pace.correlation) / 2)

    watched = min([asked.t, *(event.t for event in seen)]) - asked.t

    def exposed_to(k):
        """Return the share of bin ``k`` within the passage; all of a bin after the exit."""
        low, high = edges(k)
        if high > 0 or p is None:
            return begun(u, k)
        return min(max((high - (since - asked.t)) / (high - low), 0.0), 1.0)

    def odds_by(until):
        """Return the odds of appearing at each zone, as known at ``until``."""
        mass, pace = {}, slower if until > asked.t else 1.0
        for v, (_, row) in onward[u].items():
            last = max(
                (n for n, event in enumerate(seen, 1) if event.camera == zones[v].camera), default=0
            )
            share = sum(known.share for known in model.cameras if known.camera == zones[v].camera)
            alive = 1.0 / (1.0 + dead * np.expm1(min((len(seen) - last) * share, 50.0)))
            mass[v] = 0.0
            for k, h in row.items():
                low, high = edges(k)
                if high > 0:
                    left = (high * pace - max(until - asked.t, low * pace)) / (
                        high * pace - low * pace
                    )
                    mass[v] += h * (high - low) * alive * max(left, 0.0)
                else:
                    unwatched = max(min(high, watched) - low, 0.0)
                    mass[v] += h * unwatched * alive * exposed_to(k)
        for n, a in enumerate(seen):
            v, lag = zone_of(a), a.t - asked.t
            usual = lag / pace if lag > 0 else lag
            if (
                a.kind != "entry"
                or v not in onward[u]
                or a.t > until
                or (lag < 0 and a.camera == asked.camera)
            ):
                continue
            if a.t <= since or at(usual) is None:
                continue
            k, entered = at(usual), 0.0
            if p is not None and lag < 0:
                entered = rate_entered(zone_of(seen[p]), v, a.t - since)
            here = rate(u, v, usual) * exposed_to(k) / (pace if lag > 0 else 1.0) + entered
            here *= alike(label_of(asked, p), a)
            others = sum(causes(n, len(seen), own).values())
            mass[v] += here / max(outside[v] + others, rate_min)
        return mass

    mass = odds_by(asked.t)
    steps = []
    block = None if asked.x is None else int(asked.y * 6) * 6 + int(asked.x * 6)
    entry, before = (
        (None, {}) if p is None else (zones[zone_of(seen[p])].id, causes(p, len(seen), own))
    )
    previous = max(before, key=before.get, default=None)
    sure = (
        before[previous] / (outside[zone_of(seen[p])] + sum(before.values())) if previous else 0.0
    )
    known = {(row.zone, row.entry, row.block, row.previous): row for row in model.contexts}
    both = None if entry is None or block is None else (entry, block, None)
    asks = [both, (None, None, previous)]
    for key, told in zip(asks, (1.0, sure), strict=True):
        row = (
            known.get((zones[u].id, *key))
            if key and any(part is not None for part in key)
            else None
        )
        if row is not None:
            steps.append(
                (row.departures, {index[name]: count for name, count in row.to.items()}, told)
            )
    shares = {v: share for v, (share, _) in onward[u].items()}
    likelier, stays = surroundings(shares, leave[u], steps, back_off, most, leave_floor)
    if not any(row.zone == zones[u].id for row in model.contexts):
        stays = leave[u]
    doubt = {(index[row.zone], index[o.to]): o.doubt for row in model.onward for o in row.next_}
    stays += sum(mass[v] * likelier[v] * doubt[u, v] for v in mass)
    if now is not None and now > asked.t:
        stays, mass = max(stays, leave_floor), odds_by(now)
    odds = {v: mass[v] * likelier[v] * (1.0 - doubt[u, v]) for v in mass}
    odds = {v: value for v, value in odds.items() if value >= least * (stays + sum(odds.values()))}
    total = stays + sum(odds.values())
    return {None: stays / total, **{v: value / total for v, value in odds.items()}}


def camera_lags(left, source, dwell, came, target, lag_min, lag_max):
    """Return (departure, arrival) of all candidates by camera, whatever their zones."""
    return [
        (d, a)
        for d in range(len(left))
        for a in range(len(came))
        if max(lag_min, -dwell[d]) <= came[a] - left[d] <= lag_max
        and (came[a] > left[d] or target[a] != source[d])
    ]


# --- walks ---


def matching_marginals(weights, nobody, outside):
    """Return the probability (exits, entries) that each exit caused each entry, by enumeration.

    weights (exits, entries): rate at which each exit would cause each entry, relative to nobody.
    nobody (exits,): probability that an exit causes no entry. outside (entries,): rate from outside.
    """
    exits, entries = weights.shape
    found = np.zeros((exits, entries))
    total = 0.0
    for causes in itertools.product(range(-1, exits), repeat=entries):
        used = [cause for cause in causes if cause >= 0]
        if len(set(used)) < len(used):
            continue
        mass = np.prod([nobody[x] for x in range(exits) if x not in used])
        for entry, cause in enumerate(causes):
            mass *= outside[entry] if cause < 0 else weights[cause, entry]
        total += mass
        for entry, cause in enumerate(causes):
            if cause >= 0:
                found[cause, entry] += mass
    return found / total


# --- between (each exit by itself, and every number of objects) ---


def later_than(age, q10, q50, q90):
    """Return the share of appearances later than an age (seconds since the exit)."""
    if age >= q90:
        return 0.1 * 0.2 ** ((age - q90) / max(q90 - q50, 1e-3))
    knots = [min(q10, 0.0), q10, q50, q90]
    return float(np.interp(age, knots, [1.0, 0.9, 0.5, 0.1]))


def still_to_come(t, appearances, claims, now, horizon):
    """Return the probability of each appearance of an exit at t that it comes within the horizon.

    appearances: rows of probability, q10, q50, q90. claims: of entries, in the order in which they
    were told: the entry, its time, and the probability that it is of this exit.
    """

    def expected(moment):
        return [p * later_than(max(moment - t, 0.0), *window) for p, *window in appearances]

    gone = 1.0 - sum(expected(t))
    odds = {}
    for entry, at, probability in claims:
        odds.pop(entry, None)
        rest = gone + sum(expected(at)) + sum(odds.values())
        odds[entry] = rest * probability / (1.0 - probability)
    total = gone + sum(expected(now)) + sum(odds.values())
    return [
        (soon - late) / total
        for soon, late in zip(expected(now), expected(now + horizon), strict=True)
    ]


# --- common_cycle (moved copies against their definition) ---


def cycle_rates(left, came, hazard, edges, first, until, move, period):
    """Return the rate at each arrival after the departures have been moved round the window.

    hazard: rate by lag bin, whose edges are given; no lag is before the departure.
    """
    turn = (until - first) // period * period
    rates = []
    for t in came:
        rate = 0.0
        for departure in left:
            lag = t - (first + (departure - first + move) % turn)
            if departure - first < turn and t - first < turn and lag > 0:
                k = np.flatnonzero((edges[:-1] <= lag) & (lag < edges[1:]))
                rate += hazard[k].sum()
        rates.append(rate)
    return np.array(rates)


def label_shares(zone, label, weight):
    """Return the share of each arrival's label at its zone, as
    `camtopod.learn.traffic.labels.label_shares`.
    """
    known = [k for k in range(len(zone)) if label[k] >= 0]
    result = []
    for k in range(len(zone)):
        here = [label[j] for j in known if zone[j] == zone[k]]
        of_site = [label[j] for j in known].count(label[k]) / max(len(known), 1)
        share = (here.count(label[k]) + weight * of_site) / (len(here) + weight)
        result.append(share if label[k] >= 0 else 1.0)
    return result


def label_agreement(left, came, share, persistence):
    """Return the likelihood ratios of one object, as
    `camtopod.learn.traffic.labels.label_agreement`.
    """
    result = []
    for a, b, p in zip(left, came, share, strict=True):
        one_object = persistence * (1.0 if a == b else 0.0) + (1.0 - persistence) * p
        result.append(one_object / p if a >= 0 and b >= 0 else 1.0)
    return result


def label_persistence(like, share, responsibility, same, other):
    """Return the likeliest persistence, of a grid; as
    `camtopod.learn.traffic.labels.estimate_label_persistence`.
    """
    grid = np.linspace(0.0005, 0.9995, 2000)
    nats = same * np.log(grid) + other * np.log(1 - grid)
    for alike, p, r in zip(like, share, responsibility, strict=True):
        nats = nats + np.log(r * (1 - grid + grid * alike / p) + 1 - r)
    return grid[np.argmax(nats)]
