"""Input of recorded and foreign events for `learn`, `predict`, `report` and `ingest`.

`event_lines` reads and checks event lines, `time_order` answers them in order of time,
`input_formats` selects the adapter for another program's format, and `broker_options` has the
options of an MQTT broker.
"""
