"""The bus: publish, subscribe and query between the programs of a site, over zenoh.

Start with `session`: `Bus`, one program's session; `joining` opens it, by `dial` (a client) or
`open_daemon_session` (the daemon, which other programs connect to). `topology_subscriber` follows
the daemon's topology, and `site_choice` finds the site where none was named. `forks` has
what a forked child must not use. The others serve the daemon: `access` (who may connect), `sockets`
(an option of connections) and `single_daemon` (detect a second daemon of the site).
"""

from camtopod.serve.bus import access as access
from camtopod.serve.bus.forks import guard as guard, note_use as note_use
from camtopod.serve.bus.joining import dial as dial, open_daemon_session as open_daemon_session
from camtopod.serve.bus.session import (
    JSON as JSON,
    QUERY_SECONDS as QUERY_SECONDS,
    Bus as Bus,
    BusError as BusError,
    OnMessage as OnMessage,
    QueryError as QueryError,
    log_to_standard_output as log_to_standard_output,
)
from camtopod.serve.bus.single_daemon import OtherDaemons as OtherDaemons
from camtopod.serve.bus.site_choice import (
    in_words as in_words,
    log_other_sites as log_other_sites,
    sites_instead as sites_instead,
    take_only_site as take_only_site,
)
from camtopod.serve.bus.topology_subscriber import TopologySubscriber as TopologySubscriber
