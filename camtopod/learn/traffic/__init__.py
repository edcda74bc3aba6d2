"""The window's events labelled with zones: departures, arrivals, passages, the input of the fits.

The zones of all cameras are numbered from 0; an exit from a zone is a *departure*, an entry into a
zone an *arrival*, and an entry and an exit of one track in one view a *passage*.

Reading order: `events` defines the tables of departures and arrivals. `labelled_events` fills them
from the window and the zone maps (`Scene`). `speed` measures how slow each object is, and estimates
how far slowness persists from view to view; `labels` does so for labels. `background_rate` has the
rates of arrivals under the null model, in which arrivals have nothing to do with departures;
`rhythm` adds the rhythm of each zone's own arrivals to it.
"""

from camtopod.learn.traffic.background_rate import (
    NullRates as NullRates,
    local_rates as local_rates,
)
from camtopod.learn.traffic.events import (
    EVENT_SD_SECONDS as EVENT_SD_SECONDS,
    Arrivals as Arrivals,
    Departures as Departures,
)
from camtopod.learn.traffic.labelled_events import (
    Scene as Scene,
    ZoneRef as ZoneRef,
    label_events as label_events,
)
from camtopod.learn.traffic.labels import (
    RATIO_MAX as RATIO_MAX,
    estimate_label_persistence as estimate_label_persistence,
    first_weights as first_weights,
    label_agreement as label_agreement,
    label_shares as label_shares,
    label_table as label_table,
)
from camtopod.learn.traffic.rhythm import (
    GAIN_NATS as GAIN_NATS,
    HARMONICS as HARMONICS,
    activity_rates as activity_rates,
)
from camtopod.learn.traffic.speed import (
    NO_PERSISTENCE as NO_PERSISTENCE,
    SURE_RESPONSIBILITY as SURE_RESPONSIBILITY,
    Persistence as Persistence,
    adjusted_lag as adjusted_lag,
    agreement as agreement,
    estimate_persistence as estimate_persistence,
    mean_slowness as mean_slowness,
    usual_dwell_times as usual_dwell_times,
)
