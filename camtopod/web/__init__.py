"""Web page of a site: topology, predictions and health; `camtopod report` writes it as one file.

Reading order: `app` is the HTTP server, `api` its part for programs, and `feed` follows the bus for
both. `map_data` makes the map of a version (`camtopod.export` places the cameras), `explanations`
the details of a camera, pair or link, `growth` what the map had before,
`recent_matches` the walks of the last hour, `versions` the time line and the changes of each
version. `outbox` queues messages for open pages and `pictures` finds camera pictures. `guards` and
`login` decide which requests are answered. `report` gathers the data of a report, `single_file`
makes one HTML file of it. The page itself is in ``static/``.
"""
