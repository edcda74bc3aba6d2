"""Pages over HTTP for supervisors: `health` (is a program alive, is it ready) and `metrics`.

`health` serves /healthz and /readyz for any program, and has the small HTTP server; `metrics` makes
the daemon's page /metrics for Prometheus. Import the modules themselves: `metrics` imports the
daemon.
"""
