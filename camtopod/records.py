"""Public data types: events, topologies, predictions, statuses; their only logic is words.

Times are seconds since the Unix epoch at the moment of capture; durations are seconds. Image
positions are fractions of the image's width (``x``, to the right) and height (``y``, downwards).
Fields may be added, but existing ones never change their meaning.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct, field

from camtopod import words
from camtopod.labels import LABEL_CHARACTERS_MAX, LABELS_MAX

NAME_PATTERN = r"^[A-Za-z0-9_.-]{1,64}\Z"
"""Regular expression of a name; ``\\Z`` refuses the newline that ``$`` would allow."""
RESERVED = ("daemon", ".", "..")
"""Names that no camera may have: ``status/daemon`` is the daemon's, and spools are named after
cameras."""
CAMERA_PATTERN = r"^(?!(daemon|\.|\.\.)\Z)[A-Za-z0-9_.-]{1,64}\Z"
"""Regular expression of a camera id: a name that is not reserved."""
ZONE_PATTERN = r"^[A-Za-z0-9_.-]{1,64}/[0-9]{1,9}\Z"
"""Regular expression of a zone id, CAMERA/NUMBER."""
TOPOLOGY_SCHEMA = "camtopod/topology/1"
"""`Topology.schema` of the topologies that this program reads and writes."""
MODEL_SCHEMA = "camtopod/topology-model/1"
"""`VersionModel.schema` of the models that this program reads and writes."""
DELTA_SCHEMA = "camtopod/topology-delta/1"
"""`Delta.schema` of the deltas that this program reads and writes."""

LAG_BINS_MAX = 1_000
"""Most lag bins that a model may have; learned topologies have about 90."""

# Ranges of numbers, checked on decoding. They are those of any possible site, not of a likely one.
Count = Annotated[int, Meta(ge=0, le=2**53)]
Number = Annotated[float, Meta(ge=0, le=1e15)]
"""Expected number, or a rate."""
Share = Annotated[float, Meta(ge=0, le=1.001)]
"""Share or probability; the upper end allows for rounding."""
Seconds = Annotated[float, Meta(ge=-1e11, le=1e11)]
"""Time since 1970, or a lag, which may be negative."""
Duration = Annotated[float, Meta(ge=0, le=1e11)]
"""Seconds, not negative."""
# Columns of numbers (`camtopod.columns`), in base64 where they are JSON.
Uint8s = Annotated[bytes, Meta(description="uint8, deflated by zlib")]
Int16s = Annotated[bytes, Meta(description="int16, little-endian, deflated by zlib")]
Int32s = Annotated[bytes, Meta(description="int32, little-endian, deflated by zlib")]
Float32s = Annotated[bytes, Meta(description="float32, little-endian, deflated by zlib")]
Float64s = Annotated[bytes, Meta(description="float64, little-endian, deflated by zlib")]
Covariance = Annotated[
    list[Annotated[list[Annotated[float, Meta(ge=-1, le=1)]], Meta(min_length=2, max_length=2)]],
    Meta(min_length=2, max_length=2),
]

CameraId = Annotated[str, Meta(pattern=CAMERA_PATTERN)]
ZoneId = Annotated[str, Meta(pattern=ZONE_PATTERN)]
Kind = Literal["entry", "exit"]
Relation = Literal["visible", "overlapped", "unseen"]
"""Relation of the zones of a link.

visible: two zones of one view, joined by its passages.
overlapped: zones of two views; most objects appear in the second before they leave the first.
unseen: zones of two views, joined by a path that no camera sees.
"""
PairRelation = Literal["overlapped", "unseen_path"]
"""Relation of two cameras: their views overlap, or a path that no camera sees joins them."""


def _metric(name: str, meaning: str) -> Meta:
    """Make a field a metric of ``/metrics``: ``camtopod_`` and this name, and what it means."""
    return Meta(title=name, description=meaning)


class Event(Struct, frozen=True, omit_defaults=True, gc=False):
    """One object that appears in the view of a camera (``entry``) or leaves it (``exit``).

        >>> from camtopod import Event
        >>> Event("lobby", "exit", 1_700_000_000.25, x=0.31, y=0.88, track="17").kind
        'exit'

    t: time of capture.
    x, y: foot point; both or neither.
    track: ties the entry and the exit of one passage through this camera's view.
    boot, seq: incarnation of the publisher, and a count without gaps within it and the camera; both
        or neither. With them an event that is delivered twice counts once.
    clock_sd (seconds): standard deviation of ``t``.
    spooled: on the bus only, the publisher delivers this event by ``store/{camera}`` as well: the
        daemon hears it, for predictions, and stores it then.
    label: class of the object, such as ``person`` or ``car``; never what tells one from another.
    """

    camera: CameraId
    kind: Kind
    t: Seconds
    x: Annotated[float, Meta(ge=0, le=1)] | None = None
    y: Annotated[float, Meta(ge=0, le=1)] | None = None
    track: Annotated[str, Meta(max_length=128)] | int | None = None
    boot: Annotated[str, Meta(max_length=64)] | None = None
    seq: Annotated[int, Meta(ge=0, le=2**63 - 1)] | None = None
    clock_sd: Annotated[float, Meta(ge=0, le=1e6)] | None = None
    spooled: bool = False
    label: Annotated[str, Meta(max_length=LABEL_CHARACTERS_MAX)] | None = None


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


class Histograms(Struct, frozen=True):
    """Histograms of n rows on lag bins.

    first (n,): lag bin of the first mass of each. bins (n,): number of its masses.
    unit (n,): scale of its masses.
    steps: ``steps * unit`` are the masses, those of one row after those of the row before.
    """

    first: Int16s
    bins: Int16s
    unit: Float32s
    steps: Uint8s


class Onward(Struct, frozen=True):
    """Expected next appearances of objects, by the zone that they leave.

    leave (zones,): share of the objects that leave the site, so are not seen again.
    number (zones,): number of zones where the others appear next. The other columns have a row for
        each of these, those of the first zone first.
    to (n,): zone where they appear.
    share (n,): share of the departures that are expected to arrive there.
    doubt (n,): part of this that may be spurious; objects of spurious transitions are not seen
        again.
    delay (n, seconds): added to the lags of all bins, for long paths.
    missed (n,): 1 for objects that a camera on the way misses; contexts do not tell these.
    hazard: for each lag bin, the probability to arrive in it of a departure that is exposed to it.
    """

    leave: Float32s
    number: Int32s
    to: Int32s
    share: Float32s
    doubt: Float32s
    delay: Float32s
    missed: Uint8s
    hazard: Histograms


class EntryKernelColumns(Struct, frozen=True):
    """Objects that entered a view at ``zone`` and appear at ``to`` before they leave that view.

    The lags of ``hazard`` count from the entry at ``zone``.
    """

    zone: Int32s
    to: Int32s
    hazard: Histograms


class ContextColumns(Struct, frozen=True):
    """Departures about which more is known than the zone.

    number (zones,): number of contexts of each zone. The next columns have a row for each of these.
    entry (n,): zone where the objects entered the view. -1 for none, as in the next two.
    block (n,): where in the image they left it, as row * columns + column of a coarse grid.
    previous (n,): camera where they probably were before.
    departures (n,): their number, weighted by the probability that they have this context.
    followed (n,): number of zones to which they made transitions; the next columns have a row for
        each of these.
    to (m,): zone of arrival. transitions (m,): number of transitions, weighted likewise.
    """

    number: Int32s
    entry: Int32s
    block: Int32s
    previous: Int32s
    departures: Float32s
    followed: Int16s
    to: Int32s
    transitions: Float32s


class Pace(Struct, frozen=True):
    """How an object's slowness persists from one view to the next.

    Slowness is the log of a dwell time over the median of its route, which leads through one view.
    Hazards are those of objects of usual speed.

    scaling: transit times scale with the dwell time over its median to this power.
    correlation: correlation of the slowness of one object in two views.
    sd: standard deviation of the slowness.
    entry, exit (n,): zones of each route. stay (n, seconds): median dwell time of its passages.
    """

    scaling: Annotated[float, Meta(ge=0, le=10)]
    correlation: Annotated[float, Meta(ge=-1, le=1)]
    sd: Annotated[float, Meta(ge=0, le=10)]
    entry: Int32s
    exit: Int32s
    stay: Float32s


class LabelModel(Struct, frozen=True):
    """Labels of objects, and how far they persist from one view to the next.

    names: the labels that count, sorted.
    persistence: share of the objects that have the same label in the next view; the label of the
        others is as that of any arrival.
    shares (zones, names): of the arrivals with a label at each zone, the share of each label.
    """

    names: Annotated[list[str], Meta(max_length=LABELS_MAX)]
    persistence: Annotated[float, Meta(ge=0, le=0.9999)]
    shares: Float32s


class Overlaps(Struct, frozen=True):
    """Pairs of views that overlap.

    camera, to (n,): the two cameras.
    share (n,): of the objects that leave the view of ``camera``, the share that is in the view of
        ``to`` at that moment.
    same: passages of these objects in the view of ``to``.
    others: passages of other objects that are under way there.

    Both histograms are per exit from ``camera``; their lag is the number of seconds by which a
    passage began after the one that the exit ends.
    """

    camera: Int32s
    to: Int32s
    share: Float32s
    same: Histograms
    others: Histograms


class PathColumns(Struct, frozen=True, rename={"from_": "from"}):
    """Paths between cameras, on which lags have Student's t distribution (5 degrees).

    of_zones: the ends are zones; else they are cameras.
    from_, to (n,): the ends of each.
    share (n,): of the objects leaving ``from``, the share that takes it.
    place, width (n, seconds): median and scale of the lags.
    """

    of_zones: bool
    from_: Int32s
    to: Int32s
    share: Float32s
    place: Float32s
    width: Float32s


class WeakLinks(Struct, frozen=True, rename={"from_": "from"}):
    """Links between views whose evidence does not meet the rule for publishing.

    from_, to (n,): the zones.
    overlapped (n,): 1 for links of the relation ``overlapped``, 0 for ``unseen``.
    figures (n, 14): probability, transitions, the eight fields of `Transit`, q_value,
        mahalanobis_variance, and the two of `Lacks`, as in `Link`; nan for None.
    provisional: as in `Link`, for each; empty if none is.
    """

    from_: Int32s
    to: Int32s
    overlapped: Uint8s
    figures: Float32s
    provisional: list[str] = []


class Declared(Struct, frozen=True, omit_defaults=True):
    """What the user has declared of the site, by the present names of its cameras.

    neighbours: pairs of cameras between which objects go without passing another one; each pair is
        sorted.
    not_neighbours: pairs between which nobody does.
    nobody_leaves: all objects appear again in some camera.
    """

    neighbours: list[tuple[CameraId, CameraId]] = []
    not_neighbours: list[tuple[CameraId, CameraId]] = []
    nobody_leaves: bool = False


class Model(Struct, frozen=True, omit_defaults=True):
    """What `camtopod.predict` needs beyond the map, as columns (`camtopod.columns`).

    Zones and cameras are numbers: positions in the lists of the topology. Lag bin ``k`` starts at
    ``lag_scale * sinh(lag_step * k)`` seconds.

    clocks_corrected: transit times of links are in corrected time, as histograms always are, not by
        the cameras' own clocks.
    declared: what the user has declared; None for nothing.
    departures (zones,): exits in the window from which the links were learned.
    arrival_rate (zones, 1/s): rate of entries without a departure that explains them.
    stay (zones, 11, seconds): deciles of the dwell times of passages that end there; 0 if unknown.
    event_share (cameras,): share of each camera in all events; 0 if unknown.
    last_event (cameras, Unix seconds): time of its last event; 0 if unknown.
    onward: the posterior, weak evidence included; without it prediction uses the links.
    overlaps: views that overlap; None if they were not searched for.
    paths: a second opinion, which has half of the weight; None if the posterior needs none. What
        the paths of a camera leave of 1 is the share that leaves the site.
    labels: only if events have labels, and not all the same.
    weak_links: None if there are none.
    """

    lag_scale: Annotated[float, Meta(ge=1e-3, le=1e6)]
    lag_step: Annotated[float, Meta(ge=1e-4, le=10)]
    lag_min: Annotated[float, Meta(ge=-1e6, le=1e6)]
    lag_max: Annotated[float, Meta(ge=-1e6, le=1e6)]
    departures: Int32s
    arrival_rate: Float32s = b""
    stay: Float32s = b""
    event_share: Float32s = b""
    last_event: Float64s = b""
    clocks_corrected: bool = False
    declared: Declared | None = None
    onward: Onward | None = None
    entered: EntryKernelColumns | None = None
    contexts: ContextColumns | None = None
    pace: Pace | None = None
    overlaps: Overlaps | None = None
    paths: PathColumns | None = None
    labels: LabelModel | None = None
    weak_links: WeakLinks | None = None


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

    exits: Annotated[Count, _metric("score_exits", "Predictions that are scored")]
    since_version: Count
    log_loss: Number
    top1: Annotated[Share, _metric("score_top1", "Share of next cameras that were the likeliest")]
    top3: Annotated[Share, _metric("score_top3", "Share of next cameras among the likeliest three")]
    baseline_log_loss: Number
    baseline_top1: Annotated[Share, _metric("score_baseline_top1", "Top-1 score of the baseline")]


class _OfVersion(Struct, frozen=True, omit_defaults=True):
    """The first fields of a topology and of a delta."""

    schema: str
    site: str
    epoch: str
    version: Count
    as_of: Seconds
    events: Count
    digest: str


class Topology(_OfVersion, frozen=True, omit_defaults=True):
    """One version of the learned topology.

        >>> from camtopod import load_topology
        >>> for link in load_topology("topology.json").links:
        ...     print(link.from_, link.to, link.relation, round(link.transit.q50))
        lobby/1 hall/1 unseen 8

    ``digest`` is over the content, without site, epoch and version. ``alarms`` are the newest of
    the epoch, oldest first. ``evidence``: before the first link between views, the share of its
    evidence that is there, which does not fall; None after it.
    """

    cameras: list[Camera]
    zones: list[Zone]
    links: list[Link]
    pairs: list[Pair]
    model: Model | None = None
    alarms: list[Alarm] | None = None
    score: SelfScore | None = None
    evidence: Share | None = None

    def __post_init__(self) -> None:
        if self.schema != TOPOLOGY_SCHEMA:
            raise ValueError(f"schema is {self.schema!r}; this program reads {TOPOLOGY_SCHEMA!r}")


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


class NextCamera(Struct, frozen=True, omit_defaults=True):
    """One possible next appearance of an object that has left a view.

    q10, q50, q90 (seconds after the exit): the object appears earlier in 10, 50 and 90 % of cases.
    prior: True if these are guesses, as too few such objects have been seen.
    """

    camera: str
    zone: str
    probability: float
    q10: float
    q50: float
    q90: float
    prior: bool = False

    @property
    def when(self) -> str:
        """When it appears, in words; where views overlap it may have done so before the exit."""
        return words.when(self)


class Look(Struct, frozen=True):
    """Probability that a camera sees the object when it exits or, if none does, sees it next."""

    camera: str
    probability: float


class InView(Struct, frozen=True):
    """A passage under way in another view that may be of the object that left.

    since: time when the passage began.
    """

    camera: str
    track: str
    since: float
    probability: float


class Prediction(Struct, frozen=True, omit_defaults=True, rename={"candidates": "next"}):
    """Where an object that has left the view of ``camera`` at ``t`` appears next.

        >>> from camtopod import Event, Predictor, load_topology
        >>> predictor = Predictor(load_topology("topology.json"))
        >>> prediction = predictor.predict(Event("lobby", "exit", 1_700_000_000.0))
        >>> prediction.candidates[0].camera, prediction.candidates[0].when
        ('hall', 'in 6 to 10 s')
        >>> print(prediction)
        hall 98 %, in 6 to 10 s; leaves the site 2 %

    zone: zone where it left; None if the camera has no zone yet.
    version: version of the topology that was used.
    leave: probability that it leaves the site; with those of ``candidates``, and with ``others`` if
        that is there, it sums to 1.
    candidates: possible next appearances, by falling probability; a zone may be there more than
        once, for other times. The JSON key is ``next``.
    look, in_view: only if other views overlap: cameras that may see the object now or next, whose
        probabilities may sum to more than 1, and passages under way that may be of it.
    others: sum of the probabilities that are left out of ``candidates``; None if it has all.
    prior: True if it is not learned yet where objects of the zone go.
    """

    camera: str
    zone: str | None
    t: float
    track: str | None
    version: int
    leave: float
    candidates: list[NextCamera]
    look: list[Look] | None = None
    in_view: list[InView] | None = None
    others: float | None = None
    prior: bool = False

    def __str__(self) -> str:
        return words.headline(self).words


class MatchedPassage(Struct, frozen=True, omit_defaults=True):
    """An earlier passage that an entry may continue.

    t: time of its exit or, while it is under way, of its entry.
    """

    camera: str
    t: float
    probability: float
    track: str | None = None


class Match(Struct, frozen=True, omit_defaults=True, rename={"from_": "from"}):
    """Which earlier passages the entry at ``camera`` and ``t`` may continue.

    version: version of the topology that was used.
    from_: the passages, by falling probability; with ``new`` they sum to 1. The JSON key is
        ``from``.
    new: probability that it continues none of them.
    walk: name of the walk it belongs to: camera and time of its oldest passage of the
        last hour.
    """

    camera: str
    t: float
    version: int
    from_: list[MatchedPassage]
    new: float
    walk: str
    track: str | None = None


class SeenEvent(Struct, frozen=True, omit_defaults=True):
    """An event of the last hour as a reader may see it: without its track.

    zone: None if its camera has no zone yet.
    label: class of the object, if it is one of those that count.
    """

    t: float
    camera: str
    kind: Kind
    zone: str | None = None
    x: float | None = None
    y: float | None = None
    label: str | None = None


class EventHours(Struct, frozen=True):
    """Entries and exits by the hour, for a day.

    since: when counting began, Unix seconds; a start of the daemon begins anew.
    first: when the first of the hours begins.
    cameras: by camera: entries and exits of each hour.
    """

    since: float
    first: float
    cameras: dict[str, list[list[int]]]


class Recent(Struct, frozen=True, omit_defaults=True):
    """Events of the last hour, in the order in which they were received.

    t: moment of the answer.
    hours: only if asked for.
    """

    t: float
    events: list[SeenEvent]
    hours: EventHours | None = None


class Status(Struct, frozen=True):
    """State of the daemon or of the program that publishes a camera's events.

    state: running or degraded for the daemon; connecting, running, stalled, failed and others for
        a camera.
    reason: why it is not running as it should; empty if it is.
    t (Unix seconds): when the status was made.
    camera: the camera; the daemon's status has none.
    status_seconds: interval at which the status is published; None: it does not say.

    Counters and other fields follow; which ones, and what they mean, may change.
    """

    state: str = ""
    reason: str = ""
    t: float = 0.0
    camera: str | None = None
    status_seconds: float | None = None


class GrabberStatus(Status, frozen=True):
    """State of a grabber, as published on ``status/{camera}``; None: it does not say."""

    restarts: Annotated[
        int | None, _metric("grabber_restarts_total", "Restarts of the camera's process")
    ] = None
    failures: Annotated[
        int | None, _metric("grabber_failures_total", "Connections that failed or were lost")
    ] = None
    frames_analysed: Annotated[
        int | None, _metric("grabber_frames_analysed_total", "Frames analysed")
    ] = None
    last_frame_t: Annotated[
        float | None,
        _metric("grabber_frame_timestamp_seconds", "Capture time of the latest frame"),
    ] = None
    waiting: Annotated[
        int | None, _metric("spool_events", "Events that the daemon has not stored yet")
    ] = None
    dropped: Annotated[
        int | None, _metric("spool_dropped_total", "Events lost because the spool was full")
    ] = None
    damaged_files: Annotated[
        int | None, _metric("spool_damaged_files", "Files of the spool set aside for damage")
    ] = None


class CameraFigures(Struct, frozen=True):
    """A camera in the daemon's status; ``ahead`` is None if it is unknown."""

    events: Annotated[
        int, _metric("events_total", "Events taken from the camera since the start")
    ] = 0
    newest: Annotated[
        float | None, _metric("event_timestamp_seconds", "Time of the camera's newest event")
    ] = None
    ahead: Annotated[
        float | None,
        _metric("clock_ahead_seconds", "Last event's time ahead of this machine's clock"),
    ] = None
    alive: Annotated[
        bool, _metric("camera_alive", "1 while the publisher of the camera's events is on the bus")
    ] = False


class EventCounts(Struct, frozen=True):
    """Events since the daemon's start by what became of them, and those that wait."""

    received: int = 0
    stored: Annotated[int, _metric("events_stored_total", "Events stored in the journal")] = 0
    duplicate: Annotated[int, _metric("events_duplicate_total", "Events received again")] = 0
    future: Annotated[
        int, _metric("events_future_total", "Events too far ahead of the clock, set aside")
    ] = 0
    flood: Annotated[
        int, _metric("events_flood_total", "Events beyond what one view can show, not learned")
    ] = 0
    late: int = 0
    lost: Annotated[int, _metric("events_lost_total", "Events missing between others")] = 0
    waiting: Annotated[int, _metric("events_waiting", "Events stored and not learned yet")] = 0


class LearnerCounts(Struct, frozen=True):
    """The learner's counts in this epoch, and sizes, as of its last step.

    labels_left_out: labels beyond the most frequent, which count as none.
    """

    accepted: int = 0
    duplicate: int = 0
    late: Annotated[int, _metric("events_late_total", "Events that came later than others")] = 0
    refused: int = 0
    surplus: int = 0
    held: Annotated[
        int, _metric("learner_held_events", "Events held until the watermark has passed them")
    ] = 0
    learned: int = 0
    window: int = 0
    cameras: int = 0
    watermark: Annotated[
        float | None,
        _metric("watermark_timestamp_seconds", "Event time up to which everything is learned"),
    ] = None
    version: int = 0
    labels_left_out: int = 0


class CatchingUp(Struct, frozen=True):
    """How far the learner is behind.

    seconds: event time that is stored and not learned yet.
    share: events learned, of those stored since it was up to date.
    """

    seconds: float = 0.0
    share: float = 0.0


class NamesStatus(Struct, frozen=True):
    """Forgotten and renamed cameras.

    forgotten: forgotten names -> events refused since the start.
    renamed: old names -> present names.
    reset (Unix seconds): when the site was reset; None if it never was.
    before_reset: refused events from before that.
    """

    forgotten: dict[str, int] = {}
    renamed: dict[str, str] = {}
    reset: float | None = None
    before_reset: int = 0


class JournalStatus(Struct, frozen=True):
    """The journal."""

    entries: int = 0
    missing: Annotated[
        int, _metric("journal_missing_entries", "Entries it had lost when it was opened")
    ] = 0
    damaged: Annotated[int, _metric("journal_damaged_entries", "Damaged entries, not learned")] = 0
    bytes: Annotated[int, _metric("journal_bytes", "Size of the journal's file")] = 0
    damaged_files: Annotated[
        list[str], _metric("journal_damaged_files", "Files set aside for damage")
    ] = []


class BetweenPair(Struct, frozen=True, rename={"from_": "from"}):
    """Objects expected between two cameras: they left ``from_`` and will appear next at ``to``.

    number: expected number. low, high: ends of an interval of 80 %.
    """

    from_: str
    to: str
    number: float
    low: int
    high: int


class Between(Struct, frozen=True):
    """How many objects are expected between cameras at ``t``.

    They have left a camera, will appear again within an hour, and have not yet.

    since: objects that left earlier do not count.
    number: expected number. low, high: ends of an interval of 80 %.
    pairs: by pair of cameras, those with most objects first.
    """

    t: float
    since: float
    number: Annotated[float, _metric("between_cameras", "Objects expected between cameras")]
    low: int
    high: int
    pairs: list[BetweenPair] = []


class DaemonStatus(Status, frozen=True):
    """State of the daemon, as published on ``status/daemon``.

    site, epoch, version: site of the daemon, and the version of the topology that it published
        last; 0 if there is none.
    rejects, reject_samples: rejected input by reason.
    dropped: publications dropped for lack of room, by camera.
    catching_up: None if the learner is up to date.
    between: objects between cameras, of at most a hundred pairs unless all are asked for; None
        without matches, and while nothing has been learned.
    warnings: what somebody should look at, though it works: a sentence each.
    """

    site: str = ""
    epoch: str = ""
    version: Annotated[int, _metric("topology_version", "Newest version of the topology")] = 0
    events: EventCounts = EventCounts()
    rejects: Annotated[dict[str, int], _metric("rejected_total", "Inputs that were rejected")] = {}
    reject_samples: dict[str, list[str]] = {}
    dropped: dict[str, int] = {}
    learner: LearnerCounts = LearnerCounts()
    catching_up: CatchingUp | None = None
    predictions: Annotated[int, _metric("predictions_total", "Predictions published")] = 0
    matches_skipped: Annotated[
        int, _metric("matches_skipped_total", "Entries without a match for lack of time")
    ] = 0
    questions_refused: int = 0
    score: SelfScore | None = None
    alarms: list[Alarm] = []
    between: Between | None = None
    names: NamesStatus = NamesStatus()
    journal: JournalStatus = JournalStatus()
    cameras: dict[str, CameraFigures] = {}
    warnings: list[str] = []
