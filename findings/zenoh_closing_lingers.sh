#!/bin/sh
# One would guess: closing a connection returns at once, and the kernel sends what is left, as for
# any socket that does not say otherwise; a bus whose calls must not block would leave that as it
# is.
# What happens: zenoh sets SO_LINGER to ten seconds on each of its TCP connections, and its
# configuration has no setting for it. So closing one may keep a thread of the bus for as long.
# Version: eclipse-zenoh==1.10.2 for Python; Linux only (reads the options from /proc/self/fd).
# Seen: two ends of one connection, each SO_LINGER on, 10 s.
# camtopod: turns it off on all its sockets (camtopod/serve/bus/sockets.py).
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
trap 'exit 1' INT TERM
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
  eclipse-zenoh==1.10.2
cat > "$folder/run.py" <<'PYTHON'
import json
import os
import socket
import struct
import sys

import zenoh


def open_session(mode, listen=(), connect=(), **settings):
    config = zenoh.Config()
    values = {"mode": mode, "listen/endpoints": listen, "connect/endpoints": connect}
    for path, value in {**values, "scouting/multicast/enabled": False, **settings}.items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)


def linger_options():
    """Return SO_LINGER (on, seconds) of each connected TCP socket of this process."""
    values = []
    for descriptor in map(int, os.listdir("/proc/self/fd")):
        try:
            connection = socket.socket(fileno=os.dup(descriptor))
        except OSError:  # no socket, or gone
            continue
        with connection:
            try:
                connection.getpeername()
                option = connection.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8)
            except OSError:  # not connected
                continue
            if connection.family == socket.AF_INET:
                values.append(struct.unpack("ii", option))
    return values


with socket.create_server(("127.0.0.1", 0)) as probe:
    endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
with open_session("router", [endpoint]), open_session("client", connect=[endpoint]):
    outcome = linger_options()
print(f"zenoh 1.10.2: SO_LINGER (on, seconds) {outcome}")
expectation = [(1, 10), (1, 10)]
if outcome != expectation:
    sys.exit(f"changed: expected {expectation}; seen {outcome}")
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
