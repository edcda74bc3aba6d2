#!/bin/sh
# One would guess: CAP_PROP_FRAME_COUNT is about the number of pictures in the file.
# What happens: of Matroska it is the film's rate times the last stamp, counted from 0. Recorders
# that cut a day into files let the stamps go on, so a file of two seconds that begins at 100 s
# has 2550 pictures by that count, and one of the evening some million. MP4 of the same pictures
# has 50. POS_MSEC is counted from the film's own beginning in both: the two do not fit each
# other.
# Version: opencv-python-headless==5.0.0.93; films made by imageio-ffmpeg==0.6.0 (FFmpeg 7.0.2).
# Seen: MP4 FRAME_COUNT 50, MKV FRAME_COUNT 2550; both 50 pictures, the first at 0.0 s.
# camtopod: subtracts the first picture's stamp, which CAP_PROP_PTS tells, before it says how much
# of a file is read (camtopod/vision/source/capture.py, `seconds`).
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
SOURCE = ("-f", "lavfi", "-i", "testsrc2=size=320x192:rate=25:duration=2")


def describe(name):
    copying = ("-i", "film.mp4", "-c", "copy", "-output_ts_offset", "100", name)
    subprocess.run([*FFMPEG, *copying], check=True)
    capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG)
    count = capture.get(cv2.CAP_PROP_FRAME_COUNT)
    pictures = int(capture.grab())
    first = capture.get(cv2.CAP_PROP_POS_MSEC)
    while capture.grab():
        pictures += 1
    return f"FRAME_COUNT {count:.0f}, {pictures} pictures, first at {first:.1f}"


subprocess.run([*FFMPEG, *SOURCE, "-pix_fmt", "yuv420p", "-c:v", "libx264", "film.mp4"], check=True)
outcome = f"MP4 {describe('late.mp4')}; MKV {describe('late.mkv')}"
print(f"OpenCV {cv2.__version__}: {outcome}")
expectation = (
    "MP4 FRAME_COUNT 50, 50 pictures, first at 0.0; MKV FRAME_COUNT 2550, 50 pictures, first at 0.0"
)
if outcome != expectation:
    sys.exit(f"changed: expected {expectation}; seen {outcome}")
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
