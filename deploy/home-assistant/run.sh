#!/usr/bin/env bash
# Runs daemon, grabbers and page, and the bridge if a broker is set, until one of them ends; the Supervisor then starts all
# again. Events and what was learned are in /data, which the Supervisor keeps and backs up.
set -euo pipefail
folder=${CAMTOPOD_FOLDER:-/config}
options=${CAMTOPOD_OPTIONS:-/data/options.json}
program=${CAMTOPOD_PROGRAM:-/opt/camtopod/bin/camtopod}
config=$folder/camtopod.toml

if [ ! -e "$config" ]; then
  echo "there is no camtopod.toml in the add-on's configuration folder yet: DOCS.md says how to make it" >&2
  exit 78
fi
mkdir -p "$STATE_DIRECTORY" "$folder/pictures"
option() { python3 -c 'import json, sys; print(json.load(open(sys.argv[1])).get(sys.argv[2]) or "")' "$options" "$1"; }

"$program" --config "$config" run &
"$program" --config "$config" grab &
"$program" --config "$config" web --listen "${CAMTOPOD_PAGE:-0.0.0.0:8780}" --pictures "$folder/pictures" &
if [ -n "$(option mqtt)" ]; then
  (umask 077 && option mqtt_password >"$STATE_DIRECTORY/mqtt")
  "$program" --config "$config" bridge --password-file "$STATE_DIRECTORY/mqtt" "$(option mqtt)" &
fi

trap 'kill $(jobs -p); wait; exit 0' TERM INT
status=0
wait -n || status=$?
kill $(jobs -p) 2>/dev/null || true
wait
exit "$status"
