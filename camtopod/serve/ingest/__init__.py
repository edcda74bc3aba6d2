"""Events from the bus to the journal: received, ordered, stored once each, and acknowledged.

Read `receiver` first. An event passes `inbox` (a fair queue), `camera_registry` (clocks, floods,
limits), `sequencing` (order within a stream), `backlog` (order across cameras) and `store_queue`;
then `acks` acknowledges it. `puller` asks spools for missing events, `duplicates` compares repeated
ones, and `idle_time` advances event time when no events come.
"""

from __future__ import annotations

from camtopod.serve.ingest.camera_registry import Received
from camtopod.serve.ingest.puller import Puller
from camtopod.serve.ingest.receiver import Receiver

__all__ = [
    "Puller",
    "Received",
    "Receiver",
]
