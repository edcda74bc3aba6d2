"""Public data types: events, topologies, predictions, statuses; their only logic is words.

Times are seconds since the Unix epoch at the moment of capture; durations are seconds. Image
positions are fractions of the image's width (``x``, to the right) and height (``y``, downwards).
Fields may be added, but existing ones never change their meaning.

Reading order: `event` (what cameras publish), `topology` (the map, its versions and alarms),
`model_columns` (the model of a version), `prediction` (predictions and matches) and `status` (of
the daemon and of grabbers, with the objects between cameras). `field_types` has the types of their
fields: names, ranges of numbers, and columns.
"""

from camtopod.records.event import (
    Event as Event,
    EventHours as EventHours,
    Recent as Recent,
    SeenEvent as SeenEvent,
)
from camtopod.records.field_types import (
    CAMERA_PATTERN as CAMERA_PATTERN,
    NAME_PATTERN as NAME_PATTERN,
    RESERVED as RESERVED,
    ZONE_PATTERN as ZONE_PATTERN,
    CameraId as CameraId,
    Count as Count,
    Covariance as Covariance,
    Duration as Duration,
    Float32s as Float32s,
    Float64s as Float64s,
    Int16s as Int16s,
    Int32s as Int32s,
    Kind as Kind,
    Number as Number,
    PairRelation as PairRelation,
    Relation as Relation,
    Seconds as Seconds,
    Share as Share,
    Uint8s as Uint8s,
    ZoneId as ZoneId,
)
from camtopod.records.model_columns import (
    ContextColumns as ContextColumns,
    Declared as Declared,
    EntryKernelColumns as EntryKernelColumns,
    Histograms as Histograms,
    LabelModel as LabelModel,
    Model as Model,
    Onward as Onward,
    Overlaps as Overlaps,
    Pace as Pace,
    PathColumns as PathColumns,
    WeakLinks as WeakLinks,
)
from camtopod.records.prediction import (
    InView as InView,
    Look as Look,
    Match as Match,
    MatchedPassage as MatchedPassage,
    NextCamera as NextCamera,
    Prediction as Prediction,
)
from camtopod.records.status import (
    Between as Between,
    BetweenPair as BetweenPair,
    CameraFigures as CameraFigures,
    CatchingUp as CatchingUp,
    DaemonStatus as DaemonStatus,
    EventCounts as EventCounts,
    GrabberStatus as GrabberStatus,
    JournalStatus as JournalStatus,
    LearnerCounts as LearnerCounts,
    NamesStatus as NamesStatus,
    Status as Status,
)
from camtopod.records.topology import (
    DELTA_SCHEMA as DELTA_SCHEMA,
    LAG_BINS_MAX as LAG_BINS_MAX,
    LAG_SCALE_SECONDS as LAG_SCALE_SECONDS,
    LAG_STEP as LAG_STEP,
    MODEL_SCHEMA as MODEL_SCHEMA,
    TOPOLOGY_SCHEMA as TOPOLOGY_SCHEMA,
    Alarm as Alarm,
    Camera as Camera,
    Delta as Delta,
    Histogram as Histogram,
    Lacks as Lacks,
    Link as Link,
    Pair as Pair,
    SelfScore as SelfScore,
    ShareMatrix as ShareMatrix,
    Topology as Topology,
    Transit as Transit,
    VersionModel as VersionModel,
    Zone as Zone,
)
