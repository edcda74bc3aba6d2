"""The map: cameras, zones, links and pairs of cameras, and what else is in a version of it.

A version of the topology is published whole (`Topology`), or as its difference from the version
before (`Delta`) and its model (`VersionModel`), of which `camtopod.records.model_columns` has the
parts.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

from msgspec import Meta, Struct, field
from msgspec.structs import asdict

from camtopod import words
from camtopod.markov_chain import estimate_markov_chain
from camtopod.records.field_types import (
    CameraId,
    Count,
    Covariance,
    Duration,
    Number,
    PairRelation,
    Relation,
    Seconds,
    Share,
    ZoneId,
    metric,
)
from camtopod.records.model_columns import Model

TOPOLOGY_SCHEMA = "camtopod/topology/1"
"""`Topology.schema` of the topologies that this program reads and writes."""
MODEL_SCHEMA = "camtopod/topology-model/1"
"""`VersionModel.schema` of the models that this program reads and writes."""
DELTA_SCHEMA = "camtopod/topology-delta/1"
"""`Delta.schema` of the deltas that this program reads and writes."""

LAG_SCALE_SECONDS = 4.0
"""Lag, in seconds, around which bins change from constant width to a constant share of the lag."""
LAG_STEP = 0.1
"""Width of a bin in asinh(lag / scale): about 0.4 s near zero, a tenth of the lag far from zero."""
LAG_BINS_MAX = 1_000
"""Most lag bins that a model may have; learned topologies have about 90."""


class Zone(Struct, frozen=True, omit_defaults=True):
    """An entry/exit zone of a view.

    entries, exits: counts in the window that was learned from.
    x, y (fractions of the image): mean foot point of these events.
    cov (2, 2): covariance [[xx, xy], [xy, yy]] of the foot points; no unit, as they are fractions.

    A zone of events without positions (one zone a camera) has no ``x``, ``y`` and ``cov``.
    """

    id: ZoneId
    camera: str
    entries: Count
    exits: Count
    x: Share | None = None
    y: Share | None = None
    cov: Covariance | None = None


class Camera(Struct, frozen=True):
    """A camera with its zones and the estimated offset of its clock.

    clock_offset (seconds): positive if the clock is fast; 0.0 if unknown.
    clock_offset_sd (seconds): its standard deviation, given that the reference clocks are right;
        None if unknown.
    """

    id: CameraId
    zones: list[str]
    clock_offset: Seconds = 0.0
    clock_offset_sd: Duration | None = None


class Transit(Struct, frozen=True, omit_defaults=True):
    """Distribution of the transit time of a link, in seconds; negative where views overlap.

    The time runs from the exit at the link's ``from`` to the entry at its ``to``; for a link within
    one view it is the dwell time, from entry to exit. ``mean_sd`` and ``q50_sd`` are the standard
    errors of the mean and of the median.
    """

    mode: Seconds
    mean: Seconds
    sd: Duration
    q10: Seconds
    q50: Seconds
    q90: Seconds
    mean_sd: Duration | None = None
    q50_sd: Duration | None = None


class Histogram(Struct, frozen=True, omit_defaults=True):
    """Histogram of transit times on the lag bins of the topology's model.

    first: lag bin of ``mass[0]``.
    mass: ``mass[k] * unit`` is the expected number of transitions in lag bin ``first + k``.
    unit: scale of the masses; 1 for links.
    delay (seconds): added to the lags of all bins, for long paths.
    """

    first: int
    mass: Annotated[
        list[Annotated[int, Meta(ge=0, le=10**15)] | Number], Meta(max_length=LAG_BINS_MAX)
    ]
    unit: Number = 1.0
    delay: Duration = 0.0

    @property
    def edges(self) -> list[float]:
        """Edges of the n bins of ``mass``, (n + 1, seconds), delay included.

        They are those of all topologies that this program learns: `LAG_SCALE_SECONDS`, `LAG_STEP`.
        """
        numbers = range(self.first, self.first + len(self.mass) + 1)
        return [self.delay + LAG_SCALE_SECONDS * math.sinh(LAG_STEP * k) for k in numbers]


class Lacks(Struct, frozen=True):
    """Evidence that a weak link still needs to be published.

    passages: further passages that are needed.
    seconds: the time that these take at the present traffic.
    """

    passages: Number
    seconds: Duration


class Link(Struct, frozen=True, omit_defaults=True, rename={"from_": "from"}):
    """A directed link between two zones.

    probability: share of all objects leaving at ``from`` that appear next at ``to``.
    transitions: expected number of these objects.
    q_value: false discovery rate at which the link is published.
    mahalanobis_variance: Var(d) of the thesis (table 4.3).
    histogram: transit times on the lag bins of the topology's model.
    lacks: evidence that a weak link still needs; None if waiting does not help.
    provisional: why the link is not to be relied on, in words; "" if it is.
    contradicted: the user has declared that its cameras are not neighbours.
    """

    from_: str
    to: str
    relation: Relation
    probability: Share
    transitions: Number
    transit: Transit
    q_value: Share
    mahalanobis_variance: Number
    histogram: Histogram | None = None
    lacks: Lacks | None = None
    provisional: str = ""
    contradicted: bool = False

    def times(self) -> tuple[list[float], list[float]]:
        """Return the histogram of transit times: n + 1 edges, seconds, and n masses.

        A mass is the expected number of transitions in its bin; n is 0 without a histogram.
        """
        histogram = self.histogram or Histogram(0, [])
        return histogram.edges, [histogram.unit * mass for mass in histogram.mass]


class Pair(Struct, frozen=True, omit_defaults=True):
    """Two related cameras, ids sorted; an edge of the thesis's graph of cameras.

    relation: overlapped (the thesis's black edges) or an unseen path (its grey edges).
    by_lags: relation that follows from the lags of the links.
    by_sum_rule: relation by table 4.4 of the thesis; None where it cannot be tested.
    reason: why the two differ.
    """

    cameras: tuple[str, str]
    relation: PairRelation
    by_lags: PairRelation | None = None
    by_sum_rule: PairRelation | None = None
    reason: str | None = None


class Alarm(Struct, frozen=True):
    """A change of the site that ``version`` found; ``t`` is the ``as_of`` of that version.

    kind: ``link_opened``, ``link_closed``, ``link_changed``, ``zone_new``, ``zone_gone``,
        ``camera_silent``, ``camera_back``, ``camera_moved``, ``camera_doubled``,
        ``camera_repeats`` or ``clock_changed``; more may be added.
    subject: a camera, a zone, or two zones (``lobby/1->hall/2``).
    detail: a text for people.
    """

    version: Count
    t: Seconds
    kind: str
    subject: str
    detail: str

    def __str__(self) -> str:
        return f"{words.alarm_title(self)}: {self.detail}"


class SelfScore(Struct, frozen=True):
    """Quality of the last ``exits`` predictions, the oldest of them made with ``since_version``.

    The outcomes are taken from later versions, which have seen the events that followed.

    top1, top3: of the objects seen again, the share whose next camera was the likeliest, or one of
        the three likeliest.
    log_loss (nats): mean over all exits of -ln(probability of the outcome).
    baseline_log_loss, baseline_top1: the same for a baseline that always predicts the most frequent
        next camera of a camera.
    """

    exits: Annotated[Count, metric("score_exits", "Predictions that are scored")]
    since_version: Count
    log_loss: Number
    top1: Annotated[Share, metric("score_top1", "Share of next cameras that were the likeliest")]
    top3: Annotated[Share, metric("score_top3", "Share of next cameras among the likeliest three")]
    baseline_log_loss: Number
    baseline_top1: Annotated[Share, metric("score_baseline_top1", "Top-1 score of the baseline")]


class _OfVersion(Struct, frozen=True, omit_defaults=True):
    """The first fields of a topology and of a delta."""

    schema: str
    site: str
    epoch: str
    version: Count
    as_of: Seconds
    events: Count
    digest: str


class ShareMatrix(NamedTuple):
    """Next cameras of the objects that leave each camera, by the published links.

    cameras (n): order of rows and columns.
    probability (n rows of n): of the objects that leave the camera of the row, the share that
        appears next in that of the column, which may be the same one.
    unlinked (n): the share that leaves the site, or appears where no link tells.
    """

    cameras: list[str]
    probability: list[list[float]]
    unlinked: list[float]


class Topology(_OfVersion, frozen=True, omit_defaults=True):
    """One version of the learned topology.

        >>> from camtopod import load_topology
        >>> topology = load_topology("topology.json")
        >>> for link in topology.links:
        ...     print(link.from_, link.to, link.relation, round(link.transit.q50))
        lobby/1 hall/1 unseen 8
        >>> edges, mass = topology.link("lobby", "hall").times()  # histogram, edges in seconds
        >>> len(edges) - len(mass), round(sum(mass))
        (1, 200)
        >>> cameras, probability, unlinked = topology.matrix()
        >>> cameras, [round(share, 1) for share in probability[1]]
        (['hall', 'lobby'], [1.0, 0.0])
        >>> topology.links_table()[0]["q50"] == topology.links[0].transit.q50
        True

    ``digest`` is over the content, without site, epoch and version. ``alarms`` are the newest of
    the epoch, oldest first. ``evidence``: before the first link between views, the share of its
    evidence that is there, which does not fall; None after it.

    A *city* (`camtopod.city.merge`) has the topologies of its districts in ``parts``, whole, and by
    camera the site of the district that owns it in ``owners``. Its own cameras, zones, links and
    pairs are the map of all parts together; it has no figures for prediction
    (`camtopod.predict.CityPredictor` asks the parts), and its ``digest`` is over theirs.
    """

    cameras: list[Camera]
    zones: list[Zone]
    links: list[Link]
    pairs: list[Pair]
    model: Model | None = None
    alarms: list[Alarm] | None = None
    score: SelfScore | None = None
    evidence: Share | None = None
    parts: list[Topology] | None = None
    owners: dict[CameraId, str] | None = None

    def __post_init__(self) -> None:
        if self.schema != TOPOLOGY_SCHEMA:
            raise ValueError(f"schema is {self.schema!r}; this program reads {TOPOLOGY_SCHEMA!r}")

    def link(self, from_: str, to: str) -> Link:
        """Return the link with most transitions between two places, each a zone or a camera.

        Raises KeyError if there is none.
        """
        cameras = {zone.id: zone.camera for zone in self.zones}
        links = [
            link
            for link in self.links
            if from_ in (link.from_, cameras[link.from_]) and to in (link.to, cameras[link.to])
        ]
        if not links:
            raise KeyError(f"version {self.version} has no link from {from_} to {to}")
        return max(links, key=lambda link: link.transitions)

    def links_table(self) -> list[dict[str, Any]]:
        """Return a row for each published link, for ``pandas.DataFrame``.

        The columns are fields of `Link` and `Transit`, and the two cameras.
        """
        cameras = {zone.id: zone.camera for zone in self.zones}
        columns = ("relation", "probability", "transitions", "q_value", "provisional")
        return [
            {
                **{"from": link.from_, "to": link.to},
                **{"from_camera": cameras[link.from_], "to_camera": cameras[link.to]},
                **{name: getattr(link, name) for name in columns},
                **asdict(link.transit),
            }
            for link in self.links
        ]

    def matrix(self) -> ShareMatrix:
        """Return the next cameras as a matrix: the Markov chain over cameras (thesis 4.6)."""
        names = [camera.id for camera in self.cameras]
        chain = estimate_markov_chain(self.zones, self.links)
        rows = [[chain.get(a, {}).get(b, 0.0) for b in names] for a in names]
        return ShareMatrix(names, rows, [max(1.0 - sum(row), 0.0) for row in rows])


class VersionModel(Struct, frozen=True):
    """The model of one version, apart from its map; ``digest`` is that of both."""

    schema: str
    site: str
    epoch: str
    version: Count
    digest: str
    model: Model

    def __post_init__(self) -> None:
        if self.schema != MODEL_SCHEMA:
            raise ValueError(f"schema is {self.schema!r}; this program reads {MODEL_SCHEMA!r}")


class Delta(_OfVersion, frozen=True, omit_defaults=True):
    """The difference from ``version - 1`` to ``version`` of a map.

    New and changed items are whole, removed items are keys. The key of a link is (from, to,
    relation). ``digest`` is the digest of the resulting topology, ``alarms`` are those of this
    version.
    """

    cameras: list[Camera] = field(default_factory=list)
    zones: list[Zone] = field(default_factory=list)
    links: list[Link] = field(default_factory=list)
    pairs: list[Pair] = field(default_factory=list)
    gone_cameras: list[str] = field(default_factory=list)
    gone_zones: list[str] = field(default_factory=list)
    gone_links: list[tuple[str, str, str]] = field(default_factory=list)
    gone_pairs: list[tuple[str, str]] = field(default_factory=list)
    alarms: list[Alarm] | None = None
    score: SelfScore | None = None
    evidence: Share | None = None
