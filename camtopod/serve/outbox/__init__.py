"""The publishing side of the event protocol: no event is lost between a publisher and the daemon.

Start with `publisher`: it stores each event in the spool and has it delivered. `spool` keeps events
on disk until the daemon has stored them; `spool_tables` has its tables and `spool_files` its paths.
`delivery` decides what to send next: it is the protocol of `camtopod.serve.requests`, without I/O.
"""

from camtopod.serve.outbox.publisher import (
    TRANSACTION_EVENTS_MAX as TRANSACTION_EVENTS_MAX,
    Publisher as Publisher,
)
from camtopod.serve.outbox.spool import Spool as Spool
from camtopod.serve.outbox.spool_files import (
    open_ingest_spool as open_ingest_spool,
    open_spool as open_spool,
    spool_path as spool_path,
)
