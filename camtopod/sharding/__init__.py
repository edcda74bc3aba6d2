"""Learn a site that is too large for one learner, on several machines.

The cameras are assigned to districts and the districts to shards; each district learns the links
into its own cameras, and the parts of all districts are merged into one topology. In the order to
read:

* `assignment`: cameras to districts, districts to shards, and guests
* `district_learner`: the learner of one district; `neighbour_scan` finds the cameras it needs
* `parts`: what a district publishes with each version
* `match_zones`, `rename_zones`, `merge`: parts of all districts to one topology
* `version_line`: the versions of the merged topology
* `shard_learner`: the districts of one shard, with the methods of a `Learner`
"""

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
