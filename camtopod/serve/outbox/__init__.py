"""The publishing side of the event protocol: no event is lost between a publisher and the daemon.

Start with `publisher`: it stores each event in the spool and has it delivered. `spool` keeps events
on disk until the daemons of all sites have stored them; `site_queue` says what waits for each site,
`spool_tables` has its tables and `spool_files` its paths. `site_delivery` sends to one site what
`delivery` decides to send next: the protocol of `camtopod.serve.requests`, without I/O. `site_link`
joins a site in the background.
"""

from camtopod.serve.outbox.publisher import (
    TRANSACTION_EVENTS_MAX as TRANSACTION_EVENTS_MAX,
    SpoolPublisher as SpoolPublisher,
)
from camtopod.serve.outbox.site_delivery import SiteDelivery as SiteDelivery
from camtopod.serve.outbox.site_link import SiteLink as SiteLink
from camtopod.serve.outbox.spool import OWNER as OWNER, Spool as Spool
from camtopod.serve.outbox.spool_files import (
    open_ingest_spool as open_ingest_spool,
    open_spool as open_spool,
    spool_path as spool_path,
)
