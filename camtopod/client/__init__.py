"""Client library for other programs: events from a tracker, live topology, predictions.

    import camtopod

    with camtopod.connect("hq") as site:  # a daemon on this machine
        print(site.current.pairs)
        print(site.predict("lobby", t=1_700_003_601.2, x=0.9, y=0.5))

For a daemon on another machine pass its endpoint: ``connect="tcp/192.168.1.5:7447"``.
`camtopod.client.aio` has the same interface for asyncio. No packages beyond camtopod's own
dependencies are needed.

Reading order: `site` (the public classes), `site_view` (their common part), `gate` (association
priors), `publisher`, `errors`, then `answer_queue` and `wakeup` (queueing and notification).
"""

from camtopod.adapt import TrackEvents as TrackEvents
from camtopod.client.errors import NothingLearned as NothingLearned, UnknownPlace as UnknownPlace
from camtopod.client.gate import Gate as Gate
from camtopod.client.publisher import Publisher as Publisher
from camtopod.client.site import Answers as Answers, Site as Site, connect as connect
from camtopod.records import Event as Event, Match as Match, Prediction as Prediction
from camtopod.serve.bus import BusError as BusError
from camtopod.serve.storage import StateError as StateError
