#!/bin/sh
# One would guess: a program opens its cameras side by side, one thread for each: all are there
# when the slowest has answered.
# What happens: the FFmpeg backend opens one source at a time in a process. Four cameras that
# answer after a second each are open after one, two, three and four seconds, and a file on the
# disk, opened meanwhile, waits behind them. A camera that is slow to answer keeps all others away
# at each retry.
# Version: opencv-python-headless==5.0.0.93; film made by imageio-ffmpeg==0.6.0 (FFmpeg 7.0.2),
# served by HTTP a second after it is asked for.
# Seen: cameras open after 1.0, 2.0, 3.0, 4.0 s; the file, asked for after 0.3 s, after 4.0 s.
# camtopod: one process for each camera (camtopod/cli/cameras), which also keeps FFmpeg's options
# and log apart.
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
import http.server
import subprocess
import sys
import threading
import time

import cv2
import imageio_ffmpeg

FFMPEG = (imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error")
SOURCE = ("-f", "lavfi", "-i", "testsrc2=size=320x192:rate=25:duration=1")
CAMERAS = 4


class SlowCamera(http.server.BaseHTTPRequestHandler):
    def log_message(self, *arguments):
        pass

    def do_GET(self):
        time.sleep(1.0)
        self.send_response(200)
        self.send_header("Content-Length", str(len(film)))
        self.end_headers()
        self.wfile.write(film)


def open_source(source, delay=0.0):
    time.sleep(delay)
    timeout = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, 30_000]
    is_open = cv2.VideoCapture(source, cv2.CAP_FFMPEG, timeout).isOpened()
    seconds.append((source, time.monotonic() - begin if is_open else None))


subprocess.run(
    [*FFMPEG, *SOURCE, "-pix_fmt", "yuv420p", "-c:v", "libx264", "-f", "mpegts", "film.ts"],
    check=True,
)
film = open("film.ts", "rb").read()
server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), SlowCamera)
threading.Thread(target=server.serve_forever, daemon=True).start()
url = f"http://127.0.0.1:{server.server_port}/film.ts"

seconds, begin = [], time.monotonic()
threads = [threading.Thread(target=open_source, args=(url,)) for _ in range(CAMERAS)]
threads.append(threading.Thread(target=open_source, args=("film.ts", 0.3)))
for thread in threads:
    thread.start()
for thread in threads:
    thread.join(60)
cameras = [f"{s:.1f}" for source, s in seconds if source == url and s is not None]
[file] = [s for source, s in seconds if source == "film.ts"]
print(
    f"OpenCV {cv2.__version__}: cameras after {', '.join(cameras)} s, the file after {file:.1f} s"
)
if len(cameras) != CAMERAS or float(cameras[-1]) < CAMERAS - 0.5 or file < 1.5:
    sys.exit(
        f"changed: expected the last camera after {CAMERAS} s, and the file behind at least two "
        f"cameras; seen cameras after {cameras} s, the file after {file:.1f} s"
    )
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
