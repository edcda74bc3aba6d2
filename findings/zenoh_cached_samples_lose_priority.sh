#!/bin/sh
# One would guess: an advanced publisher's cache hands its samples to late subscribers as they
# were published: the same payload, the same quality of service.
# What happens: they arrive with priority DATA, whatever the publisher's own is. What is urgent
# live waits in the queue of all other data when it is asked for again, and a subscriber that
# sorts by sample.priority sees two kinds of one publication.
# Version: eclipse-zenoh==1.10.2 for Python.
# Seen: publisher INTERACTIVE_HIGH: 5 samples from the cache DATA, 3 live ones INTERACTIVE_HIGH.
# camtopod: keeps no cache on the bus; events are stored in a spool and delivered by requests, all
# of one priority (camtopod/serve/bus/session.py).
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
import zenoh.ext

WAIT_SECONDS = 10.0


def open_session(mode, listen=(), connect=(), **settings):
    config = zenoh.Config()
    values = {"mode": mode, "listen/endpoints": listen, "connect/endpoints": connect}
    for path, value in {**values, "scouting/multicast/enabled": False, **settings}.items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)


def wait_for(count):
    end = time.monotonic() + WAIT_SECONDS
    while time.monotonic() < end and len(samples) < count:
        time.sleep(0.05)


with socket.create_server(("127.0.0.1", 0)) as probe:
    endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
samples = {}
with (
    open_session("router", [endpoint]),
    open_session("client", connect=[endpoint], **{"timestamping/enabled": True}) as session,
    open_session("client", connect=[endpoint]) as reader,
):
    publisher = zenoh.ext.declare_advanced_publisher(
        session,
        "site/event",
        cache=zenoh.ext.CacheConfig(max_samples=100),
        priority=zenoh.Priority.INTERACTIVE_HIGH,
    )
    for k in range(5):
        publisher.put(str(k))
    time.sleep(0.5)  # they are gone when the subscriber comes
    subscriber = zenoh.ext.declare_advanced_subscriber(
        reader,
        "site/event",
        lambda sample: samples.setdefault(
            int(sample.payload.to_string()), str(sample.priority).partition(".")[2]
        ),
        history=zenoh.ext.HistoryConfig(),
    )
    wait_for(5)
    for k in range(5, 8):
        publisher.put(str(k))
    wait_for(8)
    subscriber.undeclare()
    publisher.undeclare()

outcome = [samples.get(k) for k in range(8)]
print(f"zenoh 1.10.2: {outcome}")
expectation = ["DATA"] * 5 + ["INTERACTIVE_HIGH"] * 3
if outcome != expectation:
    sys.exit(f"changed: expected {expectation}; seen {outcome}")
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
