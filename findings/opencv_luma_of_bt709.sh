#!/bin/sh
# One would guess: with CAP_PROP_CONVERT_RGB = 0 OpenCV hands out the luma plane as it is stored,
# of every film in yuv420p; the tags that say how its colours are meant do not matter without
# colours.
# What happens: a film that is tagged BT.709, as many cameras tag theirs, has another luma: it is
# converted to that of BT.601 by way of colours. Grey levels change with the hue, so that a
# threshold on differences does not mean the same on two cameras.
# Version: opencv-python-headless==5.0.0.93; films made by imageio-ffmpeg==0.6.0 (FFmpeg 7.0.2).
# Both films have the same coded pictures; the tags alone differ.
# Seen: largest difference from the stored luma 0 levels untagged, 26 of 255 tagged BT.709.
# camtopod: finds the tag in the headers, takes the colours and makes the luma itself
# (camtopod/vision/source/capture.py).
set -eu
unset OPENCV_FFMPEG_CAPTURE_OPTIONS
export OPENCV_LOG_LEVEL=OFF OPENCV_FFMPEG_LOGLEVEL=-8
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
trap 'exit 1' INT TERM
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
  opencv-python-headless==5.0.0.93 imageio-ffmpeg==0.6.0 numpy==2.4.6
cat > "$folder/run.py" <<'PYTHON'
import subprocess
import sys

import cv2
import imageio_ffmpeg
import numpy as np

FFMPEG = (imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error")
SOURCE = ("-f", "lavfi", "-i", "testsrc2=size=320x192:rate=25:duration=1")
TAGS = "h264_metadata=colour_primaries=1:transfer_characteristics=1:matrix_coefficients=1"


def difference(name):
    """Return the largest difference of the first picture's luma from the stored one."""
    decoding = (*FFMPEG, "-i", name, "-frames:v", "1", "-f", "rawvideo", "-")
    pixels = subprocess.run(decoding, check=True, capture_output=True).stdout
    plane = np.frombuffer(pixels, np.uint8)[: 192 * 320].reshape(192, 320)
    capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG)
    capture.set(cv2.CAP_PROP_CONVERT_RGB, 0)
    is_good, luma = capture.read()
    assert is_good
    assert luma.shape == plane.shape
    return int(np.abs(luma.astype(int) - plane).max())


coding = ("-pix_fmt", "yuv420p", "-c:v", "libx264")
subprocess.run([*FFMPEG, *SOURCE, *coding, "untagged.mp4"], check=True)
copying = ("-i", "untagged.mp4", "-c", "copy", "-bsf:v", TAGS)
subprocess.run([*FFMPEG, *copying, "tagged.mp4"], check=True)
untagged, tagged = difference("untagged.mp4"), difference("tagged.mp4")
print(f"OpenCV {cv2.__version__}: largest difference {untagged} untagged, {tagged} BT.709")
if untagged != 0 or tagged < 10:
    sys.exit(f"changed: expected 0 and at least 10 levels; seen {untagged} and {tagged}")
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
