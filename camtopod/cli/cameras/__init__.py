"""Supervision of camera processes: `camtopod grab` runs one process per camera.

Read `supervisor` first (all cameras of a configuration), then `camera_process` (start, watchdog and
restart of one process) and `heartbeat` (notifications between the two). `grabber_connection` is a
process on the bus of a site. `probe` opens cameras once, for `camtopod init` and `check --probe`;
`onvif` and `finding` find cameras and their streams for `init`, `naming` gives them ids.
"""
