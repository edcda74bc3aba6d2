"""sharding"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import names_from

if TYPE_CHECKING:
    from camtopod.sharding.assignment import Dealing, Sharding, districts_of
    from camtopod.sharding.parts import Part, is_dealt
    from camtopod.sharding.shard_learner import ShardLearner, ShardState, pack_shard, unpack_shard
    from camtopod.sharding.version_line import Line, LineState, age_of

__all__ = [
    "Dealing",
    "Line",
    "LineState",
    "Part",
    "ShardLearner",
    "ShardState",
    "Sharding",
    "age_of",
    "districts_of",
    "is_dealt",
    "pack_shard",
    "unpack_shard",
]

__getattr__ = names_from(
    __name__,
    {
        "Dealing": "assignment",
        "Line": "version_line",
        "LineState": "version_line",
        "Part": "parts",
        "ShardLearner": "shard_learner",
        "ShardState": "shard_learner",
        "Sharding": "assignment",
        "age_of": "version_line",
        "districts_of": "assignment",
        "is_dealt": "parts",
        "pack_shard": "shard_learner",
        "unpack_shard": "shard_learner",
    },
)
