"""Input of recorded and foreign events for `learn`, `predict`, `report` and `ingest`.

`event_lines` reads and checks event lines, of any form that `file_forms`, `csv_rows` and
`table_files` know; `recording` gives those of files in order of time, each once; `time_order`
sorts, and answers lines in order of time;
`input_formats` selects the adapter for another program's format, and `broker_options` has the
options of an MQTT broker. `load` loads a recording into memory, for programs, and `learning` passes
it to a learner.
"""
