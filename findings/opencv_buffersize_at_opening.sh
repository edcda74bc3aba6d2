#!/bin/sh
# One would guess: a property that the FFmpeg backend cannot set (CAP_PROP_BUFFERSIZE, the usual
# advice against stale frames) has no effect, whether it is set after opening or given at opening.
# What happens: set afterwards it returns False, and the film plays. Given in the list of
# parameters, where timeouts have to stand, it makes opening itself fail: `isOpened()` is False,
# as for a camera that is away. So does CAP_PROP_ORIENTATION_AUTO, which `set` accepts.
# Version: opencv-python-headless==5.0.0.93; film made by imageio-ffmpeg==0.6.0 (FFmpeg 7.0.2).
# Seen: without parameters open; N_THREADS open; BUFFERSIZE and ORIENTATION_AUTO not open; set
# afterwards BUFFERSIZE False, ORIENTATION_AUTO True.
# camtopod: gives timeouts and threads alone, and grabs every frame so that none gets stale
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

FFMPEG = (imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error")
SOURCE = ("-f", "lavfi", "-i", "testsrc2=size=320x192:rate=25:duration=1")
NAMES = ("N_THREADS", "BUFFERSIZE", "ORIENTATION_AUTO")

subprocess.run([*FFMPEG, *SOURCE, "-pix_fmt", "yuv420p", "-c:v", "libx264", "film.mp4"], check=True)
numbers = {name: getattr(cv2, f"CAP_PROP_{name}") for name in NAMES}
at_opening = {
    name: cv2.VideoCapture("film.mp4", cv2.CAP_FFMPEG, [number, 1]).isOpened()
    for name, number in numbers.items()
}
capture = cv2.VideoCapture("film.mp4", cv2.CAP_FFMPEG)
afterwards = {name: capture.set(numbers[name], 1) for name in NAMES[1:]}
outcome = f"without {capture.isOpened()}, at opening {at_opening}, afterwards {afterwards}"
print(f"OpenCV {cv2.__version__}: {outcome}")
expectation = (
    "without True, at opening {'N_THREADS': True, 'BUFFERSIZE': False, 'ORIENTATION_AUTO': False}, "
    "afterwards {'BUFFERSIZE': False, 'ORIENTATION_AUTO': True}"
)
if outcome != expectation:
    sys.exit(f"changed: expected {expectation}; seen {outcome}")
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
