#!/bin/sh
# One would guess: a router passes on what peers publish to peers that subscribe, as it does for
# clients: that is what routers are for.
# What happens: two sessions in mode "peer", the default, that are both connected to one router
# but cannot reach each other (two machines behind firewalls) hear nothing of each other, and
# nothing reports it; the same sessions in mode "client" hear everything. The router's setting
# routing/router/peers_failover_brokering, made for this case, is accepted and changes nothing.
# Version: eclipse-zenoh==1.10.2 for Python.
# Seen: of 10 messages clients hear 10, peers 0, peers with brokering 0.
# camtopod: all programs but the daemon are clients of explicit endpoints
# (camtopod/serve/bus/access.py, deploy/protocol.md).
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
trap 'exit 1' INT TERM
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
  eclipse-zenoh==1.10.2
cat > "$folder/run.py" <<'PYTHON'
import json
import socket
import sys
import time

import zenoh

MESSAGES = 10
WAIT_SECONDS = 5.0


def open_session(mode, listen=(), connect=(), **settings):
    config = zenoh.Config()
    values = {"mode": mode, "listen/endpoints": listen, "connect/endpoints": connect}
    for path, value in {**values, "scouting/multicast/enabled": False, **settings}.items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)


def count_heard(mode, **settings):
    """Return how many messages go from one session by a router to another."""
    with socket.create_server(("127.0.0.1", 0)) as probe:
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    numbers = set()
    with (
        open_session("router", [endpoint], **settings),
        open_session(mode, connect=[endpoint]) as publisher,
        open_session(mode, connect=[endpoint]) as reader,
    ):
        subscriber = reader.declare_subscriber(
            "site/event", lambda sample: numbers.add(sample.payload.to_string())
        )
        end = time.monotonic() + WAIT_SECONDS
        while time.monotonic() < end and len(numbers) < MESSAGES:
            for k in range(MESSAGES):
                publisher.put("site/event", str(k))
            time.sleep(0.2)
        subscriber.undeclare()
    return len(numbers)


clients, peers = count_heard("client"), count_heard("peer")
brokered = count_heard("peer", **{"routing/router/peers_failover_brokering": True})
outcome = f"clients {clients}, peers {peers}, brokered {brokered}"
print(f"zenoh 1.10.2: {outcome}")
expectation = "clients 10, peers 0, brokered 0"
if outcome != expectation:
    sys.exit(f"changed: expected {expectation}; seen {outcome}")
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
