#!/bin/sh
# One would guess: with access control a subscription that is wider than its right, such as
# site/** where site/event/** is allowed, hears the part that is allowed, as a database shows the
# allowed rows; or declaring it raises.
# What happens: it is dropped as a whole, in silence: declaring succeeds, and nothing ever
# arrives, of the allowed keys neither. Only what lies within the right hears.
# Version: eclipse-zenoh==1.10.2 for Python. The router allows put and declare_subscriber on
# site/event/** both ways, and nothing else.
# Seen: of 10 publications on site/event/c1 hear site/event/** 10, site/event/c1 10, site/** 0,
# site/*/c1 0, ** 0.
# camtopod: rights and subscriptions are made from the same keys (camtopod/keys/rules.py), which
# deploy/protocol.md lists: subscribe to exactly these.
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

KEYS = ("site/event/**", "site/event/c1", "site/**", "site/*/c1", "**")
MESSAGES = 10
WAIT_SECONDS = 3.0
ALLOWED = {
    "enabled": True,
    "default_permission": "deny",
    "rules": [
        {
            "id": flow,
            "permission": "allow",
            "messages": ["put", "declare_subscriber"],
            "flows": [flow],
            "key_exprs": ["site/event/**"],
        }
        for flow in ("ingress", "egress")
    ],
    "subjects": [{"id": "all"}],
    "policies": [{"rules": ["ingress", "egress"], "subjects": ["all"]}],
}


def open_session(mode, listen=(), connect=(), **settings):
    config = zenoh.Config()
    values = {"mode": mode, "listen/endpoints": listen, "connect/endpoints": connect}
    for path, value in {**values, "scouting/multicast/enabled": False, **settings}.items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)


def count_heard(key):
    numbers = set()
    subscriber = reader.declare_subscriber(
        key, lambda sample: numbers.add(sample.payload.to_string())
    )
    end = time.monotonic() + WAIT_SECONDS
    while time.monotonic() < end and len(numbers) < MESSAGES:
        for k in range(MESSAGES):
            publisher.put("site/event/c1", str(k))
        time.sleep(0.2)
    subscriber.undeclare()
    return len(numbers)


with socket.create_server(("127.0.0.1", 0)) as probe:
    endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
with (
    open_session("router", [endpoint], access_control=ALLOWED),
    open_session("client", connect=[endpoint]) as publisher,
    open_session("client", connect=[endpoint]) as reader,
):
    outcome = {key: count_heard(key) for key in KEYS}
print(f"zenoh 1.10.2: {outcome}")
expectation = dict(zip(KEYS, (10, 10, 0, 0, 0)))
if outcome != expectation:
    sys.exit(f"changed: expected {expectation}; seen {outcome}")
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
