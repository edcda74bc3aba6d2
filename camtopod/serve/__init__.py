"""The daemon around the learner, and everything that can fail: bus, journal, clock, processes.

Read `daemon` first; it starts and connects the parts. `ingest` brings events into order and into
the journal; `storage` is the journal; `learner_process` runs the learner; `versions` publishes what
it makes; `live_predictions` answers exits; `bus` is the session with zenoh, `city_bus` sessions
with several sites, for programs that show them as one; `requests` are what `outbox`, the grabber's
side, sends; `runtime` holds clocks and progress; `monitoring` serves health and metrics;
`admin_queries` are an operator's commands on the bus.
"""
