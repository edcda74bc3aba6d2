#!/usr/bin/env bash
# Runs daemon, grabbers and page, and the bridge if a broker is set; one that ends is started again.
# The journal is in /data, which the Supervisor keeps and backs up.
set -euo pipefail
config=${CAMTOPOD_FOLDER:-/config}/camtopod.toml
options=${CAMTOPOD_OPTIONS:-/data/options.json}

if [ ! -e "$config" ]; then
  echo "there is no camtopod.toml in the add-on's configuration folder yet: DOCS.md says how to make it" >&2
  exit 78
fi
option() { python3 -c 'import json, sys; print(json.load(open(sys.argv[1])).get(sys.argv[2]) or "")' "$options" "$1"; }
CAMTOPOD_MQTT_PASSWORD=$(option mqtt_password)
export CAMTOPOD_MQTT_PASSWORD
broker=$(option mqtt)

exec "${CAMTOPOD_PROGRAM:-/opt/camtopod/bin/camtopod}" --config "$config" up --listen "${CAMTOPOD_PAGE:-0.0.0.0:8780}" ${broker:+--bridge "$broker"}
