"""For other people's programs: a tracker's boxes to events, and what the site has learned, live.

    from camtopod.client import Topology

    with Topology.connect("hq") as site:  # the daemon on this machine; connect="tcp/192.168.1.5:7447" for another's
        print(site.current.pairs)
        print(site.predict("lobby", t=1_700_003_601.2, x=0.9, y=0.5).next_)

`camtopod.client.aio` is the same for asyncio. Nothing here needs more than the packages that
camtopod itself needs.
"""

from camtopod.adapt import TrackEvents
from camtopod.client.errors import NothingLearned, UnknownPlace
from camtopod.client.gate import Gate
from camtopod.client.site import Predictions, Topology
from camtopod.serve.bus import BusError

__all__ = [
    "BusError",
    "Gate",
    "NothingLearned",
    "Predictions",
    "Topology",
    "TrackEvents",
    "UnknownPlace",
]
