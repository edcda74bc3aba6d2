"""Events from the bus to the journal: received, ordered, stored once each, and acknowledged.

Read the head of `receiver` first: it describes the path of an event, and the threads. `stages` has
the steps of the path. An event passes `inbox` (a fair queue, if it has to wait), `admission`
(decoding; which events are accepted), `sequencing` (order within a stream), `camera_registry`
(clocks, floods, number of cameras), `backlog` (order across cameras), `names` (forgotten and
renamed cameras) and `store_queue`; then `acks` acknowledges it. `puller` asks spools for missing
events, `duplicates` compares repeated ones, and `idle_time` advances event time when no events
come.
"""

from __future__ import annotations

from camtopod.serve.ingest.camera_registry import Received as Received
from camtopod.serve.ingest.names import (
    CommandRefused as CommandRefused,
    Names as Names,
    known_site as known_site,
    read_names as read_names,
)
from camtopod.serve.ingest.puller import Puller as Puller
from camtopod.serve.ingest.receiver import Receiver as Receiver
