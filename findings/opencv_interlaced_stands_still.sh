#!/bin/sh
# One would guess: `read` gives interlaced video with both fields woven into each picture, as
# players do without a filter; of pictures that it cannot convert it returns False.
# What happens: of interlaced H.264, as analogue cameras behind an encoder send it, each `read`
# returns True and hands out one and the same picture, black as a rule, for the whole film.
# FFmpeg's converter refuses interlaced pictures ("Cannot convert interlaced to progressive
# frames"), OpenCV takes no notice, and the buffer stays as it was. A counter of people sees a
# camera that runs, and an empty scene.
# Version: opencv-python-headless==5.0.0.93; films made by imageio-ffmpeg==0.6.0 (FFmpeg 7.0.2).
# Seen: progressive 50 pictures, 50 different ones; interlaced 50 pictures, 1 different one.
# camtopod: reads FFmpeg's log beside each picture (camtopod/vision/source/ffmpeg_log.py), refuses
# such video and says why (tests/vision/test_faulty_files.py).
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


def make_film(name, *options):
    source = "testsrc2=size=320x192:rate=25:duration=2"
    command = (imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", "-f", "lavfi", "-i", source)
    subprocess.run([*command, "-pix_fmt", "yuv420p", "-c:v", "libx264", *options, name], check=True)
    return name


def count(name):
    """Return the number of good pictures, and of different ones."""
    capture, pictures = cv2.VideoCapture(name, cv2.CAP_FFMPEG), []
    while (answer := capture.read())[0]:
        pictures.append(answer[1].tobytes())
    return len(pictures), len(set(pictures))


progressive = count(make_film("progressive.mp4"))
interlaced = count(make_film("interlaced.mp4", "-vf", "setfield=tff", "-flags", "+ildct+ilme"))
outcome = f"progressive {progressive}, interlaced {interlaced} (pictures, different ones)"
print(f"OpenCV {cv2.__version__}: {outcome}")
expectation = "progressive (50, 50), interlaced (50, 1) (pictures, different ones)"
if outcome != expectation:
    sys.exit(f"changed: expected {expectation}; seen {outcome}")
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
