#!/bin/sh
# One would guess: each picture of an MPEG program stream (.mpg, what many recorders export) has a
# time, or is dated by the one before it.
# What happens: a packet of a program stream may begin with one picture and hold more, and only
# the first has a stamp. OpenCV gives 0.0 for the others: the same as for the film's beginning, in
# the midst of it. A program that takes 0.0 for a jump back reads a film of five minutes as one of
# five and a half.
# Version: opencv-python-headless==5.0.0.93; films made by imageio-ffmpeg==0.6.0 (FFmpeg 7.0.2).
# Both files have the same pictures, 500 at 25 a second.
# Seen: transport stream 500 pictures, none at 0.0 after the first; program stream 500, 51 at 0.0.
# camtopod: counts pictures without a stamp, and the next stamp tells their interval
# (camtopod/vision/source/file_times.py).
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

FFMPEG = (imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error")
SOURCE = ("-f", "lavfi", "-i", "testsrc2=size=320x192:rate=25:duration=20")


def count(name):
    """Return the number of pictures, and how many after the first are dated 0.0."""
    capture, stamps = cv2.VideoCapture(name, cv2.CAP_FFMPEG), []
    while capture.grab():
        stamps.append(capture.get(cv2.CAP_PROP_POS_MSEC))
    return len(stamps), stamps[1:].count(0.0)


coding = ("-pix_fmt", "yuv420p", "-c:v", "libx264", "-g", "50")
for name in ("film.ts", "film.mpg"):
    subprocess.run([*FFMPEG, *SOURCE, *coding, name], check=True)
transport, program = count("film.ts"), count("film.mpg")
print(f"OpenCV {cv2.__version__}: (pictures, dated 0.0) transport {transport}, program {program}")
if transport != (500, 0) or program[0] != 500 or program[1] < 20:
    sys.exit(f"changed: expected (500, 0) and (500, 20 or more); seen {transport} and {program}")
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
