"""Learn a site that is too large for one learner, on several machines.

The cameras are assigned to *districts* and the districts to *shards*, the daemons of the site. Each
district learns the links into its own cameras, for which it also receives events of neighbouring
cameras. With each version it publishes a *part*; the parts of all districts are merged into one
topology. In the order to read:

* `assignment`: which cameras belong to which district, and which districts to which shard
* `district_learner`: the learner of one district; `neighbour_scan` finds other cameras it needs
* `parts`: the part that a district publishes with each version
* `merge`: merges the parts of all districts into one topology; `match_zones` and `rename_zones`
  make their zone ids the same
* `version_line`: the versions of the merged topology
* `shard_learner`: the districts of one shard, with the methods of a `Learner`
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from camtopod.lazy import lazy_getattr

if TYPE_CHECKING:
    from camtopod.sharding.assignment import Assignment, Sharding, districts_of
    from camtopod.sharding.parts import Part, is_assigned
    from camtopod.sharding.shard_learner import ShardLearner, ShardState, pack_shard, unpack_shard
    from camtopod.sharding.version_line import VersionLine, VersionLineState, age_of

__all__ = [
    "Assignment",
    "Part",
    "ShardLearner",
    "ShardState",
    "Sharding",
    "VersionLine",
    "VersionLineState",
    "age_of",
    "districts_of",
    "is_assigned",
    "pack_shard",
    "unpack_shard",
]

__getattr__ = lazy_getattr(
    __name__,
    {
        "Assignment": "assignment",
        "VersionLine": "version_line",
        "VersionLineState": "version_line",
        "Part": "parts",
        "ShardLearner": "shard_learner",
        "ShardState": "shard_learner",
        "Sharding": "assignment",
        "age_of": "version_line",
        "districts_of": "assignment",
        "is_assigned": "parts",
        "pack_shard": "shard_learner",
        "unpack_shard": "shard_learner",
    },
)
