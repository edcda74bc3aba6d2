#!/bin/sh
# One would guess: a LocalCluster's workers get settings of their own, and once it is closed the
# process that made it is as it was.
# What happens: so that its workers begin with one thread of linear algebra each, their settings
# are written into the environment of the process that starts them, and stay there. After
# `close()` every program that this process starts, and each library of linear algebra that it
# loads later, has one thread, whatever the machine has; nothing says so.
# Version: distributed==2026.8.0, dask==2026.8.0.
# Seen: before None, None, None; with the cluster 1, 1, 1; after it is closed 1, 1, 1
# (OMP_NUM_THREADS, MKL_NUM_THREADS, OPENBLAS_NUM_THREADS).
# camtopod: its commands set these three for themselves before they load anything, as the last
# bits of results depend on them (camtopod/cli/main.py); a program that measures times beside a
# cluster should start the cluster in a process of its own.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
trap 'exit 1' INT TERM
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
  distributed==2026.8.0 dask==2026.8.0
cat > "$folder/run.py" <<'PYTHON'
import os
import sys

NAMES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")


def main():
    for name in NAMES:
        os.environ.pop(name, None)
    from distributed import LocalCluster

    outcome = [[os.environ.get(name) for name in NAMES]]
    cluster = LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=None)
    outcome.append([os.environ.get(name) for name in NAMES])
    cluster.close()
    outcome.append([os.environ.get(name) for name in NAMES])
    print(f"distributed 2026.8.0: before, with, after: {outcome}")
    expectation = [[None] * 3, ["1"] * 3, ["1"] * 3]
    if outcome != expectation:
        sys.exit(f"changed: expected {expectation}; seen {outcome}")


if __name__ == "__main__":
    main()
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
