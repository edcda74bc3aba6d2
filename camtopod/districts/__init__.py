"""Large sites: learned in districts by several programs, and put together again. As pure as
`camtopod.learn`.

In the order in which data flows:

* `dealing`: which camera belongs to which district, and which district to which shard
* `district`: the learner of one; `forgetting`: without the cameras it hears no more; `parts`: what it publishes
* `shard`: the districts of one program, in place of a `Learner`
* `places`, `renaming`: a part in the names that the zones' owners gave; `merging`: parts -> one topology
* `line`: merged versions, one after the other
"""
