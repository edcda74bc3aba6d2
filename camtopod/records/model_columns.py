"""The model of a version: what prediction needs beyond the map, as columns of numbers."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

from camtopod.labels import LABELS_MAX
from camtopod.records.field_types import CameraId, Float32s, Float64s, Int16s, Int32s, Uint8s


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
    not_neighbours: pairs between which no object does.
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
