#!/bin/sh
# One would guess: the correlation miner, which needs no case numbers, finds nothing, or few and
# weak edges, among cameras that nothing joins.
# What happens: it explains every passage by another. Of three cameras that are passed at
# independent, uniform times it returns a ring that all hundred passages of each camera take, for
# each of three seeds, with mean "transit times" of 16 to 66 minutes. Edges have counts and times,
# and no figure that would tell them from those of a real path.
# Version: pm4py==2.7.23.11 (AGPL), variant CLASSIC. Three cameras, 100 passages each in ten
# hours.
# Seen: seeds 1, 2, 3: three edges of 100 of 100 each, one into and one out of each camera.
# camtopod: publishes a link only if held-out evidence is significant against chance
# (camtopod/learn/METHOD.md); the miner is one of the bench's baselines
# (bench/baselines/process_mining.py).
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
trap 'exit 1' INT TERM
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
  pm4py==2.7.23.11
cat > "$folder/run.py" <<'PYTHON'
import sys
import warnings

warnings.simplefilter("ignore")
import numpy as np
import pandas as pd
from pm4py.algo.discovery.correlation_mining import algorithm

CAMERAS, PASSAGES, SECONDS = "abc", 100, 36000.0
COLUMNS = {
    "pm4py:param:activity_key": "concept:name",
    "pm4py:param:timestamp_key": "time:timestamp",
    "pm4py:param:start_timestamp_key": "start_timestamp",
}


def edges(seed):
    """Return the counts of the edges found, falling, and the numbers of their begins and ends."""
    rng = np.random.default_rng(seed)
    starts = np.concatenate([np.sort(rng.uniform(0.0, SECONDS, PASSAGES)) for _ in CAMERAS])
    passages = pd.DataFrame(
        {
            "concept:name": np.repeat(list(CAMERAS), PASSAGES),
            "start_timestamp": pd.to_datetime(starts, unit="s", utc=True),
            "time:timestamp": pd.to_datetime(starts + 5.0, unit="s", utc=True),
        }
    )
    variant = algorithm.Variants.CLASSIC
    counts, _ = algorithm.apply(passages, variant=variant, parameters=COLUMNS)
    begins, ends = ({edge[k] for edge in counts} for k in (0, 1))
    return sorted(counts.values(), reverse=True), len(begins), len(ends)


outcome = {seed: edges(seed) for seed in (1, 2, 3)}
print(f"pm4py 2.7.23.11: (counts of the edges, begins, ends) by seed: {outcome}")
expectation = {seed: ([100, 100, 100], 3, 3) for seed in (1, 2, 3)}
if outcome != expectation:
    sys.exit(f"changed: expected {expectation}; seen {outcome}")
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
