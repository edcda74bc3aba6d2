"""The nouns: events, topology, predictions. What outsiders hold on to, and nothing that computes.

Times are seconds since the Unix epoch at the moment of capture; image positions are fractions of
the width (``x``, to the right) and height (``y``, downwards); durations are seconds. Fields may be
added, never changed.
"""

from __future__ import annotations

from typing import Annotated, Literal

from msgspec import Meta, Struct, field

CAMERA_CHARACTERS_MAX = 64
CAMERA_PATTERN = rf"^[A-Za-z0-9_.-]{{1,{CAMERA_CHARACTERS_MAX}}}\Z"
TOPOLOGY_SCHEMA = "camtopod/topology/1"
DELTA_SCHEMA = "camtopod/topology-delta/1"

CameraId = Annotated[str, Meta(pattern=CAMERA_PATTERN)]
Kind = Literal["entry", "exit"]
Relation = Literal["visible", "overlapped", "unseen"]
PairRelation = Literal["overlapped", "unseen_path"]


class Event(Struct, frozen=True, omit_defaults=True, gc=False):
    """One object appearing in (``entry``) or leaving (``exit``) the view of one camera.

    ``x``, ``y`` is the foot point, both or neither. ``track`` ties the entry and the exit of one
    passage through this camera. ``boot`` and ``seq`` (the publisher's incarnation and a gap-free
    count within it) make delivery idempotent. ``clock_sd`` is the one-sigma uncertainty of ``t`` in
    seconds.
    """

    camera: CameraId
    kind: Kind
    t: Annotated[float, Meta(ge=-1e11, le=1e11)]
    x: Annotated[float, Meta(ge=0, le=1)] | None = None
    y: Annotated[float, Meta(ge=0, le=1)] | None = None
    track: Annotated[str, Meta(max_length=128)] | int | None = None
    boot: Annotated[str, Meta(max_length=64)] | None = None
    seq: Annotated[int, Meta(ge=0, le=2**63 - 1)] | None = None
    clock_sd: Annotated[float, Meta(ge=0, le=1e6)] | None = None


class Zone(Struct, frozen=True, omit_defaults=True):
    """An entry/exit zone. One without positions (one zone per camera) has no ``x``, ``y``, ``cov``.

    ``entries`` and ``exits`` are counts in the window learned from; ``x``, ``y`` their mean foot
    point; ``cov`` its covariance (2, 2), [[xx, xy], [xy, yy]]: of fractions of the width and
    height, so without a unit.
    """

    id: str
    camera: str
    entries: int
    exits: int
    x: float | None = None
    y: float | None = None
    cov: list[list[float]] | None = None


class Camera(Struct, frozen=True):
    """A camera, its zones, and the estimated offset of its clock in seconds: positive when it is
    ahead, 0.0 where unknown. ``clock_offset_sd``: standard deviation if the clocks that count as
    right are; none where unknown.
    """

    id: str
    zones: list[str]
    clock_offset: float = 0.0
    clock_offset_sd: float | None = None


class Transit(Struct, frozen=True, omit_defaults=True):
    """Transit time from the exit at ``from`` to the entry at ``to``, seconds; negative where views
    overlap.

    ``mean_sd``, ``q50_sd``: standard errors of mean and median.
    """

    mode: float
    mean: float
    sd: float
    q10: float
    q50: float
    q90: float
    mean_sd: float | None = None
    q50_sd: float | None = None


class Histogram(Struct, frozen=True, omit_defaults=True):
    """Transit-time histogram: ``mass[k]`` times ``unit`` is the expected number of transits in lag
    bin ``first + k``. The unit is 1 for links. ``delay``: seconds to add to the lags of the bins,
    for long ways.
    """

    first: int
    mass: list[int | float]
    unit: float = 1.0
    delay: float = 0.0


class Lacks(Struct, frozen=True):
    """What a weak link still needs until it is published: further ``passages``, which take
    ``seconds`` at this traffic.
    """

    passages: float
    seconds: float


class Link(Struct, frozen=True, omit_defaults=True, rename={"from_": "from"}):
    """A directed link between two zones.

    ``probability``: of all objects that leave at ``from``, the share that appears next at ``to``;
    ``transitions``: their expected number. ``q_value``: false discovery rate at which the link is
    published. ``mahalanobis_variance``: the thesis's figure, Var(d) (table 4.3). ``histogram``
    counts on the lag bins of the topology's model. ``lacks``: of a weak link, unless waiting does
    not help.
    """

    from_: str
    to: str
    relation: Relation
    probability: float
    transitions: float
    transit: Transit
    q_value: float
    mahalanobis_variance: float
    histogram: Histogram | None = None
    lacks: Lacks | None = None


class Pair(Struct, frozen=True, omit_defaults=True):
    """A related pair of cameras, ids sorted: the thesis's black (overlapped) or grey (unseen path)
    edge.

    ``by_lags``: from where the lags of the links lie; ``by_sum_rule``: from the thesis's table 4.4,
    none where it could not be tested; ``reason``: why the two are not the same.
    """

    cameras: tuple[str, str]
    relation: PairRelation
    by_lags: PairRelation | None = None
    by_sum_rule: PairRelation | None = None
    reason: str | None = None


class ZoneModel(Struct, frozen=True):
    """What prediction needs of a zone beyond its links."""

    zone: str
    departures: int
    """Exits at this zone in the window the links were learned from."""
    arrival_rate: float
    """Entries per second that no departure explains."""
    stay: list[float]
    """Deciles (11) of the seconds a passage that leaves here has lasted; empty when unknown."""


class CameraModel(Struct, frozen=True):
    """What prediction needs of a camera: its share of all events, and when it was last heard."""

    camera: str
    share: float
    last_event: float


class Outcome(Struct, frozen=True):
    """One zone where objects may appear next. ``share`` of the departures are expected there;
    ``hazard`` has, per lag bin, the probability of appearing in it for a departure that is exposed
    to it. ``doubt``: the share of this that may as well be chance, in which case they were not seen
    again.
    """

    to: str
    share: float
    hazard: Histogram
    doubt: float = 0.0


class Onward(Struct, frozen=True):
    """What is expected of objects leaving ``zone``: to appear next elsewhere, or (``leave``) not to
    be seen again.
    """

    zone: str
    leave: float
    next_: list[Outcome]


class EntryKernel(Struct, frozen=True):
    """Objects that entered a view at ``zone`` and appear at ``to`` before they leave it; the lags
    of ``hazard`` count from the entry.
    """

    zone: str
    to: str
    hazard: Histogram


class Context(Struct, frozen=True, omit_defaults=True):
    """Departures at ``zone`` of which more is known: the zone of ``entry``, the ``block`` of the
    image where they left (row * columns + column of a coarse grid), the camera where they probably
    were before (``previous``). ``departures`` and the transitions ``to`` each zone are weighed by
    how sure they are.
    """

    zone: str
    departures: float
    to: dict[str, float]
    entry: str | None = None
    block: int | None = None
    previous: str | None = None


class Way(Struct, frozen=True):
    """A way through one view: passages from ``entry`` to ``exit`` take ``stay`` seconds
    (median).
    """

    entry: str
    exit: str
    stay: float


class Pace(Struct, frozen=True):
    """How slowness (log of a passage's duration over its way's median) persists: transit times
    scale with it to the power ``scaling``, two views of one object correlate by ``correlation``,
    ``sd`` is its standard deviation. Hazards are of objects of usual pace.
    """

    scaling: float
    correlation: float
    sd: float
    ways: list[Way]


class Overlap(Struct, frozen=True):
    """Two views that overlap. Of the objects that leave the view of ``camera``, ``share`` are in
    that of ``to`` at that moment. ``same``: their passages there, ``others``: passages of others
    under way there, both for each exit and by how many seconds later than the one that ends they
    began, on lag bins.
    """

    camera: str
    to: str
    share: float
    same: Histogram
    others: Histogram


class Model(Struct, frozen=True):
    """What `predict` needs beyond the links. Lag bin ``k`` starts at ``lag_scale * sinh(lag_step *
    k)`` seconds.
    """

    lag_scale: float
    lag_step: float
    lag_min: float
    lag_max: float
    zones: list[ZoneModel]
    cameras: list[CameraModel]
    clocks_corrected: bool = False
    """Whether the links' transit times are in right time, not by the cameras' own clocks.
    Histograms always are.
    """
    onward: list[Onward] | None = None
    """The posterior, weak evidence included; without it prediction reads the links."""
    entered: list[EntryKernel] | None = None
    contexts: list[Context] | None = None
    pace: Pace | None = None
    overlaps: list[Overlap] | None = None
    """Views that overlap; none were looked for if there is no list."""


class ChainEdge(Struct, frozen=True, rename={"from_": "from"}):
    """A transition of the Markov chain over cameras (thesis 4.6): of those leaving ``from``, the
    share seen at ``to``.
    """

    from_: str
    to: str
    probability: float


class Alarm(Struct, frozen=True):
    """Something changed, as found in ``version``; ``t`` is that version's ``as_of``.

    ``kind`` is ``link_opened``, ``link_closed``, ``link_changed``, ``zone_new``, ``zone_gone``,
    ``camera_silent``, ``camera_back``, ``camera_moved``, ``camera_doubled`` or ``clock_changed``;
    there may be further ones. ``subject`` is a camera, a zone or two zones (``lobby/1->hall/2``);
    ``detail`` is for people.
    """

    version: int
    t: float
    kind: str
    subject: str
    detail: str


class SelfScore(Struct, frozen=True):
    """How well the last ``exits`` predictions scored were, the oldest made with ``since_version``.

    Who went where is taken from later versions, which have seen what came after. ``top1``,
    ``top3``: share of those seen again whose next camera was the likeliest, or among the likeliest
    three; ``log_loss``: mean over all exits of -ln(probability of what happened), nats. The
    baseline always says the most frequent next camera of a camera.
    """

    exits: int
    since_version: int
    log_loss: float
    top1: float
    top3: float
    baseline_log_loss: float
    baseline_top1: float


class Topology(Struct, frozen=True, omit_defaults=True):
    """One version of the learned topology. ``digest`` is over the content, not over site, epoch and
    version.
    """

    schema: str
    site: str
    epoch: str
    version: int
    as_of: float
    events: int
    digest: str
    cameras: list[Camera]
    zones: list[Zone]
    links: list[Link]
    pairs: list[Pair]
    weak_links: list[Link] | None = None
    chain: list[ChainEdge] | None = None
    model: Model | None = None
    alarms: list[Alarm] | None = None
    """The newest, oldest first, of this version and of those before it in the epoch."""
    score: SelfScore | None = None

    def __post_init__(self) -> None:
        if self.schema != TOPOLOGY_SCHEMA:
            raise ValueError(f"schema is {self.schema!r}; this program reads {TOPOLOGY_SCHEMA!r}")


class Delta(Struct, frozen=True, omit_defaults=True):
    """What changed from ``version - 1`` to ``version``: new or changed items whole, gone items by
    key.

    A link's key is (from, to, relation). ``digest`` is the digest of the topology that results.
    """

    schema: str
    site: str
    epoch: str
    version: int
    as_of: float
    events: int
    digest: str
    cameras: list[Camera] = field(default_factory=list)
    zones: list[Zone] = field(default_factory=list)
    links: list[Link] = field(default_factory=list)
    weak_links: list[Link] = field(default_factory=list)
    pairs: list[Pair] = field(default_factory=list)
    gone_cameras: list[str] = field(default_factory=list)
    gone_zones: list[str] = field(default_factory=list)
    gone_links: list[tuple[str, str, str]] = field(default_factory=list)
    gone_weak_links: list[tuple[str, str, str]] = field(default_factory=list)
    gone_pairs: list[tuple[str, str]] = field(default_factory=list)
    chain: list[ChainEdge] | None = None
    model: Model | None = None
    alarms: list[Alarm] | None = None
    """Those of this version."""
    score: SelfScore | None = None


class NextCamera(Struct, frozen=True):
    """One possible next appearance; the quantiles are seconds after the exit."""

    camera: str
    zone: str
    probability: float
    q10: float
    q50: float
    q90: float


class Look(Struct, frozen=True):
    """``probability`` that a camera sees an object at the moment it leaves another view or, if none
    does, is the next to see it.
    """

    camera: str
    probability: float


class InView(Struct, frozen=True):
    """A passage under way in the view of ``camera``, ``since`` Unix seconds, that is of the object
    that leaves with this ``probability``.
    """

    camera: str
    track: str
    since: float
    probability: float


class Prediction(Struct, frozen=True, omit_defaults=True, rename={"next_": "next"}):
    """Where an object that has just left will appear next. ``next`` (falling probability) and
    ``leave`` sum to 1.

    ``look`` and ``in_view`` are there where other views overlap the one that was left, with falling
    probability. The probabilities of ``look`` may sum to more than 1, as several cameras may see
    the object at once.
    """

    camera: str
    zone: str | None
    t: float
    track: str | None
    version: int
    leave: float
    next_: list[NextCamera]
    look: list[Look] | None = None
    in_view: list[InView] | None = None


class Ack(Struct, frozen=True, omit_defaults=True):
    """The highest (boot, seq) of a camera below which everything is safely stored.

    The counters are of the events of this boot since the daemon's start: those that are learned
    from, those that were older than what had been learned already (``late``), those that came again
    (``duplicate``), and those that are stored and not learned from, as their camera flooded or
    their time was in the future (``refused``).
    """

    camera: str
    boot: str
    seq: int
    daemon: str = ""
    """The name of the daemon, which stays with its state directory."""
    accepted: int | None = None
    late: int | None = None
    duplicate: int | None = None
    refused: int | None = None
