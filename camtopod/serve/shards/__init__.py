"""The daemons of a large site that share its cameras, each of them one shard.

`membership` tells which cameras a shard owns and which it hears; `subscriptions` subscribes to
their events; `shard_exchange` publishes what the shard has learned and follows the site's topology;
`site_merger`, in shard 0, makes that topology of all shards' updates.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.serve.shards.membership import Share, Whole
    from camtopod.serve.shards.shard_exchange import Sharing

__all__ = [
    "Share",
    "Sharing",
    "Whole",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "Share": "membership",
        "Sharing": "shard_exchange",
        "Whole": "membership",
    },
)
