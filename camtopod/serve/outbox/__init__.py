"""The publishing side of the event protocol: no event is lost between a publisher and the daemon.

Start with `publisher`: it stores each event in the spool, publishes it, and answers the daemon's
queries for events it has missed. `spool` keeps events on disk until they are acknowledged, and
`spool_schema` has its tables.
"""

from __future__ import annotations

from camtopod.serve.outbox.publisher import Publisher as Publisher
from camtopod.serve.outbox.spool import (
    SpoolBatch as SpoolBatch,
    open_spool as open_spool,
    spool_path as spool_path,
)
