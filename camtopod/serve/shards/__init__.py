"""The daemons of a large site that share its cameras, each of them one shard.

`membership` tells which cameras a shard owns and which it hears; `subscriptions` subscribes to
their events; `shard_exchange` publishes what the shard has learned and follows the site's topology;
`site_merger`, in shard 0, makes that topology of all shards' updates.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.serve.shards.membership import ShardMembership, WholeSite
    from camtopod.serve.shards.shard_exchange import ShardExchange

__all__ = [
    "ShardExchange",
    "ShardMembership",
    "WholeSite",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "ShardMembership": "membership",
        "ShardExchange": "shard_exchange",
        "WholeSite": "membership",
    },
)
