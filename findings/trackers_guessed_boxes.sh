#!/bin/sh
# One would guess: a tracker that is given no detection of a person returns no box of that person,
# or marks the box as a guess.
# What happens: norfair goes on to return a lost object for 15 frames, DeepSORT for 30, where it
# would be had it walked on, among those that are seen. A person who leaves by a door in mid-view
# is reported up to a second later, on the other side of the wall, or beyond the picture.
# Versions: norfair==2.3.0, deep-sort-realtime==1.3.2 (without its embedder). A box walks 6 pixels
# a frame and is detected in frames 0 to 29, last at x = 184.
# Seen: norfair 15 frames more, to x = 274; deep-sort-realtime 30 frames more, to x = 363.
# camtopod: deploy/integrations.md ("Guessed boxes") asks for boxes that were matched in the
# frame; tests/examples/with_norfair.py does so by `last_detection`; DeepSORT's field is
# `time_since_update`.
set -eu
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
trap 'exit 1' INT TERM
cd "$folder"
for package in norfair==2.3.0 deep-sort-realtime==1.3.2; do
  python3 -m venv "${package%%=*}"
  "${package%%=*}/bin/pip" install --quiet --disable-pip-version-check "$package" setuptools==80.9.0
done
cat > walk.py <<'PYTHON'
def box(frame):
    left = 10.0 + 6 * frame
    return left, 100.0, left + 20, 160.0


def report(name, lefts, expectation):
    """Compare the left edges by frame with what was seen before."""
    import sys

    extra = [frame for frame in lefts if frame >= 30]
    outcome = (len(extra), round(lefts[max(lefts)]))
    print(f"{name}: {outcome[0]} frames more, to x = {outcome[1]}")
    if outcome != expectation:
        sys.exit(f"changed: expected (frames more, last x) {expectation}; seen {outcome}")
PYTHON
cat > by_norfair.py <<'PYTHON'
import numpy as np
from norfair import Detection, Tracker
from walk import box, report

tracker, lefts = Tracker(distance_function="euclidean", distance_threshold=50), {}
for frame in range(90):
    points = np.array(box(frame)).reshape(2, 2)
    for person in tracker.update(detections=[Detection(points)] if frame < 30 else []):
        lefts[frame] = float(person.estimate[0, 0])
report("norfair 2.3.0", lefts, (15, 274))
PYTHON
cat > by_deep_sort.py <<'PYTHON'
import numpy as np
from deep_sort_realtime.deepsort_tracker import DeepSort
from walk import box, report

tracker, lefts = DeepSort(embedder=None), {}
for frame in range(90):
    left, top, right, bottom = box(frame)
    detections = [([left, top, right - left, bottom - top], 0.9, "person")] if frame < 30 else []
    looks = [np.ones(8, np.float32) for _ in detections]
    for track in tracker.update_tracks(detections, embeds=looks):
        if track.is_confirmed():
            lefts[frame] = float(track.to_ltrb()[0])
report("deep-sort-realtime 1.3.2", lefts, (30, 363))
PYTHON
timeout 50 norfair/bin/python by_norfair.py
timeout 50 deep-sort-realtime/bin/python by_deep_sort.py
