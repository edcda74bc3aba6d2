#!/bin/sh
# One would guess: a stream of JPEG pictures by HTTP (multipart/x-mixed-replace) is read whatever
# parameters its parts add to their Content-Type, as MIME allows, or it cannot be opened.
# What happens: the parts have to say image/jpeg and nothing else, in any case of letters. With a
# parameter behind it, or as image/jpg, opening succeeds, `isOpened()` is True, and there is never
# a picture.
# Version: opencv-python-headless==5.0.0.93. Each stream has 40 pictures.
# Seen: image/jpeg open, 40; Image/JPEG open, 40; image/jpeg;charset=utf-8 open, 0; image/jpg
# open, 0.
# camtopod: a connection without a picture is followed by one that looks for the pictures by their
# own markers (JPEG_OPTIONS in camtopod/vision/source/capture.py).
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
import http.server
import sys
import threading

import cv2
import numpy as np

KINDS = ("image/jpeg", "Image/JPEG", "image/jpeg;charset=utf-8", "image/jpg")
pictures = [
    cv2.imencode(".jpg", np.full((96, 128, 3), 5 * k, np.uint8))[1].tobytes() for k in range(40)
]


class Camera(http.server.BaseHTTPRequestHandler):
    def log_message(self, *arguments):
        pass

    def do_GET(self):
        kind = KINDS[int(self.path[1:])]
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        try:
            for picture in pictures:
                head = f"--frame\r\nContent-Type: {kind}\r\nContent-Length: {len(picture)}\r\n\r\n"
                self.wfile.write(head.encode() + picture + b"\r\n")
        except OSError:  # the reader has gone
            pass


server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Camera)
threading.Thread(target=server.serve_forever, daemon=True).start()
outcome = {}
for k, kind in enumerate(KINDS):
    timeouts = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, 10_000, cv2.CAP_PROP_READ_TIMEOUT_MSEC, 10_000]
    url = f"http://127.0.0.1:{server.server_port}/{k}"
    capture, count = cv2.VideoCapture(url, cv2.CAP_FFMPEG, timeouts), 0
    is_open = capture.isOpened()
    while capture.grab():
        count += 1
    outcome[kind] = (is_open, count)
print(f"OpenCV {cv2.__version__}: (open, pictures) {outcome}")
expectation = dict(zip(KINDS, ((True, 40), (True, 40), (True, 0), (True, 0))))
if outcome != expectation:
    sys.exit(f"changed: expected {expectation}; seen {outcome}")
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
