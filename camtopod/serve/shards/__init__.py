"""shards"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import names_from

if TYPE_CHECKING:
    from camtopod.serve.shards.membership import Share, Whole
    from camtopod.serve.shards.shard_exchange import Sharing

__all__ = [
    "Share",
    "Sharing",
    "Whole",
]

__getattr__ = names_from(
    __name__,
    {
        "Share": "membership",
        "Sharing": "shard_exchange",
        "Whole": "membership",
    },
)
