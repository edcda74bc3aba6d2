"""Access control on the bus of a site: the rules, and the authority that issues certificates.

`rules` translates an access list to settings of zenoh; `authority` keeps the site's private key,
and issues and revokes certificates.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.keys.authority import (
        ACCESS,
        DAEMON,
        LOCAL_HOSTS,
        Authority,
        KeysError,
        check_cameras,
        check_hosts,
        date_text,
        write_public,
    )
    from camtopod.keys.rules import PREFIX, STATUS

__all__ = [
    "ACCESS",
    "DAEMON",
    "LOCAL_HOSTS",
    "PREFIX",
    "STATUS",
    "Authority",
    "KeysError",
    "check_cameras",
    "check_hosts",
    "date_text",
    "rules",
    "write_public",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "ACCESS": "authority",
        "Authority": "authority",
        "DAEMON": "authority",
        "KeysError": "authority",
        "LOCAL_HOSTS": "authority",
        "PREFIX": "rules",
        "STATUS": "rules",
        "check_cameras": "authority",
        "check_hosts": "authority",
        "date_text": "authority",
        "write_public": "authority",
    },
)
