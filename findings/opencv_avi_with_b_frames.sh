#!/bin/sh
# One would guess: CAP_PROP_POS_MSEC gives the time of each picture, whatever the container, and
# FRAME_COUNT and FPS are those of the film.
# What happens: AVI has no presentation times. With B frames the stamps are the packets' places in
# the order of decoding: the first picture is dated two pictures late, and the last ones, which
# come out of the decoder when the file has ended, are dated 0.0: back to the beginning. H.264
# counts by fields there: FPS and FRAME_COUNT are twice the true ones.
# Version: opencv-python-headless==5.0.0.93; films made by imageio-ffmpeg==0.6.0 (FFmpeg 7.0.2).
# Both files have the same coded pictures, 100 at 25 a second.
# Seen: MP4 100 pictures of 100 at 25/s, 0.00 s to 3.96 s, 0 steps back; AVI 100 of 200 at 50/s,
# 0.08 s to 0.00 s, 1 step back.
# camtopod: counts pictures without a stamp and believes stamps as far as they bear out the pace
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
import itertools
import subprocess
import sys

import cv2
import imageio_ffmpeg

FFMPEG = (imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error")
SOURCE = ("-f", "lavfi", "-i", "testsrc2=size=320x192:rate=25:duration=4")


def describe(name):
    capture, stamps = cv2.VideoCapture(name, cv2.CAP_FFMPEG), []
    count, rate = capture.get(cv2.CAP_PROP_FRAME_COUNT), capture.get(cv2.CAP_PROP_FPS)
    while capture.grab():
        stamps.append(capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0)
    back = sum(b < a for a, b in itertools.pairwise(stamps))
    span = f"{stamps[0]:.2f} s to {stamps[-1]:.2f} s"
    return f"{len(stamps)} of {count:.0f} at {rate:.0f}/s, {span}, {back} back"


coding = ("-pix_fmt", "yuv420p", "-c:v", "libx264", "-bf", "2", "-x264-params", "b-adapt=0")
subprocess.run([*FFMPEG, *SOURCE, *coding, "film.mp4"], check=True)
subprocess.run([*FFMPEG, "-i", "film.mp4", "-c", "copy", "film.avi"], check=True)
outcome = f"MP4 {describe('film.mp4')}; AVI {describe('film.avi')}"
print(f"OpenCV {cv2.__version__}: {outcome}")
expectation = (
    "MP4 100 of 100 at 25/s, 0.00 s to 3.96 s, 0 back; "
    "AVI 100 of 200 at 50/s, 0.08 s to 0.00 s, 1 back"
)
if outcome != expectation:
    sys.exit(f"changed: expected {expectation}; seen {outcome}")
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
