#!/bin/sh
# One would guess: a running mean (accumulateWeighted) comes as near to a scene that stands still
# as one likes, given time, however slow its rate. At 25 pictures a second a rate of 1e-5 learns a
# background over an hour.
# What happens: in float32, the usual type, it stops where the step is less than half of what the
# float can tell apart: at grey level 200 and a rate of 1e-5 it stays three quarters of a level
# short, for good. Before that, steps are rounded, so that it moves at another pace than asked. In
# float64 the same call arrives.
# Version: opencv-python-headless==5.0.0.93, numpy==2.4.6.
# Seen: from 200 towards 201, after a million pictures (ten time constants): float32 200.237,
# float64 201.000.
# camtopod: its background learns over 20 seconds, where the floats suffice
# (camtopod/vision/detect/background.py); slower means would want float64.
set -eu
unset OPENCV_FFMPEG_CAPTURE_OPTIONS
export OPENCV_LOG_LEVEL=OFF OPENCV_FFMPEG_LOGLEVEL=-8
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
trap 'exit 1' INT TERM
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
  opencv-python-headless==5.0.0.93 numpy==2.4.6
cat > "$folder/run.py" <<'PYTHON'
import sys

import cv2
import numpy as np

RATE = 1e-5
picture = np.full((1, 1), 201, np.uint8)
single, double = np.full((1, 1), 200, np.float32), np.full((1, 1), 200, np.float64)
for _ in range(1_000_000):
    cv2.accumulateWeighted(picture, single, RATE)
    cv2.accumulateWeighted(picture, double, RATE)
outcome = f"float32 {single[0, 0]:.3f}, float64 {double[0, 0]:.3f}"
print(f"OpenCV {cv2.__version__}: {outcome}")
expectation = "float32 200.237, float64 201.000"
if outcome != expectation:
    sys.exit(f"changed: expected {expectation}; seen {outcome}")
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
