"""Cities: sites too large for one learner, cut into districts, and their maps as one.

Each district is a site with a learner of its own (`camtopod.config.districts_file`).

Reading order: `partition` cuts the graph of the cameras between which objects pass into districts.
`joined_map` makes one map of the topologies of all districts, and `merge` one topology that has
them as parts, which `camtopod.predict.CityPredictor` asks. `recordings` learns all districts of a
recording, in processes of this machine; `cluster` has a Dask cluster do so.
"""
